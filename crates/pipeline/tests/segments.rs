//! A capture in parts: two workers at the same time, one of them killed, end as one machine that was never stopped.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const VIEWS: &str = "trk000,trk004,trk008";
/// The frames 0 to 3 in two parts that meet in frame 2.
const PLAN: [&str; 14] = [
    "--length",
    "2",
    "--frames",
    "..4",
    "--train-views",
    VIEWS,
    "--first-iterations",
    "4",
    "--iterations",
    "40",
    "--scout-iterations",
    "3",
    "--key-iterations",
    "40",
];

fn ffgs(words: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.args(words).stdin(Stdio::null()).stdout(Stdio::null());
    command
}

fn plan(folder: &Path) -> Command {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let mut command = ffgs(&["segment", "plan"]);
    command.arg(sample).arg("--out").arg(folder).args(PLAN);
    command
}

fn work(folder: &Path, job: &[&str]) -> Command {
    let mut command = ffgs(&["segment", "run", "--quiet", "--device", "cpu"]);
    command.arg(folder).args(job);
    command
}

fn join(folder: &Path) -> Command {
    let mut command = ffgs(&["segment", "join", "--quiet"]);
    command.arg(folder);
    command
}

fn succeeds(command: &mut Command) {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
}

fn refused(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{command:?}");
    String::from_utf8(output.stderr).unwrap()
}

fn state(run: &Path, frame: usize) -> PathBuf {
    run.join(format!("frames/{frame:06}/state.ffgs"))
}

#[test]
fn two_workers_one_of_them_killed_end_as_one_machine() {
    let place = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| place.path().join(name));
    assert!(refused(&mut work(&one, &[])).contains("ffgs segment plan"));
    [&one, &two].into_iter().for_each(|folder| succeeds(&mut plan(folder)));
    succeeds(&mut plan(&one));
    assert!(refused(plan(&one).args(["--seed", "2"])).contains("holds another plan"));
    assert!(refused(&mut work(&two, &["--only", "1"])).contains("--only scout1"));
    assert!(refused(&mut work(&two, &["--only", "scout1"])).contains("--only first"));
    assert!(refused(&mut work(&two, &["--only", "first", "--memory", "60"])).contains("--memory"));
    assert!(refused(&mut join(&two)).contains("part 0 is not finished"));
    succeeds(&mut work(&one, &[]));
    succeeds(&mut join(&one));

    succeeds(&mut work(&two, &["--only", "first"]));
    assert!(refused(&mut work(&two, &["--only", "scout2"])).contains("scout1 to scout1"));
    succeeds(&mut work(&two, &["--only", "scout1"]));
    let mut other = work(&two, &["--only", "0"]).spawn().unwrap();
    let mut killed = work(&two, &["--only", "1"]).spawn().unwrap();
    let patience = Instant::now() + Duration::from_mins(2);
    while !state(&two.join("part001"), 2).exists() && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(5));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert!(!state(&two.join("part001"), 3).exists(), "killed after its key frame, before its last");
    assert!(other.wait().unwrap().success());
    succeeds(&mut work(&two, &["--only", "1"]));
    succeeds(&mut join(&two));

    for frame in 0..4 {
        let [a, b] = [&one, &two].map(|folder| fs::read(state(&folder.join("joined"), frame)).unwrap());
        assert!(a == b, "frame {frame}");
    }
    let joined = one.join("joined");
    // As of a join that was killed on a disk without links, and of parts that had more files.
    let [cut, old] = ["static.ply", "test/old.png"].map(|name| joined.join("frames/000003").join(name));
    fs::remove_file(&cut).unwrap();
    [&cut, &old].into_iter().for_each(|file| fs::write(file, "cut").unwrap());
    succeeds(&mut join(&one));
    assert!(fs::read(&cut).unwrap() == fs::read(one.join("part001/frames/000003/static.ply")).unwrap());
    assert!(!old.exists());
    assert_ne!(fs::read(state(&joined, 3)).unwrap(), fs::read(state(&one.join("scout"), 2)).unwrap());
    let seams: serde_json::Value =
        serde_json::from_slice(&fs::read(joined.join("seams.json")).unwrap()).unwrap();
    assert_eq!((seams.as_array().unwrap().len(), seams[0]["frame"].as_u64()), (1, Some(2)));
    assert!(seams[0]["ids_kept"].as_u64().unwrap() > 0);
    let mut eval = ffgs(&["eval", "--no-vmaf", "--quiet", "--device", "cpu"]);
    succeeds(eval.arg(&joined));
    let mut export = ffgs(&["export", "--quiet", "--to", "ply-seq", "--native"]);
    succeeds(export.arg(&joined));
    assert!(joined.join("report.html").is_file());
}
