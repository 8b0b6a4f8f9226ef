//! Exports for viewers without opacity compensation.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

/// Runs `ffgs` and returns what it printed.
fn ffgs(words: &[&str], folders: &[&Path]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    let output = command.args(words).args(folders).stdin(Stdio::null()).output().unwrap();
    assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The static layer of frame 0 is gone in frame 1 of most other methods, which move everything.
#[test]
fn every_frame_of_a_method_without_layers_is_exported() {
    let place = tempfile::tempdir().unwrap();
    let [run, files] = ["run", "files"].map(|name| place.path().join(name));
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let views = "trk000,trk004,trk008";
    let few = ["--first-iterations", "4", "--iterations", "3", "--frames", "0..2", "--train-views", views];
    let words = ["run", "--quiet", "--device", "cpu", "--method", "hicom"];
    ffgs(&[&words[..], &few, &["--out"]].concat(), &[&run, &sample]);
    let words = ["export", "--quiet", "--to", "ply-seq", "--bake-iterations", "6", "--measure", "--out"];
    let said = ffgs(&words, &[&files, &run]);
    // After the frame, a row has the PSNR of the run and of the export, and the change; of all pixels first.
    let change = |row: &str| -> f64 {
        let row = said.lines().find(|line| line.split_whitespace().next() == Some(row));
        row.and_then(|row| row.split_whitespace().nth(3)?.parse().ok()).unwrap_or_else(|| panic!("{said}"))
    };
    assert!(["0", "1", "mean"].iter().all(|row| change(row).abs() < 3.0), "{said}");
    let bytes = |name: &str| fs::read(files.join(name)).unwrap();
    assert_ne!(bytes("frame_0000.ply"), bytes("frame_0001.ply"));
}
