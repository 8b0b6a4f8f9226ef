//! `ffgs prepare`: footage to a capture.

use crate::cli::args::LogArgs;
use crate::cli::terminal;
use anyhow::Result;
use clap::Args;
use ffgs_dataset::Capture;
use ffgs_prepare::{Layout, Progress, Request, Step, TestCameras};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Mutex;

/// `ffgs prepare`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Make a capture of footage: videos or photographs with a calibration",
    long_about = "Makes a capture of videos or photographs with a calibration. The format is recognised: \
        Dynamic3DGaussians, CMU Panoptic, N3DV (poses_bounds.npy), nerfstudio and instant-ngp (transforms.json), \
        EasyVolcap and EasyMocap (intri.yml), caliscope, aniposelib and Pose2Sim (TOML), Qualisys (*.qca.txt), COLMAP (text or binary), a file of OpenCV per camera (XML or YAML). Pictures \
        of a camera are a video or a folder that has its name in the calibration (cam_1.mp4, cam_1/), below SOURCE; those \
        of a TOML, of Qualisys, of EasyVolcap or of OpenCV may also spell it otherwise (cam01.mp4), or be the only video in a folder of that name, \
        or with that word in its own. Lenses are undistorted; what is missing (masks, initial points, tracks) is made. The same command again goes on where \
        it stopped. docs/footage.md tells what each format asks for.",
    after_help = "Examples:\n  ffgs prepare session --out capture --scale 0.5\n  \
        ffgs prepare session --out capture --start 100 --count 50 --every 2 --offset cam_2=-3\n  \
        ffgs prepare session --out capture --only masks --force masks --clean-plates session/clean_plates\n  ffgs check capture && ffgs run capture --out run"
)]
pub struct PrepareArgs {
    /// Folder with the footage and its calibration
    pub source: PathBuf,
    /// Folder of the capture; new, or one that was begun with the same settings
    #[arg(long, alias = "output", value_name = "DIR")]
    pub out: PathBuf,
    /// The calibration's format instead of the one that is recognised: dynamic3dgs, panoptic, n3dv, transforms,
    /// easyvolcap, toml, qualisys, colmap or opencv
    #[arg(long, value_name = "NAME")]
    pub format: Option<String>,
    /// First frame of the footage
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub start: usize,
    /// Frames of the capture; all when left out
    #[arg(long, value_name = "N")]
    pub count: Option<usize>,
    /// Take every n-th frame
    #[arg(long, value_name = "N", default_value_t = NonZeroUsize::MIN)]
    pub every: NonZeroUsize,
    /// Size of the capture's images in parts of the footage's
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub scale: f64,
    /// Frames by which a camera's own video began too early; with timestamps, against its own times
    #[arg(long, value_name = "CAMERA=FRAMES", value_parser = parse_offset, value_delimiter = ',', allow_hyphen_values = true)]
    pub offset: Vec<(String, i64)>,
    /// The calibration's unit of length: m, cm, mm, or metres in one unit
    #[arg(long, value_name = "UNIT", value_parser = parse_unit)]
    pub unit: Option<f64>,
    /// Cameras held out for measuring: names, every:N, or none
    #[arg(long, value_name = "NAME,NAME|every:N|none")]
    pub test: Option<TestCameras>,
    /// Folder with pictures or videos of the empty scene (clean plates), named as the cameras: cam_1.png, cam_1.mp4 or
    /// cam_1/; masks are made from them instead of from what stands still in the footage
    #[arg(long, value_name = "DIR")]
    pub clean_plates: Option<PathBuf>,
    /// Take these steps only: pictures, masks, points, tracks
    #[arg(long, value_name = "STEP", value_delimiter = ',')]
    pub only: Vec<Step>,
    /// Throw away the results of these steps and make them again
    #[arg(long, value_name = "STEP", value_delimiter = ',')]
    pub force: Vec<Step>,
    /// Track with this optical-flow or matching network (ONNX) too: its description, or raft=FILE.onnx, xfeat=FILE.onnx
    /// for those that are described already. ONNX Runtime is loaded from ORT_DYLIB_PATH. Can be given several times
    #[arg(long, value_name = "FILE.toml|NAME=FILE.onnx")]
    pub network: Vec<String>,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// `ffgs track`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Track the images of a capture: sparse and medium trackers, and networks",
    long_about = "Tracks the images of every training camera from frame to frame and writes the tracks into the \
        capture, which has the layout of this project (train_meta.json): `descriptors` (sparse) and `lucas_kanade` \
        (medium), and networks as ONNX files. Tracks of other programs stay.",
    after_help = "Examples:\n  ffgs track capture\n  ffgs track capture --network raft=raft.onnx --network mine.toml"
)]
pub struct TrackArgs {
    /// Folder of the capture
    pub capture: PathBuf,
    /// Track with this optical-flow or matching network too, as for `ffgs prepare`
    #[arg(long, value_name = "FILE.toml|NAME=FILE.onnx")]
    pub network: Vec<String>,
    /// Discard the tracks of these trackers and track again
    #[arg(long)]
    pub force: bool,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Tracks and prints what was made.
///
/// # Errors
/// When the capture cannot be read or written, or a network cannot be used.
pub(crate) fn track(args: &TrackArgs) -> Result<()> {
    let bars = Bars::new(args.log.quiet);
    let made = ffgs_prepare::track(&args.capture, &args.network, args.force, &bars);
    bars.finish();
    terminal::print(made.map_err(|e| anyhow::anyhow!("{e}\n  fix: {}", e.fix()))?);
    Ok(())
}

/// `ffgs convert`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Convert a frame of a capture to nerfstudio or COLMAP",
    long_about = "Writes one frame of a capture, with its images, cameras and points, in the layout of another tool: \
        transforms.json of nerfstudio, or a text model of COLMAP.",
    after_help = "Example:\n  ffgs convert capture --to colmap --frame 3 --out colmap3"
)]
pub struct ConvertArgs {
    /// Folder of the capture
    pub capture: PathBuf,
    /// The layout: nerfstudio or colmap
    #[arg(long, value_name = "LAYOUT")]
    pub to: Layout,
    /// The frame; its initial points are those of frame 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub frame: usize,
    /// Folder that is written
    #[arg(long, alias = "output", value_name = "DIR")]
    pub out: PathBuf,
}

