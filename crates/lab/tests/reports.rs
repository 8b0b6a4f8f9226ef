//! The accuracy of the motion in the report of a run, on two frames of the sample with next to no training.

use ffgs_lab::evaluation::SourceArgs;
use ffgs_lab::motion_eval::{self, MotionEvalArgs};
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::job::device::Device;
use ffgs_pipeline::job::request::{FrameRange, RunRequest};
use ffgs_pipeline::job::run::run;
use ffgs_pipeline::outputs::folder::RunFolder;
use ffgs_pipeline::outputs::json::read_json;
use ffgs_pipeline::settings::config::Config;
use ffgs_trainer::StaticMethod;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini")
}

/// Two frames, the second of which is not finetuned.
fn request(out: &Path) -> RunRequest {
    let mut config = Config::default();
    config.first_frame.iterations = 3;
    config.dynamic.iterations = 0;
    config.background.static_method = StaticMethod::Steps;
    config.background.static_iterations = 0;
    config.background.sky_iterations = 0;
    RunRequest {
        capture: sample(),
        out: out.to_owned(),
        resume: false,
        method: None,
        frames: Some(FrameRange { start: 0, end: Some(2) }),
        train_views: Some(["trk000", "trk004", "trk008"].map(str::to_owned).to_vec()),
        first_frame: None,
        refine_first: None,
        keep: None,
        memory: None,
        device: Device::Cpu,
        quiet: true,
        config,
    }
}

fn report(out: &Path) -> String {
    fs::read_to_string(out.join("report.html")).unwrap()
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Scores the second frame.
fn score(capture: PathBuf, run: &Path) {
    let source = SourceArgs {
        run: Some(run.to_owned()),
        frames: Some(FrameRange { start: 1, end: Some(2) }),
        log: LogArgs { quiet: true, ..LogArgs::default() },
        ..SourceArgs::default()
    };
    motion_eval::run(&MotionEvalArgs { capture, source, ..MotionEvalArgs::default() }).unwrap();
}

#[test]
fn the_accuracy_of_the_motion_is_in_the_report_of_a_run_on_the_same_capture_until_a_frame_is_added() {
    const PLOT: &str = "truth inside the ellipsoid";
    let folder = TempDir::new().unwrap();
    let (out, other) = (folder.path().join("run"), folder.path().join("other"));
    run(&request(&out)).unwrap();
    let accuracy = RunFolder(out.clone()).motion_accuracy();
    let before = report(&out);

    copy(&sample(), &other);
    score(other, &out);
    assert!(!accuracy.exists() && report(&out) == before, "another capture");

    score(sample().join("../fairmont-mini"), &out);
    let found: Vec<ffgs_report::MotionAccuracy> = read_json(&accuracy).unwrap();
    let fused = found.iter().find(|a| a.name == "fused").unwrap();
    assert!(found.len() > 1 && fused.measured > 0.5 && fused.median_cm > 0.0);
    assert!((fused.shares.iter().sum::<f64>() - 1.0).abs() < 1e-9);
    assert!(!before.contains(PLOT) && report(&out).contains(PLOT));

    let frames = Some(FrameRange { start: 0, end: Some(3) });
    run(&RunRequest { resume: true, frames, ..request(&out) }).unwrap();
    assert!(!accuracy.exists() && !report(&out).contains(PLOT), "it was of the run before");
}
