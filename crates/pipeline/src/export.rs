//! `ffgs export`: a finished run as files for players.

use crate::bake::Baker;
use crate::cli::{FrameRange, LogArgs};
use crate::export_stream::export_stream;
use crate::measure::{Measurement, Shown, measure, table};
use crate::record::{read_json, write_json};
use crate::render::{FinishedRun, progress};
use crate::terminal;
use anyhow::{Result, bail, ensure};
use clap::builder::PossibleValuesParser;
use clap::{Args, ValueEnum};
use ffgs_core::{Gaussians, Scene, spatial_order};
use ffgs_method::{RenderMode, SplatWriter, Split, ViewAt};
use ffgs_splats::{FORMATS, write_sky_equirectangular};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// `ffgs export`.
#[derive(Clone, Debug, Args)]
#[command(
    long_about = "Writes a finished run, or one that still goes on, as splat files for other players, one per frame. \
        This program trains with the opacity compensation of Mip-Splatting, which ordinary viewers do not have: there \
        the files of the run lose 3 to 9 dB. An export is therefore baked: opacities, scales and colours are fitted \
        to plain viewers, which brings about half of that back; --measure tells. --native leaves the Gaussians as they are, for players that compensate \
        (Brush, SuperSplat with antialiasing). Files that exist are kept, so an interrupted export goes on.",
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
    #[arg(long, value_name = "N", default_value_t = 600, conflicts_with = "native")]
    pub bake_iterations: usize,
    /// Also compare plain renders of the export with the run's own, in the test views
    #[arg(long)]
    pub measure: bool,
    /// How fine a stream is: 2 halves every step
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = factor)]
    pub precision: f64,
    /// At which a stream plays
    #[arg(long, value_name = "FPS", default_value_t = 30.0, value_parser = factor)]
    pub frames_per_second: f64,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// What is no file per frame: a stream, and one with the page that plays it.
const STREAM: &str = "stream";
const SITE: &str = "site";

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
    /// What stands still.
    Static,
    /// What moves.
    Dynamic,
    /// What lies at infinity, as an equirectangular image.
    Sky,
}

/// `export.json`: what the files of a folder are.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Description {
    format: String,
    /// Name of the capture.
    capture: String,
    layers: Vec<Layer>,
    /// Whether ordinary viewers show the files as the run was trained.
    baked: bool,
    bake_iterations: usize,
    /// First frame, from which the static layer is baked.
    first: usize,
    /// The sky's top row looks along this, unit, world axes.
    up: [f32; 3],
    /// The sky's middle column looks along this.
    forward: [f32; 3],
}

/// Writes the export.
pub fn export(args: &ExportArgs) -> Result<()> {
    let out = args.out.clone().unwrap_or_else(|| args.run.join("export").join(&args.to));
    if args.to == STREAM || args.to == SITE {
        return export_stream(args, &out, args.to == SITE);
    }
    export_files(args, FORMATS.find(&args.to)?, out)
}

fn export_files(args: &ExportArgs, format: &'static dyn SplatWriter, out: PathBuf) -> Result<()> {
    let run = FinishedRun::open(&args.run)?;
    let frames = chosen(&run, args.frames)?;
    let axes = Axes::of(&run, frames[0])?;
    let description = Description {
        format: format.name().to_owned(),
        capture: run.manifest.capture.clone(),
        layers: args.layers.clone(),
        baked: !args.native,
        bake_iterations: args.bake_iterations,
        first: frames[0],
        up: axes.up.to_array(),
        forward: axes.forward.to_array(),
    };
    claim(&out, &description)?;
    let export = Export { args, run, format, out, axes };
    let measured = export.frames(&frames)?;
    if args.measure {
        terminal::print(table(&measured).trim_end());
        write_json(&export.out.join("measure.json"), &measured)?;
    }
    terminal::print(export.out.display());
    Ok(())
}

/// The finished frames in a range.
pub(crate) fn chosen(run: &FinishedRun, range: Option<FrameRange>) -> Result<Vec<usize>> {
    let range = range.unwrap_or_default();
    let inside = |f: &usize| *f >= range.start && range.end.is_none_or(|end| *f < end);
    let frames: Vec<usize> = run.frames.iter().copied().filter(inside).collect();
    ensure!(!frames.is_empty(), "--frames: none of them is finished; this run has {:?}", run.frames);
    Ok(frames)
}

/// Takes the folder for this export: a new one, or one that the same export began.
fn claim(out: &Path, description: &Description) -> Result<()> {
    let file = out.join("export.json");
    if file.exists() && read_json::<Description>(&file)? != *description {
        bail!("{} holds another export; choose another --out or remove the folder", out.display());
    }
    write_json(&file, description)
}

