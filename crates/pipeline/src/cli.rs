//! The command line of `ffgs`.

use crate::choice::{MethodChoice, MethodParser};
use crate::device::{self, Device};
use crate::registry::{CAPTURES, METHODS};
use crate::stage::{self, Stage};
use crate::terminal;
use anyhow::Result;
use clap::{ArgAction, Args, Parser, Subcommand};
use ffgs_dataset::ImageCheck;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use tracing::level_filters::LevelFilter;

/// Reconstructs moving scenes as 3D Gaussians, one frame after another.
///
/// A capture is a folder with calibrated cameras (train_meta.json, test_meta.json), images (ims/), foreground masks
/// (seg/), initial points (init_pt_cld.npz) and the motion that trackers found (tracks/).
#[derive(Debug, Parser)]
#[command(name = "ffgs", version = VERSION, propagate_version = true, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// Version and commit.
pub const VERSION: &str = env!("FFGS_VERSION");

const EXIT_CODES: &str = "\
Exit status: 0 done; 1 an error, which is printed; 2 a wrong command line; 74 done, but some of
what should have been printed could not be (standard output or error closed or full).";

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a capture of footage: videos or photographs with a calibration
    Prepare(crate::prepare::PrepareArgs),
    /// Write a frame of a capture for other tools
    Convert(crate::prepare::ConvertArgs),
    /// Show what a capture holds and every fault in it
    Check(CheckArgs),
    /// Reconstruct a capture, frame by frame
    Run(RunArgs),
    /// Render a finished run: a camera, or a circle around the moving objects
    Render(RenderArgs),
    /// Measure a finished run again
    Eval(EvalArgs),
    /// Write a finished run as files for other players
    Export(crate::export::ExportArgs),
    /// Show a run or a stream in the browser
    View(crate::view::ViewArgs),
    /// List the methods that `run --method` takes
    Methods,
    /// List the formats of captures that are read
    Formats,
    /// List the GPUs, their limits and what each would be used as
    Devices,
    /// Print the configuration, every key with its meaning
    Config(crate::config_text::ConfigArgs),
    /// Run one stage on numpy arrays
    Stage(StageArgs),
}

/// How much is said on the standard error.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct LogArgs {
    /// Say more: -v for what each step does, -vv for details, -vvv for everything
    #[arg(short, long, action = ArgAction::Count)]
    pub verbose: u8,
    /// No progress bars, errors only
    #[arg(short, long, conflicts_with = "verbose")]
    pub quiet: bool,
}

impl LogArgs {
    /// Sends log messages to the standard error, without colours: a log file is read as text.
    pub fn start(self) {
        let level = match (self.quiet, self.verbose) {
            (true, _) => LevelFilter::ERROR,
            (_, 0) => LevelFilter::WARN,
            (_, 1) => LevelFilter::INFO,
            (_, 2) => LevelFilter::DEBUG,
            _ => LevelFilter::TRACE,
        };
        let plain = tracing_subscriber::fmt().with_writer(terminal::LogWriter::default).with_max_level(level);
        // Fails only when there is a subscriber already, which is then as good.
        let _ =
            plain.with_ansi(false).log_internal_errors(false).without_time().with_target(false).try_init();
    }
}

