//! Runs that are killed at a rename or sync, and runs whose calls to the system fail.

use super::case::{Case, judged, names_a_file, run_words, said};
use super::interposer::Strike;
use super::interrupted::{finish, whole_frames};
use anyhow::{Context, Result, ensure};
use std::process::Output;

/// Of one case a round: rounds with successive seeds go through all calls in turn.
pub(crate) const CALLS_A_ROUND: usize = 4;

/// Errors of the system, and at which calls they are met.
const FAULTS: [(&str, i32, &str, bool); 7] = [
    ("write", 28, "No space left", true),
    ("write", 5, "Input/output error", false),
    ("sync", 5, "Input/output error", false),
    ("rename", 13, "Permission denied", false),
    ("open", 28, "No space left", true),
    ("open", 13, "Permission denied", false),
    ("read", 5, "Input/output error", false),
];

/// Killed when it is about to rename or sync, each of these calls in turn; resumed to equal bytes.
pub(crate) fn killed_at_calls(case: &mut Case) -> Result<()> {
    let calls = &case.laboratory.calls;
    let of = |name: &str| calls.get(name).copied().with_context(|| format!("no {name} was counted"));
    let (renames, syncs) = (of("rename")?, of("sync")?);
    ensure!(
        syncs >= 2 * renames,
        "{renames} renames, {syncs} syncs: of each file and of its folder there is one"
    );
    let n = (case.seed * CALLS_A_ROUND as u64 + case.number) % (renames + syncs);
    let (call, at) = if n < renames { ("rename", n + 1) } else { ("sync", n - renames + 1) };
    let output = struck(case, Strike { call, at, errno: 0, lasting: false })?;
    ensure!(
        output.status.code().is_none_or(|code| code == 137),
        "{call} {at} did not kill: {}",
        said(&output)
    );
    whole_frames(&case.path("out"))?;
    finish(case, &case.path("out"))
}

/// A call fails as on a full or broken disk: the run goes on, or ends with an error that names a file; then it is resumed.
pub(crate) fn failing_calls(case: &mut Case) -> Result<()> {
    let (call, errno, words, lasting) = case.one_of(&FAULTS);
    let count = case.laboratory.calls.get(call).copied().with_context(|| format!("no {call} was counted"))?;
    let at = 1 + case.below(count as usize) as u64;
    let output = judged(struck(case, Strike { call, at, errno, lasting })?)?;
    if !output.status.success() {
        let text = said(&output);
        ensure!(text.contains(words), "{call} {at} failed with '{words}', which is not told: {text}");
        ensure!(names_a_file(case, &text), "{call} {at}: which file? {text}");
    }
    whole_frames(&case.path("out"))?;
    finish(case, &case.path("out"))
}

fn struck(case: &mut Case, strike: Strike) -> Result<Output> {
    let words = run_words(&case.laboratory.capture(), &case.path("out"), &["--resume"]);
    let mut command = case.limited("", &words);
    strike.befall(&mut command);
    command.output().context("cannot start the program")
}
