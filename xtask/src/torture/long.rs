//! A long run that is killed again and again: by hand, because it takes the better part of an hour.

use super::capture;
use super::case::{Case, equal_runs, run_words, said};
use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

const FRAMES: usize = 300;
const KILLS: usize = 100;

/// A run of many frames, killed at random moments until it has been killed so many times, ends with the bytes of one that
/// was never stopped: states, splats, metrics and report.
pub fn killed_a_hundred_times(case: &mut Case) -> Result<()> {
    let laboratory = case.laboratory;
    // The folder of the case is copied when it fails: all of it is evidence.
    let folder = case.path("long");
    let [capture, whole, killed] = ["capture", "whole", "killed"].map(|name| folder.join(name));
    capture::cut(&laboratory.root, &capture, FRAMES)?;
    capture::close_circle(&capture)?;
    let start = Instant::now();
    let output = case.started("", &run_words(&capture, &whole, &[])).output()?;
    ensure!(output.status.success(), "the undisturbed run failed: {}", said(&output));
    let seconds = start.elapsed().as_secs_f64();
    println!("{FRAMES} frames, never stopped: {seconds:.0} s");
    let kills = kill_on_the_way(case, &capture, &killed, seconds)?;
    let output = case.started("", &run_words(&capture, &killed, &["--resume"])).output()?;
    ensure!(output.status.success(), "the resumed run failed: {}", said(&output));
    let compared = equal_runs(&whole, &killed, laboratory.no_interposer().is_none())?;
    println!("killed {kills} times, {compared} files compared, in {:.0} s", start.elapsed().as_secs_f64());
    ensure!(kills >= KILLS, "it ended after {kills} kills");
    Ok(())
}

/// Starts it again and again; each time it gets a random while, and all of them together about the time that it needs.
fn kill_on_the_way(case: &mut Case, capture: &Path, out: &Path, seconds: f64) -> Result<usize> {
    let words = run_words(capture, out, &["--resume"]);
    let while_ms = (2000.0 * seconds / KILLS as f64) as usize;
    for kills in 0..KILLS {
        let mut child = case.started("", &words).spawn().context("cannot start the program")?;
        let before = finished(out);
        // A start that costs more than the while would never get further: wait for one frame at times.
        let patience = Instant::now() + Duration::from_millis(case.below(while_ms.max(1)) as u64);
        let further = case.below(2) == 0;
        while Instant::now() < patience || (further && finished(out) == before) {
            if child.try_wait()?.is_some() {
                return Ok(kills);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        child.kill().context("cannot kill the program")?;
        child.wait()?;
    }
    Ok(KILLS)
}

/// Finished frames of a run.
fn finished(out: &Path) -> usize {
    let frames = fs::read_dir(out.join("frames")).into_iter().flatten().flatten();
    frames.filter(|frame| frame.path().join("state.ffgs").exists()).count()
}