/// How a capture stands in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axes {
    /// The mean of the cameras' up directions.
    pub up: Vec3,
    /// Where the first training camera looks, at right angles to `up`.
    pub forward: Vec3,
}

impl Axes {
    /// Of the training cameras of a frame.
    pub(crate) fn of(run: &FinishedRun, frame: usize) -> Result<Self> {
        let views = run.capture.views(Split::Train).len();
        let cameras = (0..views)
            .map(|view| run.capture.camera(ViewAt { split: Split::Train, view, frame }))
            .collect::<Result<Vec<_>, _>>()?;
        let up = cameras.iter().map(|c| -c.rotation().row(1)).sum::<DVec3>().normalize_or(DVec3::Z);
        let ahead = cameras.first().map_or(DVec3::X, |c| c.rotation().row(2));
        let forward = ahead.reject_from_normalized(up).normalize_or(up.any_orthonormal_vector());
        Ok(Self { up: up.as_vec3(), forward: forward.as_vec3() })
    }
}

struct Export<'a> {
    args: &'a ExportArgs,
    run: FinishedRun,
    format: &'static dyn SplatWriter,
    out: PathBuf,
    axes: Axes,
}

impl Export<'_> {
    fn frames(&self, frames: &[usize]) -> Result<Vec<Measurement>> {
        let bar = progress(self.args.log.quiet, "frames", frames.len());
        let mut baker = Baker::new(&self.run, frames[0], self.args.bake_iterations);
        let mut measured = Vec::new();
        for &frame in frames {
            if self.args.measure || !self.is_written(frame) {
                let scene = self.run.scene(frame)?;
                let joint = if self.args.native { scene.joint() } else { baker.bake(&scene, frame)? };
                self.write(frame, &scene, &joint)?;
                if self.args.measure {
                    let path = self.splat_path(frame);
                    let read = self.as_read(&path, joint)?;
                    let shown = Shown { gaussians: &read, sky: None, antialiased: self.args.native };
                    measured.push(measure(&*self.run.capture, &scene, &shown, frame)?);
                }
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(measured)
    }

    fn has(&self, layer: Layer) -> bool {
        self.args.layers.contains(&layer)
    }

    fn splat_path(&self, frame: usize) -> PathBuf {
        let stem = match (self.has(Layer::Static), self.has(Layer::Dynamic)) {
            (true, false) => "static",
            (false, true) => "dynamic",
            _ => "frame",
        };
        self.out.join(format!("{stem}_{frame:04}{}", self.format.extension()))
    }

    fn sky_path(&self, frame: usize) -> PathBuf {
        self.out.join(format!("sky_{frame:04}.jpg"))
    }

    fn has_splats(&self) -> bool {
        self.has(Layer::Static) || self.has(Layer::Dynamic)
    }

    fn is_written(&self, frame: usize) -> bool {
        (!self.has_splats() || self.splat_path(frame).exists())
            && (!self.has(Layer::Sky) || self.sky_path(frame).exists())
    }

    /// `joint`: the static layer, then the dynamic one.
    fn write(&self, frame: usize, scene: &Scene, joint: &Gaussians) -> Result<()> {
        if self.has_splats() {
            let chosen = self.in_layers(joint, scene.static_layer.len());
            let mode = if self.args.native { RenderMode::Mip } else { RenderMode::Plain };
            self.format.write(&self.splat_path(frame), &chosen, mode)?;
        }
        if self.has(Layer::Sky) {
            let (size, texels) = (scene.sky.face_size(), scene.sky.texels.as_flattened());
            write_sky_equirectangular(&self.sky_path(frame), size, texels, self.axes.up, self.axes.forward)?;
        }
        Ok(())
    }

    /// The Gaussians of the chosen layers in spatial order, which compresses best.
    fn in_layers(&self, joint: &Gaussians, statics: usize) -> Gaussians {
        let part = |i: &usize| self.has(if *i < statics { Layer::Static } else { Layer::Dynamic });
        let order: Vec<usize> = spatial_order(&joint.means).into_iter().filter(part).collect();
        joint.select(&order)
    }

    /// What a player reads, where we can read the format and both layers are in the file; else what was written.
    fn as_read(&self, path: &Path, joint: Gaussians) -> Result<Gaussians> {
        let whole = self.has(Layer::Static) && self.has(Layer::Dynamic);
        match self.format.read(path).filter(|_| whole) {
            Some(read) => Ok(read?),
            None => Ok(joint),
        }
    }
}
