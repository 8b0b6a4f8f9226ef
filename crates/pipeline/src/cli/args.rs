//! Options of the commands on runs, and how they become requests.

use crate::cli::terminal;
use crate::commands::stage::Stage;
use crate::job::device::Device;
use crate::job::request::{FrameRange, RunRequest};
use crate::plugins::choice::{MethodChoice, MethodParser};
use crate::settings::config::Config;
use anyhow::Result;
use clap::{ArgAction, Args};
use ffgs_trainer::StaticMethod;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use tracing::level_filters::LevelFilter;

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
    about = "Show what a capture holds and every fault in it",
    long_about = "Reads every camera, image, mask, point and track of a capture and prints what it holds: views, \
        frames, sizes, masks, points, tracks per tracker. Every fault is printed with its file and what to do about \
        it; with a fault the exit status is 1. A run makes the same check before it starts, \
        but looks only at the size and the end of images, which it decodes later.",
    after_help = "Example:\n  ffgs check fixtures/scenes/fairmont-mini"
)]
pub struct CheckArgs {
    /// Folder of the capture
    pub capture: PathBuf,
    /// Also write a picture per training camera: image, outline of the mask, initial points, tracks to the next frame
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// `ffgs stage`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Run one stage on numpy arrays",
    long_about = "Runs one stage of the method alone, on numpy arrays. Inputs may have any float or integer type; \
        arrays that the stage does not know are ignored. The output is written whole or not at all.",
    after_help = "Examples:\n  ffgs stage voronoi --input tracks.npz --output motion.npz\n  \
        ffgs stage rasterize --input fixtures/reference/rasterize/c01_two.npz --output image.npz"
)]
pub struct StageArgs {
    /// The stage; `ffgs stage --help` lists the arrays of each
    #[arg(value_enum, value_name = "NAME")]
    pub name: Stage,
    /// Our most literal reading of the paper (associate, fuse), and SSIM in f64, instead of what a run does
    #[arg(long)]
    pub literal: bool,
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
    about = "Reconstruct a capture, frame by frame",
    long_about = "Reconstructs a capture. The first frame is trained from images; each later frame starts from the \
        one before it, moved by what the trackers saw, and is finetuned. The output folder receives splats (PLY), \
        rendered test views, metrics.json, run.json and report.html, which opens in any browser. Finished frames \
        are kept when the process is killed; --resume goes on from there.",
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
    /// Iterations of the dynamic layer per frame [default: dynamic.iterations of the settings]
    #[arg(long, value_name = "N")]
    pub iterations: Option<usize>,
    /// Take this many steps of Adam per frame for the static layer's colours, instead of one linear solve (0 = leave them)
    #[arg(long, value_name = "N")]
    pub static_iterations: Option<usize>,
    /// Iterations of the first frame, 35 % of them with up to first_frame.few_views views [default: first_frame.iterations of the settings]
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
    /// Seed of every random choice; equal seeds give equal bytes with the same version and kind of device
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Show the run in the browser while it goes on: prints the address of the page, and serves it until it is stopped
    #[arg(long)]
    pub view: bool,
    /// Take the first frame from this finished run instead of training it
    #[arg(long, value_name = "RUN")]
    pub first_frame: Option<PathBuf>,
    /// Finetune that frame for N iterations, the static layer and the sky with it; `ffgs segment` uses this
    #[arg(long, value_name = "N", requires = "first_frame")]
    pub refine_first: Option<usize>,
    /// Keep the Gaussians of every Nth frame and of the last alone; of the others the numbers and the report's pictures stay
    #[arg(long, value_name = "N")]
    pub keep: Option<NonZeroUsize>,
    /// Most memory that the run may take [default: what the machine has free]; one that needs more does not start, and says
    /// what to change; where it is just enough, the next frame's photographs are not read ahead. Each GPU may take as much [default:
    /// what its driver gives]; where that is too little for all photographs, they cross to it one by one
    #[arg(long, value_name = "MIB")]
    pub memory: Option<usize>,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

impl RunArgs {
    /// Merges the configuration file (or the defaults) with the options, which win.
    ///
    /// # Errors
    /// When the file cannot be read or a setting is out of range.
    pub fn request(&self) -> Result<RunRequest> {
        let mut config = self.config.as_deref().map_or_else(|| Ok(Config::default()), Config::read)?;
        config.seed = self.seed.unwrap_or(config.seed);
        config.first_frame.iterations = self.first_iterations.unwrap_or(config.first_frame.iterations);
        config.dynamic.iterations = self.iterations.unwrap_or(config.dynamic.iterations);
        if let Some(steps) = self.static_iterations {
            config.background.static_method = StaticMethod::Steps;
            config.background.static_iterations = steps;
        }
        config.validate()?;
        Ok(RunRequest {
            capture: self.capture.clone(),
            out: self.out.clone(),
            resume: self.resume,
            method: self.method.clone(),
            frames: self.frames,
            train_views: self.train_views.clone(),
            first_frame: self.first_frame.clone(),
            refine_first: self.refine_first,
            keep: self.keep,
            memory: self.memory,
            device: self.device.clone(),
            quiet: self.log.quiet,
            config,
        })
    }
}

/// `ffgs render`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Render a finished run: a camera, or a circle around the moving objects",
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
    about = "Compute PSNR, SSIM, flicker and VMAF of a finished run's test views",
    long_about = "Renders the test views of a finished run again from its splats and recomputes PSNR, MPSNR and SSIM. Over each \
        test view's video, in time order, it finds the flicker and, where an ffmpeg with libvmaf is found, VMAF: the one that \
        the environment variable FFGS_FFMPEG names, or that of the PATH.",
    after_help = "Examples:\n  ffgs eval out/mini\n  ffgs eval out/mini --no-vmaf\n  \
        FFGS_FFMPEG=$(python3 -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())') ffgs eval out/mini"
)]
pub struct EvalArgs {
    /// Output folder of the run
    pub run: PathBuf,
    /// Leave VMAF out
    #[arg(long)]
    pub no_vmaf: bool,
    /// Where to compute; auto = a hardware GPU where there is one, else the CPU
    #[arg(long, value_name = "auto|cpu|gpu[:N,N]", default_value = "auto")]
    pub device: Device,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{CommandFactory, Parser};

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
        Line::<RunArgs>::command().debug_assert();
        Line::<RenderArgs>::command().debug_assert();
        Line::<EvalArgs>::command().debug_assert();
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
    fn a_render_is_of_a_camera_or_a_path() {
        assert!(parse::<RenderArgs>(&["out", "--output", "p", "--orbit"]).unwrap().orbit);
        assert!(parse::<RenderArgs>(&["out", "--output", "p"]).is_err());
        assert!(parse::<RenderArgs>(&["out", "--output", "p", "--orbit", "--camera", "a"]).is_err());
    }

