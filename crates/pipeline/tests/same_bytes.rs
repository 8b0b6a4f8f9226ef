//! Numbers that stay the same: the bytes of a run for any number of threads, with each of the instruction sets that this machine has,
//! and how far the sets are from one another.

use serde_json::Value;
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

/// Sets of one machine may differ so much in the PSNR of a view (dB): 1.4e-5 was measured on the sample, and longer runs diverge.
const PSNR_TOLERANCE: f64 = 1e-3;

/// Two frames of the sample, every stage of the method in the second; `None` where the processor lacks the set.
fn run(out: &Path, set: &str, threads: usize) -> Option<()> {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let words =
        ["--frames", "0..2", "--first-iterations", "12", "--iterations", "4", "--device", "cpu", "--quiet"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.arg("run").arg(sample).arg("--out").arg(out).args(words);
    command.args(["--train-views", "trk000,trk008"]);
    command.env("FFGS_SIMD", set).env("RAYON_NUM_THREADS", threads.to_string());
    let output = command.stdin(Stdio::null()).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    if told.contains("FFGS_SIMD") {
        assert!(set != "scalar" && output.status.code() == Some(1), "{told}");
        return None;
    }
    assert!(output.status.success(), "{told}");
    Some(())
}

/// PSNR of each view of each frame.
fn psnr(out: &Path) -> Vec<f64> {
    let metrics: Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    let views = metrics["frames"].as_array().unwrap().iter().flat_map(|f| f["views"].as_array().unwrap());
    views.map(|view| view["psnr"].as_f64().unwrap()).collect()
}

fn assert_equal(a: &Path, b: &Path) {
    let named = |folder: &Path| -> Vec<_> {
        let found = results(folder).into_iter();
        found.map(|(path, bytes)| (path.strip_prefix(folder).unwrap().to_owned(), bytes)).collect()
    };
    let (expected, found) = (named(a), named(b));
    assert!(expected.len() > 10 && expected.len() == found.len(), "states, splats, skies, pictures");
    for ((name, a), (other, b)) in expected.iter().zip(&found) {
        assert!(name == other && a == b, "{} differs", name.display());
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes_with_each_instruction_set() {
    let folder = TempDir::new().unwrap();
    let out = |set: &str, threads: usize| folder.path().join(format!("{set}-{threads}"));
    // One set with many numbers of threads, the others with two.
    let matrix = [("scalar", &[1, 3][..]), ("avx2", &[1, 3]), ("avx512", &[1, 8])];
    let mut had = Vec::new();
    for (set, threads) in matrix {
        if threads.iter().all(|&threads| run(&out(set, threads), set, threads).is_some()) {
            threads[1..].iter().for_each(|&other| assert_equal(&out(set, threads[0]), &out(set, other)));
            had.push(set);
        }
    }
    for set in &had {
        let pairs = psnr(&out("scalar", 1)).into_iter().zip(psnr(&out(set, 1)));
        let most = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("{set} differs from scalar by {most:.2e} dB at most");
        assert!(most < PSNR_TOLERANCE, "{set}: {most} dB");
    }
    assert_eq!(had[0], "scalar");
}

#[test]
fn an_instruction_set_that_is_none_is_refused() {
    let output =
        Command::new(env!("CARGO_BIN_EXE_ffgs")).arg("methods").env("FFGS_SIMD", "sse9").output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && told.contains("scalar, avx2 or avx512"), "{told}");
}
