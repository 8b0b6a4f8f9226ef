//! The Snakemake workflow: two workers, one of them killed in a part, end as one machine that was never stopped.
//!
//! Needs Snakemake: the program that the environment variable `FFGS_SNAKEMAKE` names, else `snakemake` on the path.
#![cfg(unix)]

use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The frames 0 to 3 in two parts that meet in frame 2; the second part works long enough to be killed.
const FRAMES: [&str; 4] = ["--length", "2", "--frames", "..4"];
const SETTINGS: &str = "[first_frame]\niterations = 4\n[dynamic]\niterations = 60\n";

fn snakemake() -> Option<PathBuf> {
    let program = std::env::var_os("FFGS_SNAKEMAKE").map_or_else(|| "snakemake".into(), PathBuf::from);
    let version = Command::new(&program).arg("--version").stdin(Stdio::null()).output();
    version.is_ok_and(|output| output.status.success()).then_some(program)
}

/// The sample with three of its training views and one test view.
fn few_views(root: &Path) {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    for (file, keep) in [("train_meta.json", vec![0, 4, 8]), ("test_meta.json", vec![0])] {
        let mut meta: Value = serde_json::from_slice(&fs::read(sample.join(file)).unwrap()).unwrap();
        for key in ["k", "w2c", "fn", "cam_id"] {
            for row in meta[key].as_array_mut().unwrap() {
                *row = keep.iter().map(|&c| row[c].clone()).collect();
            }
        }
        fs::write(root.join(file), meta.to_string()).unwrap();
    }
    for name in ["ims", "seg", "tracks", "init_pt_cld.npz"] {
        std::os::unix::fs::symlink(fs::canonicalize(sample.join(name)).unwrap(), root.join(name)).unwrap();
    }
}

fn workflow(capture: &Path, settings: &Path, folder: &Path) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.arg("workflow").arg(capture).arg("--out").arg(folder).args(FRAMES).arg("--config").arg(settings);
    succeeds(&command.output().unwrap());
}