/// `ffgs check`.
#[derive(Clone, Debug, Args)]
#[command(
    long_about = "Reads every camera, image, mask, point and track of a capture and prints what it holds: views, \
        frames, sizes, masks, points, tracks per tracker. Every fault is printed with its file and what to do about \
        it; with a fault the exit status is 1. A run makes the same check before it starts, \
        but looks only at the size and the end of images, which it decodes later.",
    after_help = "Example:\n  ffgs check fixtures/scenes/fairmont-mini"
)]
pub struct CheckArgs {
    /// Folder of the capture
    pub capture: PathBuf,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// `ffgs stage`.
#[derive(Clone, Debug, Args)]
#[command(
    long_about = "Runs one stage of the method alone, on numpy arrays. Inputs may have any float or integer type; \
        arrays that the stage does not know are ignored. The output is written whole or not at all.",
    after_help = "Examples:\n  ffgs stage voronoi --input tracks.npz --output motion.npz\n  \
        ffgs stage rasterize --input fixtures/reference/rasterize/c01_two.npz --output image.npz"
)]
pub struct StageArgs {
    /// The stage; `ffgs stage --help` lists the arrays of each
    #[arg(value_enum, value_name = "NAME")]
    pub name: Stage,
    /// The stage's arrays (.npz)
    #[arg(long, value_name = "FILE")]
    pub input: PathBuf,
    /// Where its results go (.npz); replaced if it exists
    #[arg(long, value_name = "FILE")]
    pub output: PathBuf,
    /// Where to compute; auto = a hardware GPU where there is one, else the CPU
    #[arg(long, value_name = "auto|cpu|gpu[:N,N]", default_value = "auto")]
    pub device: Device,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// `ffgs run`.
#[derive(Clone, Debug, Args)]
#[command(
    long_about = "Reconstructs a capture. The first frame is trained from images; each later frame starts from the \
        one before it, moved by what the trackers saw, and is finetuned. The output folder receives splats (PLY), \
        rendered test views, metrics.json, run.json and report.html, which opens in any browser. Finished frames \
        survive a kill; --resume goes on from there.",
    after_help = "Examples:\n  ffgs run fixtures/scenes/fairmont-mini --out out/mini\n  \
        ffgs run CAPTURE --out out/quick --frames 0..3 --iterations 50\n  \
        ffgs run CAPTURE --out out/none --method none --first-frame out/mini   # compare without motion\n  \
        ffgs run CAPTURE --out out/mini --resume"
)]
pub struct RunArgs {
    /// Folder of the capture; `ffgs check` tells whether it is usable
    pub capture: PathBuf,
    /// Output folder; new, or that of a run of the same capture with --resume
    #[arg(long, alias = "output", value_name = "DIR")]
    pub out: PathBuf,
    /// Go on with the frames that are not finished; the result is that of a run that was never stopped
    #[arg(long)]
    pub resume: bool,
    /// How the scene moves from frame to frame
    #[arg(long, alias = "init", value_name = "METHOD", value_parser = MethodParser)]
    pub method: Option<MethodChoice>,
    /// Iterations of the dynamic layer a frame
    #[arg(long, value_name = "N")]
    pub iterations: Option<usize>,
    /// Take this many steps of Adam a frame for the static layer's colours, instead of one linear solve (0 = leave them)
    #[arg(long, value_name = "N")]
    pub static_iterations: Option<usize>,
    /// Iterations of the first frame
    #[arg(long, value_name = "N")]
    pub first_iterations: Option<usize>,
    /// Frames A to B, B left out; `..B` and `A..` are allowed
    #[arg(long, value_name = "A..B")]
    pub frames: Option<FrameRange>,
    /// Training cameras to use, by name; the others are ignored
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub train_views: Option<Vec<String>>,
    /// Where to compute; auto = a hardware GPU where there is one, else the CPU
    #[arg(long, value_name = "auto|cpu|gpu[:N,N]", default_value = "auto")]
    pub device: Device,
    /// Settings beyond these options; `ffgs config` prints them all with what they mean. Options win
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Seed of every random choice; equal seeds give equal bytes
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Take the first frame from this finished run instead of training it
    #[arg(long, value_name = "RUN")]
    pub first_frame: Option<PathBuf>,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// `ffgs render`.
#[derive(Clone, Debug, Args)]
#[command(
    long_about = "Renders a finished run: one camera of the capture, or a path around the moving objects. Writes \
        PNGs, and for a path an mp4 as well when an ffmpeg is found.",
    after_help = "Examples:\n  ffgs render out/mini --frame 3 --camera trk009\n  \
        ffgs render out/mini --frame 3 --orbit --out orbit",
    group = clap::ArgGroup::new("view").required(true).args(["camera", "orbit"])
)]
pub struct RenderArgs {
    /// Output folder of the run
    pub run: PathBuf,
    /// Frame; the last finished one when left out
    #[arg(long, value_name = "N")]
    pub frame: Option<usize>,
    /// Camera of the capture, by name
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// A circle around the moving objects
    #[arg(long)]
    pub orbit: bool,
    /// Folder for the pictures [default: RUN/renders]
    #[arg(long, alias = "output", value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Where to compute; auto = a hardware GPU where there is one, else the CPU
    #[arg(long, value_name = "auto|cpu|gpu[:N,N]", default_value = "auto")]
    pub device: Device,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// `ffgs eval`.
#[derive(Clone, Debug, Args)]
#[command(
    long_about = "Renders the test views of a finished run again from its splats and recomputes PSNR, MPSNR and SSIM.",
    after_help = "Example:\n  ffgs eval out/mini"
)]
pub struct EvalArgs {
    /// Output folder of the run
    pub run: PathBuf,
    /// Where to compute; auto = a hardware GPU where there is one, else the CPU
    #[arg(long, value_name = "auto|cpu|gpu[:N,N]", default_value = "auto")]
    pub device: Device,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Frames from `start` up to but not including `end`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameRange {
    /// First frame.
    pub start: usize,
    /// Frame behind the last; `None` = to the end.
    pub end: Option<usize>,
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not A..B, e.g. 0..4 for the frames 0 to 3");
        let (start, end) = text.split_once("..").ok_or_else(wrong)?;
        let number = |part: &str| match part {
            "" => Ok(None),
            digits => digits.parse().map(Some).map_err(|_| wrong()),
        };
        let range = Self { start: number(start)?.unwrap_or(0), end: number(end)? };
        match range.end {
            Some(end) if end <= range.start => Err(format!("'{text}' holds no frame")),
            _ => Ok(range),
        }
    }
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
            let check = crate::check::check_capture(&args.capture, ImageCheck::Decode, args.log.quiet)?;
            terminal::print(check.to_string().trim_end());
            return Ok(if check.is_usable() { ExitCode::SUCCESS } else { ExitCode::FAILURE });
        }
        Command::Prepare(args) => {
            args.log.start();
            crate::prepare::run(&args)?;
        }
        Command::Convert(args) => crate::prepare::convert(&args)?,
        Command::Run(args) => {
            args.log.start();
            crate::interrupt::explain_signals();
            let report = crate::run::run(&crate::request::from_args(&args)?)?;
            terminal::print(report.display());
        }
        Command::Render(args) => {
            args.log.start();
            crate::render::render(&args)?;
        }
        Command::Eval(args) => {
            args.log.start();
            crate::eval::eval(&args)?;
        }
        Command::Export(args) => {
            args.log.start();
            crate::export::export(&args)?;
        }
        Command::View(args) => {
            args.log.start();
            crate::view::view(&args)?;
        }
        Command::Methods => terminal::print(METHODS.table().trim_end()),
        Command::Formats => terminal::print(format_args!("captures:\n{}", CAPTURES.table().trim_end())),
        Command::Devices => device::list(),
        Command::Config(args) => crate::config_text::print(&args)?,
        Command::Stage(args) => {
            args.log.start();
            stage::run(args.name, &args.input, &args.output, &args.device)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[derive(Debug, Parser)]
    struct Line<T: Args> {
        #[command(flatten)]
        args: T,
    }

    fn parse<T: Args>(words: &[&str]) -> Result<T, clap::Error> {
        Line::try_parse_from([&["ffgs"], words].concat()).map(|line: Line<T>| line.args)
    }

    #[test]
    fn the_definitions_are_consistent() {
        Cli::command().debug_assert();
        Line::<RunArgs>::command().debug_assert();
        Line::<RenderArgs>::command().debug_assert();
        Line::<EvalArgs>::command().debug_assert();
        Line::<crate::export::ExportArgs>::command().debug_assert();
    }

    #[test]
    fn a_run_takes_its_options() {
        let words =
            ["cap", "--out", "o", "--init", "tracker:dot", "--frames", "2..4", "--train-views", "a,b"];
        let args: RunArgs = parse(&words).unwrap();
        assert_eq!(args.method, "tracker:dot".parse().ok());
        assert_eq!(args.frames, Some(FrameRange { start: 2, end: Some(4) }));
        assert_eq!(args.train_views, Some(vec!["a".to_owned(), "b".to_owned()]));
        assert!(parse::<RunArgs>(&["cap"]).is_err());
    }

    #[test]
    fn frames_that_mean_nothing_are_refused() {
        assert_eq!("..3".parse(), Ok(FrameRange { start: 0, end: Some(3) }));
        assert_eq!("3..".parse(), Ok(FrameRange { start: 3, end: None }));
        for wrong in ["3", "3..3", "4..2", "a..b", "-1..2"] {
            assert!(wrong.parse::<FrameRange>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_render_is_of_a_camera_or_a_path() {
        assert!(parse::<RenderArgs>(&["out", "--output", "p", "--orbit"]).unwrap().orbit);
        assert!(parse::<RenderArgs>(&["out", "--output", "p"]).is_err());
        assert!(parse::<RenderArgs>(&["out", "--output", "p", "--orbit", "--camera", "a"]).is_err());
    }
}
