//! What a run does when something goes wrong: nothing finished is lost, nothing wrong goes on, and the message says which.

use serde_json::{Value, json};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use tempfile::TempDir;

/// As little training as shows a difference.
const FEW: [&str; 6] = ["--first-iterations", "4", "--iterations", "3", "--device", "cpu"];

/// Three frames of the sample: three training views, one test view, all trackers. Made once; tests that change a
/// capture copy it.
fn small() -> &'static Path {
    static SMALL: OnceLock<TempDir> = OnceLock::new();
    SMALL.get_or_init(|| cut(3)).path()
}

fn cut(frames: usize) -> TempDir {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let folder = TempDir::new().unwrap();
    let root = folder.path();
    let mut names = Vec::new();
    for (file, keep) in [("train_meta.json", vec![0, 4, 8]), ("test_meta.json", vec![0])] {
        let mut meta: Value = serde_json::from_slice(&fs::read(sample.join(file)).unwrap()).unwrap();
        for key in ["k", "w2c", "fn", "cam_id"] {
            let all = meta[key].as_array().unwrap()[..frames].iter();
            meta[key] = all.map(|row| keep.iter().map(|&c| row[c].clone()).collect::<Value>()).collect();
        }
        names.extend(meta["fn"].as_array().unwrap().iter().flat_map(|row| row.as_array().unwrap().clone()));
        fs::write(root.join(file), meta.to_string()).unwrap();
    }
    for name in names.iter().map(|name| name.as_str().unwrap()) {
        ["ims", "seg"].iter().for_each(|at| copy(&sample.join(at).join(name), &root.join(at).join(name)));
    }
    copy(&sample.join("init_pt_cld.npz"), &root.join("init_pt_cld.npz"));
    copy_folder(&sample.join("tracks"), &root.join("tracks"));
    folder
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to.parent().unwrap()).unwrap();
    fs::copy(from, to).unwrap();
}

fn copy_folder(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() { copy_folder(&entry.path(), &target) } else { copy(&entry.path(), &target) }
    }
}

fn ffgs(words: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.args(words).stdin(Stdio::null());
    command
}

fn run(capture: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = ffgs(&["run"]);
    command.arg(capture).arg("--out").arg(out).args(FEW).args(more);
    command
}

/// A run whose first frame does not end by itself.
#[cfg(unix)]
fn endless(out: &Path, more: &[&str]) -> Command {
    let mut command = ffgs(&["run", "--quiet", "--device", "cpu", "--first-iterations", "1000000", "--out"]);
    command.arg(out).arg(small()).args(more);
    command
}

/// A run that ends with the test, also where that fails.
#[cfg(unix)]
struct Running(std::process::Child);

#[cfg(unix)]
impl Drop for Running {
    fn drop(&mut self) {
        // It has ended before in a test that succeeds.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What an error printed.
fn refused(command: &mut Command) -> String {
    let Output { status, stderr, .. } = command.output().unwrap();
    let text = String::from_utf8(stderr).unwrap();
    assert!(status.code() == Some(1) && text.contains("error: "), "{status}: {text}");
    text
}

fn succeeds(command: &mut Command) {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}: {}", output.status, String::from_utf8_lossy(&output.stderr));
}

fn state(out: &Path, frame: usize) -> PathBuf {
    out.join(format!("frames/{frame:06}/state.ffgs"))
}

#[test]
fn without_trackers_a_run_is_refused_at_the_start_and_starts_without_motion() {
    let folder = TempDir::new().unwrap();
    let (capture, out) = (folder.path().join("cap"), folder.path().join("out"));
    copy_folder(small(), &capture);
    fs::remove_dir_all(capture.join("tracks")).unwrap();
    let told = refused(&mut run(&capture, &out, &["--quiet"]));
    assert!(told.contains("--method none") && !out.exists(), "{told}");
    succeeds(&mut run(&capture, &out, &["--quiet", "--method", "none", "--frames", "0..2"]));
    assert!(state(&out, 1).exists());
}

#[cfg(target_os = "linux")]
#[test]
fn streams_that_are_full_cost_their_text_and_the_exit_status_says_so() {
    let full = || File::options().write(true).open("/dev/full").unwrap();
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    for words in [&["config"][..], &["devices"], &["check", small().to_str().unwrap()]] {
        assert_eq!(ffgs(words).stdout(full()).status().unwrap().code(), Some(74), "{words:?}");
    }
    let status =
        run(small(), &out, &["-v", "--frames", "0..2"]).stdout(full()).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(74));
    assert!(state(&out, 1).exists() && out.join("report.html").exists());
    fs::remove_file(out.join("report.html")).unwrap();
    let eval = ffgs(&["eval", out.to_str().unwrap()]).stdout(full()).stderr(full()).status().unwrap();
    assert_eq!(eval.code(), Some(74));
    assert!(out.join("report.html").exists(), "what was measured is written before it is printed");
    let told = refused(ffgs(&["check", folder.path().join("none").to_str().unwrap()]).stdout(full()));
    assert!(told.contains("none"), "{told}");
}

