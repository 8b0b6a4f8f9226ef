//! `ffgs export --to stream` and `--to site`: a run as a 4D stream.

use super::args::ExportArgs;
use super::axes::{Axes, chosen, tell_of_thinned};
use crate::cli::terminal::{self, progress};
use crate::commands::export::importance::Importance;
use crate::commands::export::measure::{Measurement, Shown, measure, table};
use crate::commands::view::cameras::Views;
use crate::commands::view::page::write_page;
use crate::job::lock::FolderLock;
use crate::job::request::FrameRange;
use crate::outputs::finished_run::FinishedRun;
use crate::outputs::json::write_json;
use anyhow::{Context, Result, bail};
use ffgs_core::PixelFilter;
use ffgs_splats::{Panorama, encode_sky_equirectangular};
use ffgs_stream::{Entry, Frame, Manifest, Precision, Reader, Steps, Writer};
use glam::DMat3;
use std::path::Path;

/// Frames from one key frame to the next: random access reads at most so many files.
const KEY_EVERY: u64 = 30;
/// The mean difference of its texels (0..=1) from which a sky is sent again.
const SKY_CHANGE: f32 = 2.0 / 255.0;
/// Of the static and of the dynamic layer. Static positions are sent once, and one that is off opens gaps between its neighbours;
/// docs/STREAM.md has the tables that the rest follows from.
pub(crate) const PRECISION: [Precision; 2] = [Precision { position: 13.0, rotation: 38, ..DYNAMIC }, DYNAMIC];
const DYNAMIC: Precision = Precision {
    position: 6.5,
    scales_per_octave: 4,
    rotation: 25,
    opacity: 16,
    colour: 0.12,
    harmonic: 0.05,
};

/// How a stream is written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StreamOptions {
    /// How fine: 2 halves every step.
    pub precision: f64,
    /// At which it plays.
    pub frames_per_second: f64,
    /// Frames of the run.
    pub frames: Option<FrameRange>,
    /// Whether it says how well each position is known.
    pub uncertainty: bool,
}

impl Default for StreamOptions {
    fn default() -> Self {
        Self { precision: 1.0, frames_per_second: 30.0, frames: None, uncertainty: false }
    }
}

impl StreamOptions {
    fn of(args: &ExportArgs) -> Self {
        let usual = Self::default();
        Self {
            precision: args.precision.unwrap_or(usual.precision),
            frames_per_second: args.frames_per_second.unwrap_or(usual.frames_per_second),
            frames: args.frames,
            uncertainty: args.uncertainty,
        }
    }
}

/// Writes the stream of the chosen frames, or goes on with one, and shows what it costs.
pub(crate) fn export_stream(args: &ExportArgs, out: &Path) -> Result<()> {
    let run = FinishedRun::open(&args.run)?;
    let mut export = StreamExport::open(&run, out, &StreamOptions::of(args))?;
    export.catch_up(&run, args.log.quiet)?;
    if args.has_page() {
        write_page(out)?;
        write_json(&out.join("cameras.json"), &Views::of(&*run.capture, Some(&run.folder), false)?)?;
    }
    let mut reader = Reader::open(out)?;
    terminal::print(bytes_table(reader.entries()).trim_end());
    if args.measure {
        let frames = chosen(&run, args.frames)?;
        let measured = measure_all(&run, &mut reader, &frames, Axes::of(&*run.capture, frames[0])?)?;
        terminal::print(table(&measured).trim_end());
        write_json(&out.join("measure.json"), &measured)?;
    }
    terminal::print(out.display());
    Ok(())
}

/// Appends the frames of a run to a stream as they are finished.
pub(crate) struct StreamExport {
    writer: Writer,
    /// The sky last written.
    sky: Vec<f32>,
    axes: Axes,
    /// And how many frames it has served for.
    importance: Option<(Importance, u64)>,
    frames: Option<FrameRange>,
    uncertainty: bool,
    /// The last frame looked at.
    seen: Option<usize>,
    /// `ffgs view` and `ffgs run --view` write the same stream.
    _lock: FolderLock,
}

impl StreamExport {
    /// Begins a stream, or goes on with the one that the same export began. Nobody else writes it meanwhile.
    pub(crate) fn open(run: &FinishedRun, out: &Path, options: &StreamOptions) -> Result<Self> {
        let lock = FolderLock::take(out).context("cannot write the stream")?;
        tell_of_thinned(run, options.frames);
        let first = chosen(run, options.frames)?[0];
        let axes = Axes::of(&*run.capture, first)?;
        let writer = open(out, run, first, axes, options)?;
        Ok(Self {
            writer,
            sky: Vec::new(),
            axes,
            importance: None,
            frames: options.frames,
            uncertainty: options.uncertainty,
            seen: None,
            _lock: lock,
        })
    }

