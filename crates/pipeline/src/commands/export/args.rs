//! Options of `ffgs export`.

use crate::cli::args::LogArgs;
use crate::job::request::FrameRange;
use anyhow::{Result, bail};
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
    /// What to write into files; static and dynamic together are one [default: static,dynamic,sky]
    #[arg(long, value_name = "LAYER,LAYER", value_delimiter = ',')]
    pub layers: Option<Vec<Layer>>,
    /// Do not fit the Gaussians of files to plain viewers
    #[arg(long)]
    pub native: bool,
    /// Steps that fit the first frame to plain viewers; later frames take a third of them [default: 2000]
    #[arg(long, value_name = "N", conflicts_with = "native")]
    pub bake_iterations: Option<usize>,
    /// Also compare renders of the export with the run's own, in the test views
    #[arg(long)]
    pub measure: bool,
    /// How fine a stream is: 2 halves every step [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = factor)]
    pub precision: Option<f64>,
    /// Store the standard deviation of each position in a stream, for the viewer's overlay of uncertainty
    #[arg(long)]
    pub uncertainty: bool,
    /// Playback rate of a stream (frames per second) [default: 30]
    #[arg(long, value_name = "FPS", value_parser = factor)]
    pub frames_per_second: Option<f64>,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// What is no file per frame: a stream, and one with the page that plays it.
const STREAM: &str = "stream";
const SITE: &str = "site";
const STREAMS: [&str; 2] = [STREAM, SITE];

impl ExportArgs {
    /// Whether a stream is written, and no file per frame.
    pub(super) fn is_stream(&self) -> bool {
        STREAMS.contains(&self.to.as_str())
    }

    /// Whether the page that plays a stream is written as well.
    pub(super) fn has_page(&self) -> bool {
        self.to == SITE
    }

    /// Refuses options that the chosen format has no use for.
    pub(super) fn check(&self) -> Result<()> {
        let (useless, others) = if self.is_stream() {
            (self.for_files(), file_formats())
        } else {
            (self.for_streams(), STREAMS.to_vec())
        };
        match useless.iter().find(|(_, given)| *given) {
            Some((option, _)) => {
                bail!("{option} has no effect on --to {}; it is for --to {}", self.to, others.join(", "))
            }
            None => Ok(()),
        }
    }

    /// The options that only files have, and whether each is given.
    fn for_files(&self) -> [(&'static str, bool); 3] {
        [
            ("--layers", self.layers.is_some()),
            ("--native", self.native),
            ("--bake-iterations", self.bake_iterations.is_some()),
        ]
    }

    /// The options that only streams have, and whether each is given.
    fn for_streams(&self) -> [(&'static str, bool); 3] {
        [
            ("--precision", self.precision.is_some()),
            ("--uncertainty", self.uncertainty),
            ("--frames-per-second", self.frames_per_second.is_some()),
        ]
    }
}

fn names() -> Vec<&'static str> {
    [&STREAMS[..], &file_formats()].concat()
}

fn file_formats() -> Vec<&'static str> {
    FORMATS.items.iter().map(|format| format.name()).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        export: ExportArgs,
    }

    fn checked(to: &str, options: &[&str]) -> Result<(), String> {
        let words = [&["export", "RUN", "--to", to], options].concat();
        let line = Line::try_parse_from(words).unwrap_or_else(|error| panic!("{error}"));
        line.export.check().map_err(|error| error.to_string())
    }

    #[test]
    fn options_without_an_effect_are_refused_with_the_formats_that_have_them() {
        let of_files: [&[&str]; 3] = [&["--layers", "sky"], &["--native"], &["--bake-iterations", "2000"]];
        let of_streams: [&[&str]; 3] =
            [&["--precision", "1"], &["--uncertainty"], &["--frames-per-second", "30"]];
        for format in names() {
            let is_stream = ["stream", "site"].contains(&format);
            let (useful, useless) = if is_stream { (of_streams, of_files) } else { (of_files, of_streams) };
            assert_eq!(checked(format, &[]), Ok(()), "{format}");
            assert!(useful.iter().all(|words| checked(format, words).is_ok()), "{format}");
            for words in useless {
                let error = checked(format, words).unwrap_err();
                let others = if is_stream { "spz" } else { "stream, site" };
                assert!(error.starts_with(words[0]) && error.contains(others), "{error}");
            }
        }
    }
}
