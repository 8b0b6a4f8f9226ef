//! A capture with ground truth: each frame's motion initialisation from known places, scored.

use crate::cells::{Cell, Cells, Scorer, merge};
use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use ffgs_core::{DenseMotion, Dynamic, Gaussians, Seconds, StageLog, TrainingView};
use ffgs_method::{Capture, Split, Step, TrackSource};
use ffgs_motion::{MotionInput, move_by, observe, turned};
use ffgs_motion_eval::{TrueFlow, Truth, flow_error};
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::job::frame::select_views;
use ffgs_pipeline::job::request::FrameRange;
use ffgs_pipeline::outputs::exposure_files::{load_training, read_exposures};
use ffgs_pipeline::outputs::folder::RunFolder;
use ffgs_pipeline::outputs::state;
use ffgs_pipeline::plugins::registry::open_capture;
use ffgs_pipeline::settings::config::Config;
use ffgs_trainer::from_points;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where the Gaussians are at the start of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Places {
    /// Those of frame 0 moved by the truth
    #[default]
    True,
    /// Those of the run's own frame before
    Run,
}

/// What is moved, and how.
#[derive(Clone, Debug, Default, Args)]
pub struct SourceArgs {
    /// A finished run whose Gaussians are moved
    #[arg(long, value_name = "DIR")]
    pub run: Option<PathBuf>,
    /// Where the Gaussians are at the start of each frame
    #[arg(long, value_enum, default_value_t)]
    pub places: Places,
    /// Frames A to B, B left out; a frame is scored against the one before it
    #[arg(long, value_name = "A..B")]
    pub frames: Option<FrameRange>,
    /// Settings, as for `ffgs run`
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Errors of the pixels' flow (px), by tracker.
pub type FlowErrors = BTreeMap<String, Vec<f64>>;

/// A capture with ground truth, and the Gaussians whose motion is scored.
pub struct Evaluation {
    /// Settings of the motion initialisation.
    pub config: Config,
    /// The capture.
    pub capture: Box<dyn Capture>,
    tracks: Vec<Box<dyn TrackSource>>,
    views: Vec<usize>,
    truth: Truth,
    /// Frames that are scored.
    pub frames: Range<usize>,
    places: Places,
    run: Option<RunFolder>,
    /// Frame 0: the moving Gaussians, the rest.
    start: (Gaussians, Arc<Gaussians>),
}

/// What a frame's initialisation hands to the next one; empty before the first.
#[derive(Default)]
pub struct Memory {
    /// Steps (m).
    steps: Vec<DVec3>,
    /// Evidence that Gaussians depart from their rigid groups.
    flexibility: Vec<f64>,
}

impl Evaluation {
    /// Opens the capture in `root`.
    ///
    /// # Errors
    /// When the capture or the configuration cannot be read.
    pub fn open(root: &Path, args: &SourceArgs) -> Result<Self> {
        let config = configuration(args.config.as_deref())?;
        let capture = open_capture(root)?;
        let tracks = ffgs_tracks::sources(&*capture)?;
        ensure!(!tracks.is_empty(), "the capture has no tracks/tracks.json");
        let views = select_views(&*capture, None)?;
        let truth = Truth::read(root)?.relative_to(capture.origin());
        let count = capture.frames().min(truth.frames());
        let frames = args.frames.map_or(1..count, |f| f.start.max(1)..f.end.unwrap_or(count));
        ensure!(!frames.is_empty() && frames.end <= count, "the capture has truth for frames 0..{count}");
        let run = args.run.clone().map(RunFolder);
        if args.places == Places::Run && run.is_none() {
            bail!("--places run needs --run DIR");
        }
        let start = match &run {
            Some(run) => {
                let scene = state::load(&run.state(0), 0).context("--run: no state of frame 0")?;
                (scene.dynamic.gaussians, scene.static_layer)
            }
            None => initial_points(&*capture)?,
        };
        Ok(Self { config, capture, tracks, views, truth, frames, places: args.places, run, start })
    }

    /// The fused estimate of the bodies over all frames.
    ///
    /// # Errors
    /// When the truth cannot be read.
    pub(crate) fn bodies(&self) -> Result<Cell> {
        let (mut all, mut memory) = (Cells::new(), Memory::default());
        for frame in self.frames.clone() {
            merge(&mut all, self.frame(frame, &mut memory, &mut FlowErrors::new())?.0);
        }
        Ok(all.remove("fused").and_then(|mut parts| parts.remove("bodies")).unwrap_or_default())
    }

    /// The layers at the start of a frame.
    fn layers(&self, frame: usize) -> Result<(Gaussians, Arc<Gaussians>)> {
        if let (Places::Run, Some(run)) = (self.places, &self.run) {
            let scene = state::load(&run.state(frame - 1), frame - 1)?;
            return Ok((scene.dynamic.gaussians, scene.static_layer));
        }
        let (mut moving, fixed) = self.start.clone();
        let parts = self.truth.parts_at(0, &moving.positions())?;
        for (i, part) in parts.iter().enumerate() {
            if let Some(motion) = part.and_then(|p| self.truth.motion(p, 0, frame - 1)) {
                carry(&mut moving, i, &motion);
            }
        }
        Ok((moving, fixed))
    }