fn on_cores(snakemake: &Path, folder: &Path, cores: &str) -> Command {
    let mut command = Command::new(snakemake);
    command.current_dir(folder).args(["--profile", "profiles/laptop", "--cores", cores]);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn succeeds(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Kills the run that holds `run.lock` once the part's key frame is finished.
fn kill_after(key_frame: &Path, lock: &Path) {
    let patience = Instant::now() + Duration::from_mins(3);
    while !key_frame.exists() {
        assert!(Instant::now() < patience, "no {}", key_frame.display());
        std::thread::sleep(Duration::from_millis(5));
    }
    let holder: Value = serde_json::from_slice(&fs::read(lock).unwrap()).unwrap();
    let killed = Command::new("kill").args(["-9", &holder["pid"].to_string()]).status().unwrap();
    assert!(killed.success());
}

#[test]
fn a_killed_worker_costs_the_frame_it_was_at() {
    let Some(snakemake) = snakemake() else {
        eprintln!("skipped: no Snakemake here; pip install snakemake, or name it in FFGS_SNAKEMAKE");
        return;
    };
    let place = TempDir::new().unwrap();
    let [capture, one, two] = ["cut", "one", "two"].map(|name| place.path().join(name));
    let settings = place.path().join("few.toml");
    fs::write(&settings, SETTINGS).unwrap();
    fs::create_dir(&capture).unwrap();
    few_views(&capture);
    [&one, &two].into_iter().for_each(|folder| workflow(&capture, &settings, folder));
    succeeds(&on_cores(&snakemake, &one, "1").output().unwrap());

    let run = "cut-trackers-1";
    let part = two.join(run).join("part001");
    let workers = on_cores(&snakemake, &two, "2").spawn().unwrap();
    kill_after(&part.join("frames/000002/state.ffgs"), &part.join("run.lock"));
    let told = workers.wait_with_output().unwrap();
    assert!(!told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
    let done = |job: &str| two.join("done").join(run).join(job).exists();
    assert!(done("part0") && !done("part1") && !part.join("frames/000003/state.ffgs").exists());
    succeeds(&on_cores(&snakemake, &two, "2").output().unwrap());

    for frame in 0..4 {
        let state = |folder: &Path| {
            fs::read(folder.join(run).join(format!("joined/frames/{frame:06}/state.ffgs"))).unwrap()
        };
        assert!(state(&one) == state(&two), "frame {frame}");
    }
    let table = fs::read_to_string(two.join("table.md")).unwrap();
    assert!(table.contains("[cut-trackers-1](cut-trackers-1/joined/report.html) | 4 |"), "{table}");
    let page = fs::read_to_string(two.join("report.html")).unwrap();
    assert!(page.contains(r#"<a href="cut-trackers-1/joined/report.html">"#), "{page}");
}

/// A finished run of so many frames: PSNR falls by 1 dB per frame, and one view has no figure of the foreground.
fn finished(folder: &Path, frames: usize) {
    let view = |psnr: f64, mpsnr: Option<f64>| json!({ "camera": "c", "psnr": psnr, "mpsnr": mpsnr });
    let frame = |f: usize| {
        let psnr = 30.0 - f as f64;
        json!({ "frame": f, "views": [view(psnr, None), view(psnr - 2.0, Some(20.0))], "peak_memory_mib": 300.0 + psnr })
    };
    let mean = json!({ "psnr": 27.5, "mpsnr": 20.0, "ssim": 0.9, "vmaf": null, "seconds_per_frame": 2.0 });
    let frames: Vec<Value> = (0..frames).map(frame).collect();
    fs::create_dir_all(folder).unwrap();
    fs::write(folder.join("metrics.json"), json!({ "mean": mean, "frames": frames }).to_string()).unwrap();
}

#[test]
fn one_page_shows_all_runs() {
    let place = TempDir::new().unwrap();
    let folder = place.path();
    finished(&folder.join("parts/joined"), 3);
    finished(&folder.join("whole"), 4);
    let seams = json!([{ "frame": 2, "psnr": [28.0, 27.9], "mpsnr": [20.0, 20.25] }]);
    fs::write(folder.join("parts/joined/seams.json"), seams.to_string()).unwrap();
    let pictures = folder.join("whole/frames/000003/test");
    fs::create_dir_all(&pictures).unwrap();
    fs::write(pictures.join("c.png"), "a picture").unwrap();
    let runs = json!({ "parts": { "parts": 2, "command": "" }, "whole": { "parts": 0, "command": "" } });
    fs::write(folder.join("config.json"), json!({ "runs": runs }).to_string()).unwrap();
    let printed = |script: &str| {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("workflow").join(script);
        let output =
            Command::new("python3").arg("-B").arg(script).arg("config.json").current_dir(folder).output();
        let output = output.expect("Python 3");
        succeeds(&output);
        String::from_utf8(output.stdout).unwrap()
    };
    let table = printed("table.py");
    let rows = [
        "| [parts](parts/joined/report.html) | 3 | 27.50 | 20.00 | 0.9000 | - | 2.00 | 330 | 0.25 |",
        "| [whole](whole/report.html) | 4 | 27.50 | 20.00 | 0.9000 | - | 2.00 | 330 | - |",
    ];
    assert!(rows.iter().all(|row| table.contains(row)), "{table}");
    let page = printed("report.py");
    let count = |part: &str| page.matches(part).count();
    assert_eq!([count("<polyline"), count(r#"class="seam""#), count("<img")], [4, 2, 1], "{page}");
    assert!(page.contains(r#"src="whole/frames/000003/test/c.png""#), "{page}");
    let points =
        page.split("points=\"").skip(1).map(|line| line.split('"').next().unwrap().split(' ').count());
    assert_eq!(points.collect::<Vec<_>>(), [3, 4, 3, 4], "both figures of both runs, a point per frame");
}