    /// Writes the frames that the stream does not have yet. After an error the export must be opened again.
    pub(crate) fn catch_up(&mut self, run: &FinishedRun, quiet: bool) -> Result<()> {
        let mut frames = chosen(run, self.frames)?;
        frames.retain(|&frame| self.seen.is_none_or(|seen| seen < frame));
        let bar = progress(quiet, "frames", frames.len());
        for frame in frames {
            if self.writer.last_frame().is_none_or(|last| last < frame as u64) {
                self.push(run, frame)?;
            }
            self.seen = Some(frame);
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(())
    }

    fn push(&mut self, run: &FinishedRun, frame: usize) -> Result<()> {
        let scene = run.scene(frame)?;
        let texels = scene.sky.texels.as_flattened();
        let Axes { up, forward } = self.axes;
        let deviations: Vec<f32> = scene.dynamic.covariances.iter().map(deviation).collect();
        let (importance, uses) = match self.importance.take() {
            Some((last, uses)) if uses < KEY_EVERY && last.fits(&scene) => (last, uses + 1),
            _ => (Importance::new(&scene, &*run.capture, frame)?, 1),
        };
        let (still, moving) = importance.of(&scene);
        let entry = self.writer.push(&Frame {
            frame: frame as u64,
            static_layer: &scene.static_layer,
            dynamic_layer: &scene.dynamic.gaussians,
            ids: &scene.dynamic.ids,
            uncertainty: self.uncertainty.then_some(&deviations[..]),
            sky: &encode_sky_equirectangular(scene.sky.face_size(), texels, up, forward)?,
            sky_has_changed: difference(texels, &self.sky) > SKY_CHANGE,
            importance: Some([still, &moving]),
        })?;
        if entry.sky {
            texels.clone_into(&mut self.sky);
        }
        self.importance = Some((importance, uses));
        Ok(())
    }
}

/// Standard deviation of a position: the root of the mean of its three variances.
fn deviation(covariance: &DMat3) -> f32 {
    let variances = covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z;
    (variances / 3.0).max(0.0).sqrt() as f32
}

/// A new stream, or the one that the same export began.
fn open(out: &Path, run: &FinishedRun, first: usize, axes: Axes, options: &StreamOptions) -> Result<Writer> {
    let scene = run.scene(first)?;
    let (still, moving) = (&scene.static_layer, &scene.dynamic.gaussians);
    let precision = PRECISION.map(|layer| layer.times(options.precision));
    let manifest = Manifest {
        format: String::new(),
        version: 0,
        title: run.manifest.capture.clone(),
        frames_per_second: options.frames_per_second,
        antialiased: still.filter == PixelFilter::Compensated,
        up: axes.up.to_array(),
        forward: axes.forward.to_array(),
        static_steps: Steps::of(still, &precision[0]),
        dynamic_steps: Steps::of(moving, &precision[1]),
    };
    if !out.join("manifest.json").exists() {
        return Ok(Writer::create(out, manifest, [still, moving], precision.each_ref(), KEY_EVERY)?);
    }
    let writer = Writer::append(out, KEY_EVERY)?;
    let same =
        Manifest { format: writer.manifest().format.clone(), version: writer.manifest().version, ..manifest };
    if *writer.manifest() != same {
        bail!("{} holds another stream; choose another --out or remove the folder", out.display());
    }
    refuse_other_uncertainty(out, options.uncertainty)?;
    Ok(writer)
}

/// Uncertainties are in all frames of a stream or in none.
fn refuse_other_uncertainty(out: &Path, uncertainty: bool) -> Result<()> {
    match has_uncertainty(out)? {
        Some(true) if !uncertainty => bail!(
            "{} holds a stream with uncertainties; give --uncertainty, choose another --out or remove the folder",
            out.display()
        ),
        Some(false) if uncertainty => bail!(
            "{} holds a stream without uncertainties; leave --uncertainty out, choose another --out or remove the folder",
            out.display()
        ),
        _ => Ok(()),
    }
}

/// Whether the frames of a stream say how well positions are known, when it has any.
pub(crate) fn has_uncertainty(stream: &Path) -> Result<Option<bool>> {
    Ok(Reader::open(stream)?.entries().last().map(Entry::has_uncertainty))
}

/// Mean difference of texels as they are shown; all of it when the sizes differ.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    if a.len() != b.len() {
        return 1.0;
    }
    let sum: f32 = a.iter().zip(b).map(|(x, y)| (x.clamp(0.0, 1.0) - y.clamp(0.0, 1.0)).abs()).sum();
    sum / a.len().max(1) as f32
}

/// Bytes of each frame by section, and the means with and without the first frame.
fn bytes_table(entries: &[Entry]) -> String {
    let row = |e: &Entry| {
        let sections: Vec<String> =
            e.sections.iter().map(|(name, bytes)| format!("{name} {bytes}")).collect();
        format!("{:>6}  {:>9}  {}\n", e.frame, e.bytes, sections.join(", "))
    };
    let mean = |entries: &[Entry]| {
        entries.iter().map(|e| e.bytes).sum::<u64>() as f64 / entries.len().max(1) as f64 / 1e6
    };
    let later = entries.get(1..).filter(|later| !later.is_empty());
    let later = later.map(|later| format!(", {:.3} MB without the first", mean(later))).unwrap_or_default();
    let rows: String = entries.iter().map(row).collect();
    format!(
        "{:>6}  {:>9}  sections (bytes)\n{rows}{:.3} MB per frame{later}\n",
        "frame",
        "bytes",
        mean(entries)
    )
}

fn measure_all(
    run: &FinishedRun,
    reader: &mut Reader,
    frames: &[usize],
    axes: Axes,
) -> Result<Vec<Measurement>> {
    let bar = progress(false, "measured", frames.len());
    let mut out = Vec::new();
    for &frame in frames {
        let decoded = reader.read(frame as u64)?;
        let mut joint = decoded.static_layer;
        joint.extend(&decoded.dynamic_layer);
        let sky = Panorama::decode(&decoded.sky, axes.up, axes.forward)?;
        let shown = Shown { gaussians: &joint, sky: Some(&sky) };
        out.push(measure((&*run.capture, &run.exposures(frame)?), &run.scene(frame)?, &shown, frame)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(out)
}
