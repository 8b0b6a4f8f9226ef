//! A run that keeps the Gaussians of few frames: it ends as one that keeps all, goes on, and says what is not there.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const FEW: [&str; 9] = [
    "--quiet",
    "--device",
    "cpu",
    "--train-views",
    "trk000,trk004,trk008",
    "--first-iterations",
    "4",
    "--iterations",
    "3",
];

fn ffgs(words: &[&str], run: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.args(words).arg(run).stdin(Stdio::null()).stdout(Stdio::null());
    command
}

fn run(out: &Path, more: &[&str]) {
    succeeds(&mut run_command(out, more));
}

fn run_command(out: &Path, more: &[&str]) -> Command {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let mut command = ffgs(&["run", "--out"], out);
    command.arg(sample).args(FEW).args(more);
    command
}

/// What it said on the standard error.
fn succeeds(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{command:?}: {said}");
    said
}

fn state(run: &Path, frame: usize) -> PathBuf {
    run.join(format!("frames/{frame:06}/state.ffgs"))
}

fn kept(run: &Path) -> Vec<usize> {
    (0..5).filter(|&frame| state(run, frame).exists()).collect()
}

#[test]
fn a_thinned_run_goes_on_is_measured_and_exported_and_says_what_is_missing() {
    let place = tempfile::tempdir().unwrap();
    let [all, thin] = ["all", "thin"].map(|name| place.path().join(name));
    run(&all, &["--frames", "0..5"]);
    run(&thin, &["--frames", "0..4", "--keep", "2"]);
    assert_eq!(kept(&thin), [0, 2, 3]);
    // As an interrupted run leaves it: marked, and not removed yet.
    let half = thin.join("frames/000001/static.ply");
    fs::write(&half, "x").unwrap();
    run(&thin, &["--frames", "0..5", "--keep", "2", "--resume"]);
    assert_eq!((kept(&all), kept(&thin)), (vec![0, 1, 2, 3, 4], vec![0, 2, 4]));
    assert!(!half.exists() && !thin.join("frames/000003/dynamic.ply").exists());
    for frame in [0, 2, 4] {
        assert!(
            fs::read(state(&all, frame)).unwrap() == fs::read(state(&thin, frame)).unwrap(),
            "frame {frame}"
        );
    }
    // As killed after frame 4 was finished, before frame 3 was thinned.
    let [whole, thinned] = [&all, &thin].map(|run| run.join("frames/000003"));
    for file in fs::read_dir(whole).unwrap().map(|entry| entry.unwrap().path()).filter(|file| file.is_file())
    {
        fs::copy(&file, thinned.join(file.file_name().unwrap())).unwrap();
    }
    fs::remove_file(thinned.join("thinned")).unwrap();
    run(&thin, &["--frames", "0..5", "--keep", "2", "--resume"]);
    assert_eq!(kept(&thin), [0, 2, 4]);
    let shorter = run_command(&thin, &["--frames", "0..4", "--keep", "2", "--resume"]).output().unwrap();
    let said = String::from_utf8(shorter.stderr).unwrap();
    assert!(!shorter.status.success() && said.contains("Gaussians of frame 3 (--keep)"), "{said}");
    let described = fs::read_to_string(thin.join("run.json")).unwrap();
    assert!(described.contains("\"end\": 5"), "{described}");

    succeeds(&mut ffgs(&["eval", "--quiet", "--device", "cpu"], &thin));
    let metrics: serde_json::Value =
        serde_json::from_slice(&fs::read(thin.join("metrics.json")).unwrap()).unwrap();
    let frames = metrics["frames"].as_array().unwrap();
    assert_eq!(frames.iter().map(|f| f["frame"].as_u64().unwrap()).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    assert!(frames[1]["views"][0]["psnr"].as_f64().is_some() && thin.join("report.html").is_file());
    let said = succeeds(&mut ffgs(&["export", "--to", "ply-seq", "--native"], &thin));
    assert!(said.contains("left out: 2 frames whose"), "{said}");
    let refused = ffgs(&["render", "--orbit", "--frame", "3"], &thin).output().unwrap();
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(!refused.status.success() && said.contains("were not kept"), "{said}");
}
