//! Numbers that stay the same: the bytes of a run for any number of threads.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tempfile::TempDir;

/// Every file of a run that holds no time.
fn results(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let timed = ["report.html", "run.json", "metrics.json", "frame.json"]
            .iter()
            .any(|name| entry.ends_with(name));
        if entry.is_dir() {
            found.extend(results(&entry));
        } else if !timed {
            found.push((entry.clone(), fs::read(entry).unwrap()));
        }
    }
    found.sort();
    found
}

/// Two frames of the sample, every stage of the method in the second.
fn run(out: &Path, threads: usize) {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let words =
        ["--frames", "0..2", "--first-iterations", "20", "--iterations", "6", "--device", "cpu", "--quiet"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.arg("run").arg(sample).arg("--out").arg(out).args(words);
    command.args(["--train-views", "trk000,trk004,trk008,trk012"]);
    let output = command.env("RAYON_NUM_THREADS", threads.to_string()).stdin(Stdio::null()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let folder = TempDir::new().unwrap();
    let out = |threads: usize| folder.path().join(threads.to_string());
    let of = |threads: usize| -> Vec<_> {
        run(&out(threads), threads);
        let found = results(&out(threads)).into_iter();
        found.map(|(path, bytes)| (path.strip_prefix(out(threads)).unwrap().to_owned(), bytes)).collect()
    };
    let expected = of(1);
    assert!(expected.len() > 10, "states, splats, skies, pictures");
    for threads in [2, 3, 8] {
        let found = of(threads);
        assert_eq!(expected.len(), found.len());
        for ((name, a), (other, b)) in expected.iter().zip(&found) {
            assert!(name == other && a == b, "{} with {threads} threads", name.display());
        }
    }
}