/// Writes a frame of a capture for other tools.
///
/// # Errors
/// When the capture cannot be read or the folder cannot be written.
pub(crate) fn convert(args: &ConvertArgs) -> Result<()> {
    let capture = Capture::open(&args.capture).map_err(|e| anyhow::anyhow!("{e}\n  fix: {}", e.fix()))?;
    ffgs_prepare::convert(&capture, args.to, args.frame, &args.out)
        .map_err(|e| anyhow::anyhow!("{e}\n  fix: {}", e.fix()))
}

fn parse_offset(text: &str) -> Result<(String, i64), String> {
    let wrong = || format!("'{text}' is not CAMERA=FRAMES, e.g. cam_2=-3");
    let (camera, frames) = text.split_once('=').ok_or_else(wrong)?;
    Ok((camera.to_owned(), frames.parse().map_err(|_| wrong())?))
}

fn parse_unit(text: &str) -> Result<f64, String> {
    match text {
        "m" => Ok(1.0),
        "cm" => Ok(0.01),
        "mm" => Ok(0.001),
        number => number
            .parse()
            .ok()
            .filter(|v: &f64| *v > 0.0 && v.is_finite())
            .ok_or_else(|| format!("'{text}' is not m, cm, mm or a positive number")),
    }
}

/// Prepares and prints what was read, made and assumed.
///
/// # Errors
/// When the footage cannot be prepared; the message names file and fix.
pub(crate) fn run(args: &PrepareArgs) -> Result<()> {
    let request = Request {
        format: args.format.clone(),
        start: args.start,
        count: args.count,
        every: args.every,
        scale: args.scale,
        offsets: args.offset.iter().cloned().collect(),
        metres_per_unit: args.unit,
        test: args.test.clone().unwrap_or_default(),
        clean_plates: args.clean_plates.clone(),
        only: args.only.clone(),
        force: args.force.clone(),
        networks: args.network.clone(),
        ..Request::new(args.source.clone(), args.out.clone())
    };
    let bars = Bars::new(args.log.quiet);
    let summary = ffgs_prepare::prepare(&request, &bars);
    bars.finish();
    let summary = summary.map_err(|e| anyhow::anyhow!("{e}\n  fix: {}", e.fix()))?;
    terminal::print(summary.to_string().trim_end());
    Ok(())
}

/// A bar on a terminal; elsewhere a line at every tenth of a step.
struct Bars {
    quiet: bool,
    bar: ProgressBar,
    last: Mutex<(String, usize)>,
}

impl Bars {
    fn new(quiet: bool) -> Self {
        let style = ProgressStyle::with_template("{msg:10} {bar:40} {pos}/{len}, {eta} left");
        let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(0) };
        let bar = bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        Self { quiet, bar, last: Mutex::default() }
    }

    fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Progress for Bars {
    fn advance(&self, step: &str, done: usize, total: usize) {
        // A panic elsewhere leaves a step's name and a count, which are as good as ever.
        let mut last = self.last.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let tenth = 10 * done / total.max(1);
        let is_new = last.0 != step;
        if is_new {
            self.bar.reset();
            self.bar.set_message(step.to_owned());
        }
        if is_new || tenth > last.1 {
            if !self.quiet && !std::io::stderr().is_terminal() {
                terminal::note(format_args!("{step}: {done} of {total}"));
            }
            *last = (step.to_owned(), tenth);
        }
        self.bar.set_length(total as u64);
        self.bar.set_position(done.max(usize::try_from(self.bar.position()).unwrap_or(0)) as u64);
    }
}
