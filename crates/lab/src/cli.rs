//! The command line of `ffgs-lab`.

use crate::ablations::{self, AblationArgs};
use crate::compare::{self, CompareArgs};
use crate::enlarge::{self, EnlargeArgs};
use crate::expose::{self, ExposeArgs};
use crate::later::{self, LaterArgs};
use crate::markers::{self, MarkersArgs};
use crate::mask_eval::{self, MaskEvalArgs};
use crate::motion_eval::{self, MotionEvalArgs};
use crate::simulate::{self, SimulateArgs};
use crate::synthetic::{self, SyntheticArgs};
use anyhow::Result;
use clap::{Parser, Subcommand};
use ffgs_pipeline::cli::terminal;
use std::process::ExitCode;

/// Experiments on the motion initialisation, for developers and papers.
#[derive(Debug, Parser)]
#[command(name = "ffgs-lab", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Score the motion initialisation against a capture's ground truth
    MotionEval(MotionEvalArgs),
    /// Score the masks of a capture against the true ones
    MaskEval(MaskEvalArgs),
    /// Score the fusion on simulated scenes
    Simulate(SimulateArgs),
    /// Score the configuration, our most literal reading of Algorithm 1, and every single change
    Ablations(AblationArgs),
    /// Run methods on captures from one first frame, and write tables and curves of quality, seconds and storage
    Compare(CompareArgs),
    /// Make a capture of the paper's size, or a smaller one, and the run of its first frame
    Synthetic(SyntheticArgs),
    /// Enlarge the images, masks and tracks of a capture
    Enlarge(EnlargeArgs),
    /// Give the photographs of a capture exposures that change from frame to frame
    Expose(ExposeArgs),
    /// Make a capture of one later frame, to tell what a run has lost by then
    Later(LaterArgs),
    /// Make the ground truth of a filmed rigid body from points that were measured on it
    Markers(MarkersArgs),
}

/// Runs the program on its command line. An error is printed with its causes.
pub fn main() -> ExitCode {
    terminal::ended(dispatch(Cli::parse().command).map(|()| ExitCode::SUCCESS))
}

fn dispatch(command: Command) -> Result<()> {
    match command {
        Command::MotionEval(args) => {
            args.source.log.start();
            motion_eval::run(&args)
        }
        Command::MaskEval(args) => {
            args.log.start();
            mask_eval::run(&args)
        }
        Command::Simulate(args) => {
            args.log.start();
            simulate::run(&args)
        }
        Command::Ablations(args) => {
            args.source.log.start();
            ablations::run(&args)
        }
        Command::Compare(args) => {
            args.log.start();
            compare::run(&args)
        }
        Command::Synthetic(args) => {
            args.log.start();
            synthetic::run(&args)
        }
        Command::Enlarge(args) => {
            args.log.start();
            enlarge::run(&args)
        }
        Command::Expose(args) => {
            args.log.start();
            expose::run(&args)
        }
        Command::Later(args) => {
            args.log.start();
            later::run(&args)
        }
        Command::Markers(args) => {
            args.log.start();
            markers::run(&args)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definitions_are_consistent() {
        Cli::command().debug_assert();
    }
}
