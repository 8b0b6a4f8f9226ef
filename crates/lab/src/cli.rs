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

/// What to do. Most commands are described where their arguments are: a comment here would replace their long text too.
#[derive(Debug, Subcommand)]
enum Command {
    MotionEval(MotionEvalArgs),
    MaskEval(MaskEvalArgs),
    /// Score the fusion on simulated scenes
    Simulate(SimulateArgs),
    /// Score the configuration, our most literal reading of Algorithm 1, and every single change
    Ablations(AblationArgs),
    /// Run methods on captures from one first frame, and write tables and curves of quality, seconds and storage
    Compare(CompareArgs),
    Synthetic(SyntheticArgs),
    Enlarge(EnlargeArgs),
    Expose(ExposeArgs),
    Later(LaterArgs),
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

    #[test]
    fn help_explains_the_commands() {
        let cli = Cli::command();
        let short = cli.get_subcommands().filter(|command| command.get_long_about().is_none());
        let short: Vec<&str> = short.map(clap::Command::get_name).collect();
        assert_eq!(short, ["simulate", "ablations", "compare"]);
    }
}
