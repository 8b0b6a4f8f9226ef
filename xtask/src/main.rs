//! Developer commands: `cargo xtask --help`.

mod bench;
mod ci;
mod ffgs;
mod fixtures;
mod fuzz;
mod monaco;
mod players;
mod setup;
mod supply;
mod tidy;
#[cfg(unix)]
mod torture;
mod venv;
mod vmaf;
mod workspace;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Builds, runs and checks fastflowgs.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", after_help = AFTER_HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "\
Every command of ffgs and of ffgs-lab passes through, with the program built in release first:
  cargo xtask prepare FOOTAGE --out CAPTURE     make a capture of videos or photographs with a calibration
  cargo xtask check CAPTURE                     what a capture holds, and every fault in it
  cargo xtask stage NAME --input in.npz --output out.npz
  cargo xtask render RUN --frame 3 --orbit
  cargo xtask eval RUN
  cargo xtask segment plan CAPTURE --out DIR --length N
                                                a long capture in parts, on several machines
  cargo xtask workflow CAPTURE --out DIR        captures, methods and seeds as Snakemake jobs
  cargo xtask export RUN --to FORMAT            files for other players
  cargo xtask view RUN                          play a run in the browser
  cargo xtask config                            the default configuration, with comments
  cargo xtask motion-eval CAPTURE               the motion initialisation against ground truth
  cargo xtask mask-eval CAPTURE TRUTH           the masks of a capture against the true ones
  cargo xtask simulate                          the fusion on simulated scenes
  cargo xtask ablations [CAPTURE]               every single change of the configuration
  cargo xtask compare CAPTURE --methods all     every method from one first frame: quality, seconds, storage
  cargo xtask devices                           the GPUs, and which one a run takes
  cargo xtask COMMAND --help                    the options of one of them";

#[derive(Subcommand)]
enum Command {
    /// Reconstruct a capture and write its report (the sample capture by default).
    #[command(after_help = PIPELINE_HELP)]
    Pipeline {
        /// CAPTURE, --out DIR and any option of `ffgs run`; a capture, where given, comes first.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGS")]
        args: Vec<String>,
    },
    /// Render captures of racing cars on a street circuit, with exact ground truth.
    #[command(after_help = MONACO_HELP)]
    Monaco {
        /// A command of the generator and its options; without any, their list.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGS")]
        args: Vec<String>,
    },
    /// Install what the checks and the player need: Debian packages (by apt-get), PlayCanvas and an ffmpeg with VMAF; does nothing when they are there.
    Setup,
    /// Check the project's own rules: crate edges, file sizes, names, leftovers, whitespace.
    Tidy,
    /// Compare the files under fixtures/ with fixtures/MANIFEST.toml.
    Fixtures {
        #[command(subcommand)]
        action: FixturesAction,
    },
    /// Run everything that must pass before a change lands; stops at the first failure.
    Ci {
        /// Only these steps, by the names that the table at the end shows.
        #[arg(value_name = "STEP")]
        only: Vec<String>,
    },
    /// Time everything on the CPU, or a training step on a GPU, beside what the machine can do at best; docs/bench
    /// explains the tables.
    Bench {
        #[command(flatten)]
        options: bench::Options,
    },
    /// Compare the dependencies with docs/DEPENDENCIES.md; write a bill of materials.
    Supply {
        /// Write a bill of materials (CycloneDX JSON) of every package in Cargo.lock
        #[arg(long, value_name = "FILE")]
        sbom: Option<std::path::PathBuf>,
    },
    /// Test the program under kills, I/O errors, low memory and damaged inputs, and count the outcomes.
    #[cfg(unix)]
    Torture {
        #[command(flatten)]
        options: torture::Options,
    },
    /// Run every parser under libFuzzer and AddressSanitizer; needs a nightly compiler and cargo-fuzz.
    Fuzz {
        #[command(flatten)]
        options: fuzz::Options,
    },
    #[command(external_subcommand)]
    Ffgs(Vec<String>),
}

const PIPELINE_HELP: &str = "\
Examples:
  cargo xtask pipeline                                  the sample capture, into out/fairmont-mini
  cargo xtask pipeline path/to/capture --out out/mine   your own capture
  cargo xtask pipeline --frames 0..3 --iterations 100   the sample, but less work
  cargo xtask pipeline --resume                         go on after an interruption
