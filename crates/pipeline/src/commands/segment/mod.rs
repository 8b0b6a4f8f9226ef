//! `ffgs segment`: a long capture in parts that can be reconstructed at the same time.
//!
//! A part begins with its own key frame. What moves is brought there by a scout, a run of few iterations per frame that begins
//! with the first frame (docs/adr/0052-segments-start-from-a-scout.md); the key frame is then finetuned on its photographs.

mod ids;
mod jobs;
mod join;
mod plan;

use crate::cli::args::LogArgs;
use crate::cli::interrupt;
use crate::cli::terminal;
use crate::job::device::Device;
use crate::job::request::FrameRange;
use crate::settings::config::Config;
use anyhow::Result;
use clap::{Args, Subcommand};
use jobs::{Job, Worker, run_all, run_job};
pub(crate) use plan::Plan;
use std::path::PathBuf;

/// `ffgs segment`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Reconstruct a long capture in parts that run on several machines, and join them",
    long_about = "Reconstructs a long capture in parts, which several machines can work on at the same time. `plan` decides the \
        parts and writes segments.json; `run` does the jobs: the first frame, a scout over all frames with few iterations per \
        frame, then the parts, each from the scouted frame with which it begins (scout3 goes to that of part 3); `join` makes one run of them, with a \
        table of the jump at each seam. Every job goes on where it was stopped, with the same result.",
    after_help = "Examples:\n  ffgs segment plan CAPTURE --out out/long --length 50\n  \
        ffgs segment run out/long                      # every job, one after another\n  \
        ffgs segment run out/long --only first         # or one job on each machine: first, then scout,\n  \
        ffgs segment run out/long --only scout         # (scout1: part 1 can start), then the parts at the same time\n  \
        ffgs segment run out/long --only 3\n  \
        ffgs segment join out/long                     # the run out/long/joined: eval, export, view"
)]
pub struct SegmentArgs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Clone, Debug, Subcommand)]
enum Command {
    /// Decide the parts
    Plan(PlanArgs),
    /// Do jobs of a plan
    Run(WorkArgs),
    /// Make one run of the finished parts
    Join(JoinArgs),
}

/// `ffgs segment plan`.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct PlanArgs {
    /// Folder of the capture
    pub(crate) capture: PathBuf,
    /// Folder for the plan and everything that its jobs write
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Frames from one key frame to the next
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    pub(crate) length: u32,
    /// Frames 0 to B-1, written `..B`
    #[arg(long, value_name = "A..B")]
    pub(crate) frames: Option<FrameRange>,
    /// Training cameras to use, by name
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub(crate) train_views: Option<Vec<String>>,
    /// Settings; `ffgs config` prints them all
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    /// Seed of every random choice
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,
    /// Iterations of the first frame
    #[arg(long, value_name = "N")]
    pub(crate) first_iterations: Option<usize>,
    /// Iterations of the dynamic layer per frame
    #[arg(long, value_name = "N")]
    pub(crate) iterations: Option<usize>,
    /// Iterations of the dynamic layer per frame of the scout [default: half of those of a frame]
    #[arg(long, value_name = "N")]
    pub(crate) scout_iterations: Option<usize>,
    /// Iterations that finetune a key frame [default: three times those of a frame]
    #[arg(long, value_name = "N")]
    pub(crate) key_iterations: Option<usize>,
}

/// `ffgs segment run`.
#[derive(Clone, Debug, Args)]
struct WorkArgs {
    /// Folder of the plan
    folder: PathBuf,
    /// Only this job: first, scout, scout1 (as far as part 1 needs), …, or the number of a part
    #[arg(long, value_name = "JOB")]
    only: Option<Job>,
    /// Where to compute; auto = a hardware GPU where there is one, else the CPU
    #[arg(long, value_name = "auto|cpu|gpu[:N,N]", default_value = "auto")]
    device: Device,
    /// Most memory that a job may take [default: what the machine has free], and as much of each GPU; one that needs more does not
    /// start
    #[arg(long, value_name = "MIB")]
    memory: Option<usize>,
    /// Messages.
    #[command(flatten)]
    log: LogArgs,
}

/// `ffgs segment join`.
#[derive(Clone, Debug, Args)]
struct JoinArgs {
    /// Folder of the plan
    folder: PathBuf,
    /// Messages.
    #[command(flatten)]
    log: LogArgs,
}

/// Runs the command.
///
/// # Errors
/// When the folder has another plan, a job fails or what a job needs is not finished.
pub(crate) fn main(args: &SegmentArgs) -> Result<()> {
    match &args.command {
        Command::Plan(args) => {
            let plan = Plan::new(args)?;
            plan.write(&args.out)?;
            terminal::print(plan.table().trim_end());
        }
        Command::Run(args) => {
            args.log.start();
            interrupt::explain_signals();
            let plan = Plan::read(&args.folder)?;
            let worker = Worker { device: &args.device, memory: args.memory, quiet: args.log.quiet };
            match args.only {
                Some(job) => run_job(&plan, job, worker)?,
                None => run_all(&plan, worker)?,
            }
        }
        Command::Join(args) => {
            args.log.start();
            let plan = Plan::read(&args.folder)?;
            terminal::print(join::join(&plan)?.trim_end());
        }
    }
    Ok(())
}

impl PlanArgs {
    fn configuration(&self) -> Result<Config> {
        let mut config = self.config.as_deref().map_or_else(|| Ok(Config::default()), Config::read)?;
        config.seed = self.seed.unwrap_or(config.seed);
        config.first_frame.iterations = self.first_iterations.unwrap_or(config.first_frame.iterations);
        config.dynamic.iterations = self.iterations.unwrap_or(config.dynamic.iterations);
        config.validate().map(|()| config)
    }
}
