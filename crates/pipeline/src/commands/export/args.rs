//! Options of `ffgs export`.

use crate::cli::args::LogArgs;
use crate::job::request::FrameRange;
use clap::builder::PossibleValuesParser;
use clap::{Args, ValueEnum};
use ffgs_splats::FORMATS;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// `ffgs export`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Write a finished run as files for other players",
    long_about = "Writes a finished run, or one that still goes on, as splat files for other players, one per frame. \
        This program trains with the opacity compensation of Mip-Splatting, which ordinary viewers do not have: there \
        the files of the run lose 3 to 9 dB. An export is therefore baked: everything is fitted so that ordinary viewers \
        show what the run's own renders show, from its cameras and from between them. Little of the quality is lost then, except \
        where cameras stand at very different distances; --measure tells. --native leaves the Gaussians as they are, for players \
        that compensate (Brush, SuperSplat with antialiasing). Files that exist are kept, so an interrupted export goes on.",
    after_help = export_examples()
)]
pub struct ExportArgs {
    /// Output folder of the run
    pub run: PathBuf,
    /// Format
    #[arg(long, value_name = "FORMAT", value_parser = PossibleValuesParser::new(names()))]
    pub to: String,
    /// Folder for the files [default: RUN/export/FORMAT]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Frames A to B, B left out; `..B` and `A..` are allowed
    #[arg(long, value_name = "A..B")]
    pub frames: Option<FrameRange>,
    /// What to write; static and dynamic together are one file
    #[arg(long, value_name = "LAYER,LAYER", value_delimiter = ',', default_values = ["static", "dynamic", "sky"])]
    pub layers: Vec<Layer>,
    /// Do not fit the Gaussians to plain viewers
    #[arg(long)]
    pub native: bool,
    /// Steps that fit the first frame to plain viewers; later frames take a third of them
    #[arg(long, value_name = "N", default_value_t = 2000, conflicts_with = "native")]
    pub bake_iterations: usize,
    /// Also compare renders of the export with the run's own, in the test views
    #[arg(long)]
    pub measure: bool,
    /// How fine a stream is: 2 halves every step
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = factor)]
    pub precision: f64,
    /// Store the standard deviation of each position, for the viewer's overlay of uncertainty
    #[arg(long)]
    pub uncertainty: bool,
    /// Playback rate of a stream (frames per second)
    #[arg(long, value_name = "FPS", default_value_t = 30.0, value_parser = factor)]
    pub frames_per_second: f64,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// What is no file per frame: a stream, and one with the page that plays it.
pub(super) const STREAM: &str = "stream";
pub(super) const SITE: &str = "site";

fn names() -> Vec<&'static str> {
    [STREAM, SITE].into_iter().chain(FORMATS.items.iter().map(|f| f.name())).collect()
}

fn factor(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.01..=1000.0).contains(&value) => Ok(value),
        _ => Err("expected a number from 0.01 to 1000".to_owned()),
    }
}

fn export_examples() -> String {
    let text = "Examples:\n  ffgs export out/mini --to compressed-ply-seq          # for SuperSplat\n  \
        ffgs export out/mini --to spz --layers dynamic --frames 2..5\n  \
        ffgs export out/mini --to ply-seq --measure\n  \
        ffgs export out/mini --to stream                      # all of it, small: docs/STREAM.md\n\nFormats:\n  \
        stream              our own: one small file per frame, random access, appended to as a run goes on\n  \
        site                the stream with a page that plays it, for any web server\n"
        .to_owned();
    text + &FORMATS.table()
}

/// Part of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layer {
    /// The static layer.
    Static,
    /// The dynamic layer.
    Dynamic,
    /// What lies at infinity, as an equirectangular image.
    Sky,
}
