//! What a run says of its motion initialisation, on two frames of the sample with next to no training.

use ffgs_pipeline::cli::{FrameRange, Init, LogArgs};
use ffgs_pipeline::config::Config;
use ffgs_pipeline::device::Device;
use ffgs_pipeline::motion_eval::{MotionEvalArgs, Places, motion_eval};
use ffgs_pipeline::record::{FrameRecord, Metrics, RunFolder, read_json};
use ffgs_pipeline::run::{RunRequest, run};
use ffgs_trainer::StaticMethod;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini")
}

/// Two frames whose second takes so many steps in the dynamic lane, and none in the others.
fn request(out: &Path, steps: usize) -> RunRequest {
    let mut config = Config::default();
    config.first_frame.iterations = 3;
    config.dynamic.iterations = steps;
    config.background.static_method = StaticMethod::Steps;
    config.background.static_iterations = 0;
    config.background.sky_iterations = 0;
    RunRequest {
        capture: sample(),
        out: out.to_owned(),
        resume: false,
        init: Init::Fused,
        frames: Some(FrameRange { start: 0, end: Some(2) }),
        train_views: Some(["trk000", "trk004", "trk008"].map(str::to_owned).to_vec()),
        first_frame: None,
        device: Device::Cpu,
        quiet: true,
        config,
    }
}

fn metrics(out: &Path) -> Metrics {
    read_json(&out.join("metrics.json")).unwrap()
}

fn mpsnr(frame: &FrameRecord) -> f64 {
    let values: Vec<f64> = frame.views.iter().filter_map(|v| v.mpsnr).collect();
    assert!(values.len() > 1);
    values.iter().sum::<f64>() / values.len() as f64
}

fn report(out: &Path) -> String {
    fs::read_to_string(out.join("report.html")).unwrap()
}

#[test]
fn the_initialisation_is_graded_as_it_was_before_finetuning() {
    let folder = TempDir::new().unwrap();
    let [untouched, finetuned] = ["untouched", "finetuned"].map(|name| folder.path().join(name));
    run(&request(&untouched, 0)).unwrap();
    run(&RunRequest { first_frame: Some(untouched.clone()), ..request(&finetuned, 3) }).unwrap();
    let (a, b) = (metrics(&untouched), metrics(&finetuned));
    let grade = a.frames[1].initial_mpsnr.unwrap();
    assert!((grade - mpsnr(&a.frames[1])).abs() < 1e-9, "{grade}, nothing was finetuned");
    assert_eq!(b.frames[1].initial_mpsnr, Some(grade));
    assert!((mpsnr(&b.frames[1]) - grade).abs() > 1e-3, "finetuning changed nothing");
    for (metrics, out) in [(&a, &untouched), (&b, &finetuned)] {
        assert_eq!(metrics.frames[0].initial_mpsnr, None);
        assert_eq!(metrics.mean.initial_mpsnr, Some(grade));
        assert!(report(out).contains("initialisation alone"));
    }
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
    let args = MotionEvalArgs {
        capture: Some(capture),
        simulate: false,
        run: Some(run.to_owned()),
        places: Places::True,
        frames: Some(FrameRange { start: 1, end: Some(2) }),
        config: None,
        json: None,
        ablations: false,
        per_frame: false,
        log: LogArgs { quiet: true, ..LogArgs::default() },
    };
    motion_eval(&args).unwrap();
}

#[test]
fn the_accuracy_of_the_motion_is_in_the_report_of_a_run_on_the_same_capture_until_a_frame_is_added() {
    const PLOT: &str = "truth inside the ellipsoid";
    let folder = TempDir::new().unwrap();
    let (out, other) = (folder.path().join("run"), folder.path().join("other"));
    run(&request(&out, 0)).unwrap();
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
    run(&RunRequest { resume: true, frames, ..request(&out, 0) }).unwrap();
    assert!(!accuracy.exists() && !report(&out).contains(PLOT), "it was of the run before");
}