/// Seconds, memory and what was read are measured anew; everything else must be equal.
fn comparable(out: &Path) -> Value {
    let mut metrics: Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    for mean in ["mean", "mean_trackside"] {
        for measured in ["seconds_per_frame", "psnr_per_second", "vmaf_per_second"] {
            metrics[mean][measured] = Value::Null;
        }
    }
    for frame in metrics["frames"].as_array_mut().unwrap() {
        for measured in ["seconds", "processor_seconds", "peak_memory_mib", "read_mib"] {
            frame[measured] = Value::Null;
        }
    }
    metrics
}

#[test]
fn a_run_of_odd_settings_goes_on_to_the_same_numbers_and_says_what_keeps_it() {
    let folder = TempDir::new().unwrap();
    let [whole, cut, settings] = ["whole", "cut", "settings.toml"].map(|name| folder.path().join(name));
    let odd =
        "marking.loss_warning = 0.47274908866546683\nfusion.correlation_inflation = 1.4339738824662747\n";
    fs::write(&settings, odd).unwrap();
    let with = ["--quiet", "--config", settings.to_str().unwrap()];
    let frames = |range: &'static str| [&with[..], &["--frames", range]].concat();
    succeeds(&mut run(small(), &whole, &frames("0..3")));
    succeeds(&mut run(small(), &cut, &frames("0..1")));
    let half = cut.join("frames/000000/state.ffgs.4711.part");
    fs::write(&half, "half").unwrap();
    succeeds(&mut run(small(), &cut, &[&frames("0..3")[..], &["--resume"]].concat()));
    assert!(!half.exists(), "what a killed run left is removed");
    assert_eq!(comparable(&cut), comparable(&whole));
    for frame in 0..3 {
        assert!(fs::read(state(&cut, frame)).unwrap() == fs::read(state(&whole, frame)).unwrap());
    }

    let told =
        refused(&mut run(small(), &cut, &[&frames("0..3")[..], &["--resume", "--seed", "7"]].concat()));
    assert!(told.contains("seed is 1 there and 7 here"), "{told}");
    fs::remove_file(cut.join("run.json")).unwrap();
    let told =
        refused(&mut run(small(), &cut, &[&frames("0..3")[..], &["--resume", "--seed", "7"]].concat()));
    assert!(told.contains("no run.json"), "{told}");
}