`cargo xtask run --help` lists every option of the run.";

const MONACO_HELP: &str = "\
The first call makes a virtual environment below the target folder: Python 3.11, Blender's
module and Snakemake, 400 MB to download and 1.3 GB on disk. No display and no GPU are needed.

A capture, step by step:
  cargo xtask monaco sections                           what can be rendered
  cargo xtask monaco make --out out/pool --section pool --weather rain
                                                        a complete small capture
  cargo xtask monaco check out/pool                     verify it and print figures
  cargo xtask monaco tracks out/pool                    add the outputs of our trackers, with their errors
  cargo xtask monaco sheet out/pool pool.jpg            look at it
  cargo xtask pipeline out/pool --out out/pool-run      reconstruct it

Other sizes:
  ... make --out DIR --scale small --section tunnel     the scales are mini, small and full
  ... make --out DIR --frames 4 --trackside 24 --res 320x180 --samples 24
                                                        any number instead of the scale's
  ... make --out DIR --weather fog --truth-from out/day the same pass in another light
  ... farm --out DIR --scale full --cores 16            shards over worker processes
  ... COMMAND --help                                    every option

A command that was interrupted goes on when it is given again: files that exist are kept.";

#[derive(Subcommand)]
enum FixturesAction {
    /// List missing, extra and changed files and broken size limits; fail if there are any.
    Check,
    /// Write the manifest anew from the files that are there.
    Update,
}

fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> Result<ExitCode> {
    let root = workspace::root()?;
    match command {
        Command::Pipeline { args } => {
            setup::run()?;
            return ffgs::pipeline(&root, args);
        }
        Command::Monaco { args } => return monaco::run(&root, &args),
        Command::Ffgs(args) => return ffgs::pass_through(&root, &args),
        Command::Setup => {
            setup::run_for_tests()?;
            if let Err(reason) = players::install(&root) {
                println!("ffgs view and --to site will not work: {reason:#}");
            }
            if let Err(reason) = vmaf::install(&root) {
                println!("ffgs eval will find no VMAF: {reason:#}");
            }
        }
        Command::Tidy => {
            println!("tidy: no finding; {}", tidy::run(&root)?);
        }
        Command::Fixtures { action: FixturesAction::Check } => println!("{}", fixtures::check(&root)?),
        Command::Fixtures { action: FixturesAction::Update } => println!("{}", fixtures::update(&root)?),
        Command::Bench { options } => bench::run(&root, &options)?,
        Command::Supply { sbom } => println!("{}", supply::run(&root, sbom.as_deref())?),
        #[cfg(unix)]
        Command::Torture { options } => torture::run(&root, &options)?,
        Command::Fuzz { options } => fuzz::run(&root, &options)?,
        Command::Ci { only } => ci::run(&root, &only)?,
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn pipeline_hands_every_option_on() {
        let cli = Cli::try_parse_from(["x", "pipeline", "cap", "--out", "o", "--frames", "0..2"]).unwrap();
        let Command::Pipeline { args } = cli.command else { panic!("not the pipeline command") };
        assert_eq!(args, ["cap", "--out", "o", "--frames", "0..2"]);
    }

    #[test]
    fn monaco_hands_every_option_on() {
        let cli = Cli::try_parse_from(["x", "monaco", "make", "--out", "o", "--help"]).unwrap();
        let Command::Monaco { args } = cli.command else { panic!("not the generator") };
        assert_eq!(args, ["make", "--out", "o", "--help"]);
        let cli =
            Cli::try_parse_from(["x", "monaco", "farm", "--out", "o", "--", "--executor", "e"]).unwrap();
        let Command::Monaco { args } = cli.command else { panic!("not the generator") };
        assert_eq!(args, ["farm", "--out", "o", "--", "--executor", "e"]);
    }

    #[test]
    fn an_option_may_come_first() {
        let cli = Cli::try_parse_from(["x", "pipeline", "--frames", "0..2"]).unwrap();
        let Command::Pipeline { args } = cli.command else { panic!("not the pipeline command") };
        assert_eq!(args, ["--frames", "0..2"]);
    }
}