    #[test]
    fn options_win_over_the_file_and_the_file_over_the_defaults() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("settings.toml");
        std::fs::write(&file, "seed = 7\ndynamic.iterations = 11\nfirst_frame.iterations = 13").unwrap();
        let file = file.to_str().unwrap();
        let words =
            ["cap", "--out", "o", "--config", file, "--iterations", "5", "--method", "none", "--quiet"];
        let request = parse::<RunArgs>(&words).unwrap().request().unwrap();
        let config = &request.config;
        assert_eq!((config.seed, config.dynamic.iterations, config.first_frame.iterations), (7, 5, 13));
        assert_eq!(config.background, Config::default().background);
        assert_eq!((request.method, request.quiet, request.resume), ("none".parse().ok(), true, false));
        let steps = ["cap", "--out", "o", "--static-iterations", "9", "--seed", "3"];
        let config = parse::<RunArgs>(&steps).unwrap().request().unwrap().config;
        assert_eq!(
            (config.background.static_method, config.background.static_iterations),
            (StaticMethod::Steps, 9)
        );
        assert_eq!(config.seed, 3);
    }

    #[test]
    fn a_setting_out_of_range_is_refused_before_anything_runs() {
        let args: RunArgs = parse(&["cap", "--out", "o", "--seed", "9223372036854775807"]).unwrap();
        let refused = args.request().unwrap_err().to_string();
        assert!(refused.contains("seed"), "{refused}");
        let gone: RunArgs = parse(&["cap", "--out", "o", "--config", "no/such.toml"]).unwrap();
        assert!(format!("{:#}", gone.request().unwrap_err()).contains("no/such.toml"));
    }
}