    /// The training views of a frame, in the exposures that the run found.
    fn photographs(&self, frame: usize) -> Result<Vec<TrainingView>> {
        let exposures = self.run.as_ref().map(|run| read_exposures(run, frame)).transpose()?;
        load_training(&*self.capture, &exposures.unwrap_or_default(), &self.views, frame)
    }

    /// Moves the Gaussians into `frame`. `memory` is that of the frame before, then of this one.
    ///
    /// # Errors
    /// When a file of the frame cannot be read, or the method fails.
    pub fn frame(
        &self,
        frame: usize,
        memory: &mut Memory,
        flow: &mut FlowErrors,
    ) -> Result<(Cells, Seconds)> {
        let (moving, fixed) = self.layers(frame)?;
        let [before, now] = [self.photographs(frame - 1)?, self.photographs(frame)?];
        let previous = moving.positions();
        let reduction = self.config.resolution.dynamic(&moving, &now);
        let reduced = [&before, &now].map(|views| TrainingView::all_reduced(views, reduction));
        let step = Step {
            frame,
            seed: self.config.seed,
            capture: &*self.capture,
            views: &self.views,
            before: &before,
            now: &now,
            reduced: [&reduced[0], &reduced[1]],
            tracks: &self.tracks,
        };
        let input = MotionInput {
            config: &self.config.motion(),
            step,
            trackers: self.tracks.iter().map(AsRef::as_ref).collect(),
            static_layer: &fixed,
            previous: &previous,
            gpu: None,
        };
        let mut log = StageLog::default();
        let mut faults = Vec::new();
        let mut inspect = |v: usize, fields: &[DenseMotion]| {
            if let Err(error) = self.score_flow(frame, v, &before[v], fields, flow) {
                faults.push(error);
            }
        };
        let mut observations = observe(&input, &moving, &mut log, &mut inspect)?;
        faults.into_iter().next().map_or(Ok(()), Err)?;
        // The places are exact: the posterior is that of this frame's motion alone.
        let covariances = vec![DMat3::ZERO; moving.len()];
        let Memory { steps, flexibility } = std::mem::take(memory);
        let mut dynamic =
            Dynamic { gaussians: moving, covariances, steps, flexibility, ..Dynamic::default() };
        let estimates = move_by(&input, &mut observations, &mut dynamic, &mut log)?;
        *memory = Memory { steps: dynamic.steps.clone(), flexibility: dynamic.flexibility.clone() };
        let parts = self.truth.parts_at(frame - 1, &previous)?;
        let scorer = Scorer { truth: &self.truth, frame, previous: &previous, parts: &parts };
        let mut cells = Cells::new();
        for (l, estimate) in estimates.iter().enumerate() {
            cells.insert(format!("{} {}", l + 1, self.tracks[l].name()), scorer.tracker(estimate));
        }
        cells.insert("fused".into(), scorer.fused(&dynamic));
        Ok((cells, log.seconds))
    }

    fn score_flow(
        &self,
        frame: usize,
        view: usize,
        before: &TrainingView,
        fields: &[DenseMotion],
        out: &mut FlowErrors,
    ) -> Result<()> {
        let camera = &self.capture.views(Split::Train)[self.views[view]];
        let file = self.capture.root().join(format!("truth/flow/{camera}/{:06}.npz", frame - 1));
        if let Some(truth) = TrueFlow::read(&file, before.camera.size())? {
            for (tracker, field) in self.tracks.iter().zip(fields) {
                flow_error(field, &truth, &before.mask, out.entry(tracker.name().to_owned()).or_default());
            }
        }
        Ok(())
    }
}

/// The capture's initial foreground points as opaque Gaussians, and nothing around them: gross errors among the
/// background points would hide what moves.
fn initial_points(capture: &dyn Capture) -> Result<(Gaussians, Arc<Gaussians>)> {
    /// The points lie on the surfaces, so that nothing shines through them.
    const OPACITY: f32 = 0.9;
    let points = capture.points()?.context("the capture has no initial points")?;
    let all = from_points(&points.positions, &points.colours, 0, OPACITY);
    let moving: Vec<usize> = (0..all.len()).filter(|&i| points.foreground[i]).collect();
    Ok((all.select(&moving), Arc::new(all.select(&[]))))
}

/// Moves Gaussian `i` rigidly.
fn carry(gaussians: &mut Gaussians, i: usize, motion: &DAffine3) {
    let place = DVec3::from_array(gaussians.means[i].map(f64::from));
    gaussians.means[i] = motion.transform_point3(place).as_vec3().to_array();
    let rotation = glam::DQuat::from_mat3(&motion.matrix3);
    gaussians.quats[i] = turned(rotation, gaussians.quats[i]);
}

/// The configuration in `file`, or the defaults.
///
/// # Errors
/// When the file cannot be read or a value is out of its range.
pub fn configuration(file: Option<&Path>) -> Result<Config> {
    file.map_or_else(|| Ok(Config::default()), Config::read)
}
