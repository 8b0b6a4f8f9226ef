//! A long run that is killed again and again: by hand, because it takes many minutes.

use super::case::{Case, WALL_SECONDS, equal_runs, run_words, said};
use super::circling;
use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

const FRAMES: usize = 300;
const KILLS: usize = 100;
/// A start is let to finish fewer frames than this, a random number of them: 1.5 at a mean, so that all kills come before the
/// end.
const FRAMES_A_START: usize = 4;

/// A run of many frames, killed at random moments until it has been killed so many times, ends with the bytes of one that
/// was never stopped: states, splats, metrics and report.
pub(crate) fn killed_a_hundred_times(case: &mut Case) -> Result<()> {
    let laboratory = case.laboratory;
    // The folder of the case is copied when it fails: all of it is evidence.
    let folder = case.path("long");
    let [capture, whole, killed] = ["capture", "whole", "killed"].map(|name| folder.join(name));
    circling::write(&capture, FRAMES)?;
    let start = Instant::now();
    let output = case.started("", &run_words(&capture, &whole, &[])).output()?;
    ensure!(output.status.success(), "the undisturbed run failed: {}", said(&output));
    let seconds = start.elapsed().as_secs_f64();
    println!("{FRAMES} frames, never stopped: {seconds:.0} s");
    let frame_ms = (1000.0 * seconds / FRAMES as f64) as usize;
    for _ in 0..KILLS {
        kill_on_the_way(case, &capture, &killed, frame_ms)?;
    }
    let frames = finished(&killed);
    println!("killed {KILLS} times within {frames} frames, {:.0} s", start.elapsed().as_secs_f64());
    let output = case.started("", &run_words(&capture, &killed, &["--resume"])).output()?;
    ensure!(output.status.success(), "the resumed run failed: {}", said(&output));
    let compared = equal_runs(&whole, &killed, laboratory.no_interposer().is_none())?;
    println!("resumed to its end, {compared} files compared, {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

/// Starts it, and kills it at a random moment of the frame after some frames.
fn kill_on_the_way(case: &mut Case, capture: &Path, out: &Path, frame_ms: usize) -> Result<()> {
    let mut command = case.started("", &run_words(capture, out, &["--resume"]));
    // Nobody reads: a pipe that is full would hold the program.
    let mut child =
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().context("cannot start the program")?;
    let enough = finished(out) + case.below(FRAMES_A_START);
    let moment = Duration::from_millis(case.below(frame_ms.max(1)) as u64);
    let start = Instant::now();
    while finished(out) < enough {
        ensure!(child.try_wait()?.is_none(), "it ended before it was killed");
        ensure!(start.elapsed().as_secs() < WALL_SECONDS, "no frame within {WALL_SECONDS} s");
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(moment);
    child.kill().context("cannot kill the program")?;
    child.wait()?;
    Ok(())
}

/// Finished frames of a run.
fn finished(out: &Path) -> usize {
    let frames = fs::read_dir(out.join("frames")).into_iter().flatten().flatten();
    frames.filter(|frame| frame.path().join("state.ffgs").exists()).count()
}
