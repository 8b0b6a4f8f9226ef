//! Runs that are killed at a call to the system, and runs whose calls fail: every call in turn.

use super::case::{Case, judged, names_a_file, run_words, said};
use super::interposer::{CallCounts, Strike, call_counts};
use super::interrupted::{resume_to_equal, whole_frames};
use anyhow::{Context, Result, ensure};
use std::process::Output;

/// Calls that change the disk.
const DEADLY: [&str; 4] = ["rename", "sync", "open", "write"];

/// A call, the error of the system that it fails with, its words, and whether all later ones fail too.
type Fault = (&'static str, i32, &'static str, bool);

/// Which errors are met at which calls.
const FAULTS: [Fault; 8] = [
    ("write", 28, "No space left", true),
    ("write", 5, "Input/output error", false),
    ("sync", 5, "Input/output error", false),
    ("rename", 13, "Permission denied", false),
    ("rename", 28, "No space left", true),
    ("open", 28, "No space left", true),
    ("open", 13, "Permission denied", false),
    ("read", 5, "Input/output error", false),
];

/// Cases of [`killed_at_calls`]: one for each call that changes the disk.
pub(crate) fn kills(calls: &CallCounts) -> u64 {
    DEADLY.iter().filter_map(|call| calls.get(*call)).sum()
}

/// Cases of [`failing_calls`]: one for each call and each of its errors.
pub(crate) fn faults(calls: &CallCounts) -> u64 {
    FAULTS.iter().filter_map(|fault| calls.get(fault.0)).sum()
}

/// Killed when it is about to rename, sync, write or make a file: the call of the case's number; resumed to equal bytes.
pub(crate) fn killed_at_calls(case: &mut Case) -> Result<()> {
    let calls = &case.laboratory.calls;
    let of = |name: &str| calls.get(name).copied().unwrap_or(0);
    let (renames, syncs) = (of("rename"), of("sync"));
    ensure!(
        syncs >= 2 * renames,
        "{renames} renames, {syncs} syncs: of each file and of its folder there is one"
    );
    let (call, at) = nth(case, DEADLY.into_iter(), |call| call)?;
    let output = struck(case, Strike { call, at, errno: 0, lasting: false })?;
    ensure!(
        output.status.code().is_none_or(|code| code == 137),
        "{call} {at} did not kill: {}",
        said(&output)
    );
    finish(case)
}

/// A call fails as on a full or broken disk: the run goes on, or ends with an error that names a file; then it is resumed.
pub(crate) fn failing_calls(case: &mut Case) -> Result<()> {
    let ((call, errno, words, lasting), at) = nth(case, FAULTS.into_iter(), |fault| fault.0)?;
    let output = judged(struck(case, Strike { call, at, errno, lasting })?)?;
    let made = call_counts(&case.laboratory.report()).get(call).copied().unwrap_or(0);
    ensure!(made >= at, "{call} {at} was never made: {made} were");
    if !output.status.success() {
        let text = said(&output);
        ensure!(text.contains(words), "{call} {at} failed with '{words}', which is not told: {text}");
        ensure!(names_a_file(case, &text), "{call} {at}: which file? {text}");
    }
    finish(case)
}

/// The kind and the place of the call that a case's number stands for: all calls of the first kind, all of the next, and so on.
fn nth<T: Copy>(
    case: &Case,
    kinds: impl Iterator<Item = T>,
    call: fn(T) -> &'static str,
) -> Result<(T, u64)> {
    let mut left = case.number;
    for kind in kinds {
        let count = case.laboratory.calls.get(call(kind)).copied().unwrap_or(0);
        if left < count {
            return Ok((kind, left + 1));
        }
        left -= count;
    }
    None.with_context(|| format!("no call {}: so many are not made", case.number))
}

fn finish(case: &mut Case) -> Result<()> {
    let (laboratory, out) = (case.laboratory, case.path("out"));
    whole_frames(&out)?;
    resume_to_equal(case, &laboratory.smallest_capture(), &laboratory.smallest_run(), &out)
}

fn struck(case: &mut Case, strike: Strike) -> Result<Output> {
    let words = run_words(&case.laboratory.smallest_capture(), &case.path("out"), &["--resume"]);
    let mut command = case.limited("", &words);
    strike.befall(&mut command);
    command.output().context("cannot start the program")
}