#[test]
fn a_capture_that_changed_is_noticed_and_a_moved_one_goes_on() {
    let folder = TempDir::new().unwrap();
    let [capture, moved, out, second] =
        ["cap", "moved", "out", "second"].map(|name| folder.path().join(name));
    copy_folder(small(), &capture);
    let frames = |range: &'static str| ["--quiet", "--resume", "--frames", range];
    succeeds(&mut run(&capture, &out, &frames("0..1")));
    fs::rename(&capture, &moved).unwrap();
    succeeds(&mut run(&moved, &out, &frames("0..2")));

    let image = moved.join("ims/trk000/000001.png");
    let photograph = fs::read(&image).unwrap();
    fs::copy(moved.join("ims/trk000/000000.png"), &image).unwrap();
    let told = refused(&mut run(&moved, &out, &frames("0..3")));
    assert!(told.contains("track of frame 1") && told.contains("000001"), "{told}");
    fs::write(&image, photograph).unwrap();

    let first = out.to_str().unwrap();
    let taken = ["--quiet", "--frames", "0..1", "--first-frame", first];
    succeeds(&mut run(&moved, &second, &taken));
    assert!(fs::read(state(&second, 0)).unwrap() == fs::read(state(&out, 0)).unwrap());
    let meta = moved.join("train_meta.json");
    let text = fs::read_to_string(&meta).unwrap();
    let mut changed: Value = serde_json::from_str(&text).unwrap();
    changed["k"][0][0][0][0] = json!(changed["k"][0][0][0][0].as_f64().unwrap() * 1.01);
    fs::write(&meta, changed.to_string()).unwrap();
    let told = refused(&mut run(&moved, &folder.path().join("third"), &taken));
    assert!(told.contains("--first-frame") && told.contains("another capture"), "{told}");
    let told = refused(&mut run(&moved, &out, &frames("0..3")));
    assert!(told.contains("capture_digest"), "{told}");
}

#[test]
fn what_cannot_be_run_is_refused_before_anything_is_written() {
    let folder = TempDir::new().unwrap();
    let (out, settings) = (folder.path().join("out"), folder.path().join("settings.toml"));
    fs::write(&settings, "first_frame.position_rate_end = 0.0").unwrap();
    for (more, words) in [
        (
            &["--config", settings.to_str().unwrap()][..],
            "first_frame.position_rate_end = 0.0: must be above 0",
        ),
        (&["--frames", "1.."], "--first-frame"),
        (&["--memory", "60"], "background.solve_memory_mib"),
        (&["--train-views", "trk000,trk000"], "trk000 is named twice"),
        (&["--seed", "18446744073709551615"], "seed = 18446744073709551615"),
    ] {
        let told = refused(&mut run(small(), &out, &[&["--quiet"], more].concat()));
        assert!(told.contains(words) && !out.exists(), "{told}");
    }
}

#[test]
fn a_folder_that_another_run_writes_into_is_left_alone() {
    let folder = TempDir::new().unwrap();
    let alive = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs();
    let holder = json!({ "boot": "another machine", "pid": 42, "taken": 1, "alive": alive });
    fs::write(folder.path().join("run.lock"), holder.to_string()).unwrap();
    let told = refused(&mut run(small(), folder.path(), &["--quiet"]));
    assert!(told.contains("another run writes into") && told.contains("process 42"), "{told}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[cfg(unix)]
#[test]
fn a_signal_ends_a_run_with_a_sentence_and_its_own_status() {
    use std::os::unix::process::ExitStatusExt;
    let folder = TempDir::new().unwrap();
    let log = folder.path().join("log");
    let out = folder.path().join("out");
    let mut command = endless(&out, &[]);
    let mut running = Running(command.stderr(File::create(&log).unwrap()).spawn().unwrap());
    let child = &mut running.0;
    while !out.join("run.json").exists() {
        assert!(child.try_wait().unwrap().is_none(), "{}", fs::read_to_string(&log).unwrap());
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert!(Command::new("kill").arg("-TERM").arg(child.id().to_string()).status().unwrap().success());
    assert_eq!(child.wait().unwrap().signal(), Some(15));
    let told = fs::read_to_string(&log).unwrap();
    assert!(told.contains("stopped by SIGTERM") && told.contains("--resume"), "{told}");
    // The lock of a run that was killed is free.
    let again = endless(&out, &["--resume", "--seed", "9"]).output();
    assert!(String::from_utf8(again.unwrap().stderr).unwrap().contains("seed is 1 there and 9 here"));
}
