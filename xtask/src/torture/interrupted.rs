//! Runs that are stopped or starved: what is finished stays, and the rest is made up for.

use super::case::{Case, equal_runs, judged, run_words, said};
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Child, Command};
use std::time::Duration;

/// Stops before a run is let to its end.
const MOST_STOPS: usize = 4;
/// A run takes about so long (ms); stops are spread over it.
const RUN_MS: usize = 4000;

/// Killed at random moments, resumed with other numbers of threads: the bytes of a run that was never stopped.
pub(crate) fn killed(case: &mut Case) -> Result<()> {
    stop_and_resume(case, &["KILL"])
}

/// The same with signals that a program hears.
pub(crate) fn signalled(case: &mut Case) -> Result<()> {
    stop_and_resume(case, &["TERM", "HUP", "INT"])
}

fn stop_and_resume(case: &mut Case, signals: &[&str]) -> Result<()> {
    let out = case.path("out");
    let words = run_words(&case.laboratory.capture(), &out, &["--resume"]);
    for _ in 0..=case.below(MOST_STOPS) {
        let mut child = case.limited("", &words).spawn().context("cannot start the program")?;
        std::thread::sleep(Duration::from_millis(case.below(RUN_MS) as u64));
        let signal = case.one_of(signals);
        stop(&child, signal)?;
        let ended = child.wait()?;
        ensure!(ended.code() != Some(101), "a panic at a signal");
        whole_frames(&out)?;
    }
    finish(case, &out)
}

fn stop(child: &Child, signal: &str) -> Result<()> {
    // It may have ended by itself.
    Command::new("kill")
        .args(["-s", signal, &child.id().to_string()])
        .output()
        .context("cannot start kill")?;
    Ok(())
}

fn finish(case: &mut Case, out: &Path) -> Result<()> {
    let (capture, whole) = (case.laboratory.capture(), case.laboratory.run());
    resume_to_equal(case, &capture, &whole, out)
}

/// Resumes a run of a capture without limits and compares it with one that was never stopped.
pub(crate) fn resume_to_equal(case: &mut Case, capture: &Path, whole: &Path, out: &Path) -> Result<()> {
    let output = case.ffgs(&run_words(capture, out, &["--resume"]))?;
    ensure!(output.status.success(), "the resumed run failed: {}", said(&output));
    equals(case, whole, out)
}

fn equals(case: &Case, whole: &Path, out: &Path) -> Result<()> {
    equal_runs(whole, out, case.laboratory.no_interposer().is_none()).map(|_| ())
}

/// A frame that has a state has its numbers, and JSON files are whole.
pub(crate) fn whole_frames(out: &Path) -> Result<()> {
    for entry in fs::read_dir(out.join("frames")).into_iter().flatten().flatten() {
        let record = entry.path().join("frame.json");
        if entry.path().join("state.ffgs").exists() || record.exists() {
            let text = fs::read_to_string(&record).with_context(|| format!("no {}", record.display()))?;
            serde_json::from_str::<Value>(&text).with_context(|| format!("half of {}", record.display()))?;
        }
    }
    Ok(())
}

/// No file may be longer than a limit, as on a disk that is nearly full: an error that names a file, no rubbish.
pub(crate) fn short_of_disk(case: &mut Case) -> Result<()> {
    let out = case.path("out");
    let words = run_words(&case.laboratory.capture(), &out, &["--resume"]);
    // Blocks of 512 bytes; the signal is ignored, so that writing fails as on a full disk.
    let blocks = 1 << (1 + case.below(14));
    let output = judged(case.limited(&format!("trap '' XFSZ; ulimit -f {blocks};"), &words).output()?)?;
    ensure!(output.status.success() || said(&output).contains("/out/"), "which file? {}", said(&output));
    whole_frames(&out)?;
    finish(case, &out)
}

/// Little address space: the program may be ended by the allocator, finished frames stay.
pub(crate) fn short_of_memory(case: &mut Case) -> Result<()> {
    let out = case.path("out");
    let words = run_words(&case.laboratory.capture(), &out, &["--resume"]);
    let kib = (60 + case.below(400)) << 10;
    let output = case.limited(&format!("ulimit -v {kib};"), &words).output()?;
    ensure!(output.status.code() != Some(101), "a panic under {kib} KiB: {}", said(&output));
    whole_frames(&out)?;
    finish(case, &out)
}

/// Two runs of different seeds in one folder: one is refused, and the folder is wholly that of the other.
pub(crate) fn concurrent(case: &mut Case) -> Result<()> {
    let out = case.path("out");
    let capture = case.laboratory.capture();
    let mut children = Vec::new();
    for seed in ["1", "2"] {
        let words = run_words(&capture, &out, &["--seed", seed]);
        children.push(case.limited("", &words).spawn().context("cannot start the program")?);
        std::thread::sleep(Duration::from_millis(case.below(1500) as u64));
    }
    let outputs: Vec<_> = children.into_iter().map(Child::wait_with_output).collect::<Result<_, _>>()?;
    let ended: Vec<_> = outputs.into_iter().map(judged).collect::<Result<_>>()?;
    ensure!(ended.iter().filter(|output| output.status.success()).count() == 1, "not one run of the two");
    let text = fs::read_to_string(out.join("run.json"))?;
    let seed = serde_json::from_str::<Value>(&text)?["config"]["seed"].as_u64();
    let first = ended[0].status.success();
    ensure!(seed == Some(if first { 1 } else { 2 }), "run.json is of seed {seed:?}");
    if first { equals(case, &case.laboratory.run(), &out) } else { Ok(()) }
}
