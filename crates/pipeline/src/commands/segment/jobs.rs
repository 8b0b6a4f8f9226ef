//! The jobs of a plan, each an ordinary run that goes on where it was stopped.

use super::plan::Plan;
use crate::cli::terminal;
use crate::job::device::Device;
use crate::job::request::{FrameRange, RunRequest};
use crate::outputs::folder::RunFolder;
use anyhow::{Result, ensure};
use std::num::NonZeroUsize;
use std::ops::Range;
use std::str::FromStr;

/// A job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Job {
    /// The first frame.
    First,
    /// The moving layer at every key frame, or up to that of a part: what is there already stays.
    Scout(Option<usize>),
    /// A part.
    Part(usize),
}

impl FromStr for Job {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "first" => Ok(Self::First),
            "scout" => Ok(Self::Scout(None)),
            _ => match text.strip_prefix("scout") {
                Some(number) => number.parse().map(|number| Self::Scout(Some(number))),
                None => text.parse().map(Self::Part),
            }
            .map_err(|_| format!("'{text}' is neither first nor scout, scout1, … nor the number of a part")),
        }
    }
}

/// How a machine does its jobs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Worker<'a> {
    pub(super) device: &'a Device,
    /// As of [`RunRequest::memory`].
    pub(super) memory: Option<usize>,
    pub(super) quiet: bool,
}

/// Does every job that is not finished, one after another.
///
/// # Errors
/// When one fails; those before it are finished.
pub(super) fn run_all(plan: &Plan, worker: Worker) -> Result<()> {
    let scout = (!plan.scouted().is_empty()).then_some(Job::Scout(None));
    let parts = (0..plan.parts().len()).map(Job::Part);
    [Job::First].into_iter().chain(scout).chain(parts).try_for_each(|job| run_job(plan, job, worker))
}

/// Does a job, or what is left of it.
///
/// # Errors
/// When what it starts from is not finished, or it fails.
pub(super) fn run_job(plan: &Plan, job: Job, worker: Worker) -> Result<()> {
    let work = work(plan, job, worker)?;
    let folder = RunFolder(work.out.clone());
    let frames = work.frames.unwrap_or_default();
    let end = frames.end.unwrap_or(frames.start + 1);
    if !worker.quiet {
        terminal::note(format!("{}: frames {}..{end}", folder.0.display(), frames.start));
    }
    if folder.state(end - 1).exists() && folder.0.join("report.html").exists() {
        return Ok(());
    }
    crate::job::run::run(&work).map(|_| ())
}

/// The job as a run.
fn work(plan: &Plan, job: Job, worker: Worker) -> Result<RunRequest> {
    let first = plan.frames.start;
    let request = |out: RunFolder, frames: Range<usize>| RunRequest {
        capture: plan.capture.clone(),
        out: out.0,
        resume: true,
        method: None,
        frames: Some(FrameRange { start: frames.start, end: Some(frames.end) }),
        train_views: plan.train_views.clone(),
        first_frame: None,
        refine_first: None,
        keep: None,
        memory: worker.memory,
        device: worker.device.clone(),
        quiet: worker.quiet,
        config: plan.config,
    };
    match job {
        Job::First => Ok(request(plan.first(), first..first + 1)),
        Job::Scout(part) => {
            ensure!(!plan.scouted().is_empty(), "the plan has one part and needs no scout");
            require(plan, &plan.first(), first, "first")?;
            let last = plan.parts().len() - 1;
            let part = part.unwrap_or(last);
            ensure!((1..=last).contains(&part), "--only scout{part}: the plan has scout1 to scout{last}");
            let mut run = request(plan.scout(), first..plan.parts()[part].start + 1);
            run.first_frame = Some(plan.first().0);
            // Parts start from the key frames alone.
            run.keep = NonZeroUsize::new(plan.length);
            run.config.dynamic.iterations = plan.scout_iterations;
            Ok(run)
        }
        Job::Part(number) => {
            let parts = plan.parts();
            ensure!(number < parts.len(), "--only {number}: the plan has the parts 0 to {}", parts.len() - 1);
            let (from, name) = plan.starts_from(number);
            require(plan, &from, parts[number].start, &name)?;
            let mut run = request(plan.part(number), parts[number].clone());
            run.first_frame = Some(from.0);
            run.refine_first = (number > 0).then_some(plan.key_iterations);
            Ok(run)
        }
    }
}

fn require(plan: &Plan, run: &RunFolder, frame: usize, job: &str) -> Result<()> {
    ensure!(
        run.state(frame).exists(),
        "frame {frame} of the job `{job}`, from which this one starts, is not finished; run `ffgs segment run {} --only {job}` \
         first",
        plan.folder.display()
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_has_a_name() {
        assert_eq!("first".parse(), Ok(Job::First));
        assert_eq!("12".parse(), Ok(Job::Part(12)));
        assert_eq!(("scout".parse(), "scout3".parse()), (Ok(Job::Scout(None)), Ok(Job::Scout(Some(3)))));
        assert!("scouts".parse::<Job>().is_err());
        assert!("last".parse::<Job>().unwrap_err().contains("neither"));
    }
}
