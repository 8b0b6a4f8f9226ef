//! The command line of `ffgs`.

pub mod args;
pub(crate) mod console;
pub(crate) mod interrupt;
pub mod terminal;

use crate::cli::args::{CheckArgs, EvalArgs, RenderArgs, RunArgs, StageArgs};
use crate::commands::stage;
use crate::job::device;
use crate::job::provenance::VERSION;
use crate::plugins::registry::{self, METHODS};
use anyhow::Result;
use clap::{Parser, Subcommand};
use ffgs_dataset::ImageCheck;
use std::process::ExitCode;

/// Reconstructs moving scenes as 3D Gaussians, one frame after another.
///
/// A capture is a folder with calibrated cameras (train_meta.json, test_meta.json), images (ims/), foreground masks
/// (seg/), initial points (init_pt_cld.npz) and the motion that trackers found (tracks/); `ffgs prepare` makes one from footage.
#[derive(Debug, Parser)]
#[command(name = "ffgs", version = VERSION, propagate_version = true, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

const EXIT_CODES: &str = "\
Exit status: 0 done; 1 an error, which is printed; 2 a wrong command line; 74 done, but some of
what should have been printed could not be (standard output or error closed or full).";

/// What to do. Most commands are described where their arguments are: a comment here would replace their long text too.
#[derive(Debug, Subcommand)]
#[expect(missing_docs, reason = "clap takes comments on variants in place of the texts of their arguments")]
pub enum Command {
    Prepare(crate::commands::prepare::PrepareArgs),
    Track(crate::commands::prepare::TrackArgs),
    Convert(crate::commands::prepare::ConvertArgs),
    Check(CheckArgs),
    Run(RunArgs),
    Segment(crate::commands::segment::SegmentArgs),
    Workflow(crate::commands::workflow::WorkflowArgs),
    Render(RenderArgs),
    Eval(EvalArgs),
    Export(crate::commands::export::ExportArgs),
    View(crate::commands::view::ViewArgs),
    /// List the methods that `run --method` takes
    Methods,
    /// List the formats: of captures and tracks, which are read, and of splats, which are written
    Formats,
    /// List the GPUs, their limits and what each would be used as
    Devices,
    /// Print the configuration, every key with its meaning
    Config(crate::commands::config::ConfigArgs),
    Stage(StageArgs),
}

/// Runs the program on its command line. An error is printed with its causes.
pub fn main() -> ExitCode {
    let command = Cli::parse().command;
    terminal::ended(ffgs_core::check_instructions().map_err(Into::into).and_then(|()| dispatch(command)))
}

fn dispatch(command: Command) -> Result<ExitCode> {
    match command {
        Command::Check(args) => {
            args.log.start();
            let check =
                crate::commands::check::check_capture(&args.capture, ImageCheck::Decode, args.log.quiet)?;
            terminal::print(check.to_string().trim_end());
            if let Some(folder) = &args.pictures {
                let count = crate::commands::check::pictures::write(&args.capture, folder)?;
                terminal::print(format!("{} in {}", ffgs_core::counted(count, "picture"), folder.display()));
            }
            return Ok(if check.is_usable() { ExitCode::SUCCESS } else { ExitCode::FAILURE });
        }
        Command::Prepare(args) => {
            args.log.start();
            crate::commands::prepare::run(&args)?;
        }
        Command::Track(args) => {
            args.log.start();
            crate::commands::prepare::track(&args)?;
        }
        Command::Convert(args) => crate::commands::prepare::convert(&args)?,
        Command::Run(args) => {
            args.log.start();
            interrupt::explain_signals();
            let request = args.request()?;
            let page = args.view.then(|| crate::commands::view::beside(&request)).transpose()?;
            let report = crate::job::run::run(&request)?;
            terminal::print(report.display());
            if let Some(page) = page {
                tracing::info!("the page is served until this is stopped (Ctrl-C)");
                page.wait();
            }
        }
        Command::Segment(args) => crate::commands::segment::main(&args)?,
        Command::Workflow(args) => crate::commands::workflow::write(&args)?,
        Command::Render(args) => {
            args.log.start();
            crate::commands::render::render(&args)?;
        }
        Command::Eval(args) => {
            args.log.start();
            crate::commands::eval::eval(&args)?;
        }
        Command::Export(args) => {
            args.log.start();
            crate::commands::export::export(&args)?;
        }
        Command::View(args) => {
            args.log.start();
            crate::commands::view::view(&args)?;
        }
        Command::Methods => terminal::print(METHODS.table().trim_end()),
        Command::Formats => terminal::print(registry::formats().trim_end()),
        Command::Devices => device::list(),
        Command::Config(args) => crate::commands::config::print(&args)?,
        Command::Stage(args) => {
            args.log.start();
            let form = if args.literal { stage::Form::Literal } else { stage::Form::Run };
            stage::run(args.name, form, &args.input, &args.output, &args.device)?;
        }
    }
    Ok(ExitCode::SUCCESS)
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
        assert_eq!(short, ["methods", "formats", "devices", "config"]);
    }
}
