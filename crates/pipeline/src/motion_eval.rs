//! `ffgs motion-eval`: the motion initialisation, frame by frame, against a capture's ground truth.

use crate::cli::{FrameRange, Init, LogArgs};
use crate::config::Config;
use crate::frame::{TrainViews, load_training};
use crate::motion::{Dynamic, MotionInput, MotionOutcome, move_by, observe, positions};
use crate::motion_ablation::ABLATIONS;
use crate::record::{RunFolder, publish, write_json};
use crate::render::{FinishedRun, progress};
use crate::state;
use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use ffgs_core::{DenseMotion, EstimateStatus, Estimates, Gaussians};
use ffgs_dataset::Capture;
use ffgs_motion_eval::{
    BINS_CM, FlowSummary, Kind, NOMINAL, Row, Sample, Summary, TrueFlow, Truth, flow_error, summarise, table,
};
use ffgs_report::{MotionAccuracy, StageSeconds};
use ffgs_tracks::TrackStore;
use ffgs_trainer::{TrainingView, from_points};
use glam::{DAffine3, DMat3, DVec3};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// `ffgs motion-eval`.
#[derive(Clone, Debug, Args)]
#[command(
    long_about = "Runs the motion initialisation of every frame from known places and compares each Gaussian with the \
        true rigid motion of the part that it sits on: end-point errors, share measured, normalised errors and \
        coverage, for every tracker alone and fused. Needs a capture with truth/. Without --run the Gaussians are the \
        capture's initial points; with it, the figures become plots in the run's report.",
    after_help = "Examples:\n  ffgs motion-eval fixtures/scenes/fairmont-mini\n  \
        ffgs motion-eval fixtures/scenes/fairmont-mini --run out/mini --json motion.json\n  \
        ffgs motion-eval --simulate"
)]
pub struct MotionEvalArgs {
    /// Folder of the capture, with truth/
    #[arg(required_unless_present = "simulate")]
    pub capture: Option<PathBuf>,
    /// Score simulated scenes instead of a capture
    #[arg(long, conflicts_with_all = ["capture", "run", "frames", "json"])]
    pub simulate: bool,
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
    /// Writes all figures
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// One line each for the configuration, Algorithm 1 to the letter, and every single change
    #[arg(long, conflicts_with_all = ["json", "per_frame"])]
    pub ablations: bool,
    /// One table a frame, not only that over all frames
    #[arg(long)]
    pub per_frame: bool,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Where the Gaussians are at the start of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Places {
    /// Those of frame 0 moved by the truth
    #[default]
    True,
    /// Those of the run's own frame before
    Run,
}

/// All figures.
#[derive(Debug, Serialize)]
struct Report {
    frames: Vec<FrameScore>,
    all_frames: BTreeMap<String, BTreeMap<String, Entry>>,
    flow: BTreeMap<String, FlowSummary>,
}

/// Figures of one frame: estimate, then part.
#[derive(Debug, Serialize)]
struct FrameScore {
    frame: usize,
    seconds: StageSeconds,
    scores: BTreeMap<String, BTreeMap<String, Entry>>,
}

#[derive(Debug, Serialize)]
struct Entry {
    candidates: usize,
    summary: Summary,
    /// Gaussians by status, for a tracker alone.
    status: BTreeMap<String, usize>,
}

/// Samples of one estimate on one part.
#[derive(Clone, Debug, Default)]
struct Cell {
    candidates: usize,
    samples: Vec<Sample>,
    status: BTreeMap<String, usize>,
}

type Cells = BTreeMap<String, BTreeMap<String, Cell>>;

/// Scores and prints.
pub fn motion_eval(args: &MotionEvalArgs) -> Result<()> {
    if args.ablations {
        return ablations(args);
    }
    if args.simulate {
        print!("{}", table(&crate::motion_simulated::rows(&configuration(args)?)?));
        return Ok(());
    }
    let eval = Evaluation::open(args)?;
    let (mut all, mut frames, mut flow) = (Cells::new(), Vec::new(), BTreeMap::new());
    let mut steps = Vec::new();
    let bar = progress(args.log.quiet, "frames", eval.frames.len());
    for frame in eval.frames.clone() {
        let (cells, seconds) = eval.frame(frame, &mut steps, &mut flow)?;
        bar.inc(1);
        if args.per_frame {
            println!("frame {frame}\n{}", text(&cells));
        }
        frames.push(FrameScore { frame, seconds, scores: entries(&cells) });
        merge(&mut all, cells);
    }
    bar.finish_and_clear();
    println!("all frames\n{}", text(&all));
    let flow: BTreeMap<String, FlowSummary> =
        flow.into_iter().map(|(name, mut errors)| (name, FlowSummary::of(&mut errors))).collect();
    for (name, s) in &flow {
        println!(
            "{name:<34} {:>9} px: median {:.2} px, 90 % {:.2} px, {:.0} % under 1 px",
            s.pixels,
            s.median_px,
            s.p90_px,
            100.0 * s.below_1px
        );
    }
    println!("{}", stages(&frames));
    if let Some(file) = &args.json {
        write_json(file, &Report { frames, all_frames: entries(&all), flow })?;
    }
    if let Some(run) = &args.run {
        add_to_report(run, eval.capture.root(), &all)?;
    }
    Ok(())
}

/// Leaves the figures of the bodies beside the run and writes its report again, if it is a run on this capture.
fn add_to_report(run: &Path, capture: &Path, all: &Cells) -> Result<()> {
    let same =
        |run: &FinishedRun| Some(run.capture.root().canonicalize().ok()? == capture.canonicalize().ok()?);
    let Some(run) = FinishedRun::open(run).ok().filter(|run| same(run) == Some(true)) else {
        tracing::warn!("{} is not a run on this capture: its report stays as it is", run.display());
        return Ok(());
    };
    let accuracy: Vec<MotionAccuracy> =
        all.iter().filter_map(|(name, parts)| Some(accuracy(name, parts.get("bodies")?))).collect();
    write_json(&run.folder.motion_accuracy(), &accuracy)?;
    publish(&run.folder, &run.manifest, &run.capture, run.records()?)?;
    println!("plots: {}", run.folder.0.join("report.html").display());
    Ok(())
}

fn accuracy(name: &str, cell: &Cell) -> MotionAccuracy {
    let summary = summarise(&cell.samples);
    let share = |count: usize| count as f64 / summary.count.max(1) as f64;
    MotionAccuracy {
        name: name.into(),
        median_cm: summary.median_cm,
        p95_cm: summary.p95_cm,
        measured: summary.count as f64 / cell.candidates.max(1) as f64,
        bins_cm: BINS_CM.into(),
        shares: summary.histogram.iter().map(|&count| share(count)).collect(),
        calibration: NOMINAL.iter().zip(&summary.coverage).map(|(n, &inside)| (n.0, inside)).collect(),
    }
}

/// The fused estimate of the bodies, or of all simulated scenes, under each change.
fn ablations(args: &MotionEvalArgs) -> Result<()> {
    let mut rows = Vec::new();
    let mut eval = if args.simulate { None } else { Some(Evaluation::open(args)?) };
    let bar = progress(args.log.quiet, "changes", ABLATIONS.len());
    for (name, change) in ABLATIONS {
        let mut config = configuration(args)?;
        change(&mut config);
        let cell = match &mut eval {
            None => {
                let samples = crate::motion_simulated::all_samples(&config)?;
                Cell { candidates: samples.len(), samples, ..Cell::default() }
            }
            Some(eval) => {
                eval.config = config;
                eval.bodies()?
            }
        };
        let summary = summarise(&cell.samples);
        rows.push(Row { name: name.into(), candidates: cell.candidates, summary });
        bar.inc(1);
    }
    bar.finish_and_clear();
    print!("{}", table(&rows));
    Ok(())
}

fn configuration(args: &MotionEvalArgs) -> Result<Config> {
    args.config.as_deref().map_or_else(|| Ok(Config::default()), Config::read)
}

struct Evaluation {
    config: Config,
    capture: Capture,
    tracks: TrackStore,
    views: TrainViews,
    truth: Truth,
    frames: std::ops::Range<usize>,
    places: Places,
    run: Option<RunFolder>,
    /// Frame 0: the moving Gaussians, the rest.
    start: (Gaussians, Gaussians),
}

impl Evaluation {
    fn open(args: &MotionEvalArgs) -> Result<Self> {
        let config = configuration(args)?;
        let root = args.capture.as_deref().context("a capture is needed")?;
        let capture = Capture::open(root)?;
        let tracks = TrackStore::open(root)?.context("the capture has no tracks/tracks.json")?;
        let views = TrainViews::select(&capture, None)?;
        let truth = Truth::read(root)?;
        let count = capture.frames().min(truth.frames());
        let frames = args.frames.map_or(1..count, |f| f.start.max(1)..f.end.unwrap_or(count));
        ensure!(!frames.is_empty() && frames.end <= count, "the capture has truth for frames 0..{count}");
        let run = args.run.clone().map(RunFolder);
        if args.places == Places::Run && run.is_none() {
            bail!("--places run needs --run DIR");
        }
        let start = match &run {
            Some(run) => {
                let layers = state::load(&run.state(0)).context("--run: no state of frame 0")?;
                (layers.dynamic.gaussians, layers.static_layer)
            }
            None => initial_points(&capture)?,
        };
        Ok(Self { config, capture, tracks, views, truth, frames, places: args.places, run, start })
    }

    /// The fused estimate of the bodies over all frames.
    fn bodies(&self) -> Result<Cell> {
        let (mut all, mut steps) = (Cells::new(), Vec::new());
        for frame in self.frames.clone() {
            merge(&mut all, self.frame(frame, &mut steps, &mut BTreeMap::new())?.0);
        }
        Ok(all.remove("fused").and_then(|mut parts| parts.remove("bodies")).unwrap_or_default())
    }

    /// The layers at the start of a frame.
    fn layers(&self, frame: usize) -> Result<(Gaussians, Gaussians)> {
        if let (Places::Run, Some(run)) = (self.places, &self.run) {
            let layers = state::load(&run.state(frame - 1))?;
            return Ok((layers.dynamic.gaussians, layers.static_layer));
        }
        let (mut moving, fixed) = self.start.clone();
        let parts = self.truth.parts_at(0, &positions(&moving))?;
        for (i, part) in parts.iter().enumerate() {
            if let Some(motion) = part.and_then(|p| self.truth.motion(p, 0, frame - 1)) {
                carry(&mut moving, i, &motion);
            }
        }
        Ok((moving, fixed))
    }

    /// `steps` are those of the frame before (m), then of this one; empty before the first.
    fn frame(
        &self,
        frame: usize,
        steps: &mut Vec<DVec3>,
        flow: &mut BTreeMap<String, Vec<f64>>,
    ) -> Result<(Cells, StageSeconds)> {
        let (moving, fixed) = self.layers(frame)?;
        let before = load_training(&self.capture, &self.views, frame - 1)?;
        let now = load_training(&self.capture, &self.views, frame)?;
        let input = MotionInput {
            config: &self.config,
            init: &Init::Fused,
            tracks: Some(&self.tracks),
            views: &self.views,
            before: &before,
            now: &now,
            frame,
            static_layer: &fixed,
            gpu: None,
        };
        let mut outcome = MotionOutcome { previous: positions(&moving), ..MotionOutcome::default() };
        let mut faults = Vec::new();
        let mut inspect = |v: usize, fields: &[DenseMotion]| {
            if let Err(error) = self.score_flow(frame, v, &before[v], fields, flow) {
                faults.push(error);
            }
        };
        let mut observations = observe(&input, &moving, &mut outcome, &mut inspect)?;
        faults.into_iter().next().map_or(Ok(()), Err)?;
        // The places are exact: the posterior is that of this frame's motion alone.
        let covariances = vec![DMat3::ZERO; moving.len()];
        let steps_before = std::mem::take(steps);
        let mut dynamic =
            Dynamic { gaussians: moving, covariances, steps: steps_before, ..Dynamic::default() };
        let estimates = move_by(&input, &mut observations, &mut dynamic, &mut outcome)?;
        steps.clone_from(&dynamic.steps);
        let parts = self.truth.parts_at(frame - 1, &outcome.previous)?;
        let scorer = Scorer { truth: &self.truth, frame, previous: &outcome.previous, parts: &parts };
        let mut cells = Cells::new();
        for (l, estimate) in estimates.iter().enumerate() {
            cells.insert(format!("{} {}", l + 1, self.tracks.trackers()[l].name), scorer.tracker(estimate));
        }
        cells.insert("fused".into(), scorer.fused(&dynamic));
        Ok((cells, outcome.seconds))
    }

    fn score_flow(
        &self,
        frame: usize,
        view: usize,
        before: &TrainingView,
        fields: &[DenseMotion],
        out: &mut BTreeMap<String, Vec<f64>>,
    ) -> Result<()> {
        let camera = &self.views.selected[view].1;
        let file = self.capture.root().join(format!("truth/flow/{camera}/{:06}.npz", frame - 1));
        if let Some(truth) = TrueFlow::read(&file, before.camera.size())? {
            for (tracker, field) in self.tracks.trackers().iter().zip(fields) {
                flow_error(field, &truth, &before.mask, out.entry(tracker.name.clone()).or_default());
            }
        }
        Ok(())
    }
}

/// The capture's initial foreground points as opaque Gaussians, and nothing around them: gross errors among the
/// background points would hide what moves.
fn initial_points(capture: &Capture) -> Result<(Gaussians, Gaussians)> {
    /// The points lie on the surfaces, so that nothing shines through them.
    const OPACITY: f32 = 0.9;
    let points = capture.initial_points()?;
    let all = from_points(&points.positions, &points.colours, 0, OPACITY);
    let moving: Vec<usize> = (0..all.len()).filter(|&i| points.foreground[i]).collect();
    Ok((all.select(&moving), all.select(&[])))
}

/// Moves Gaussian `i` rigidly.
fn carry(gaussians: &mut Gaussians, i: usize, motion: &DAffine3) {
    let place = DVec3::from_array(gaussians.means[i].map(f64::from));
    gaussians.means[i] = motion.transform_point3(place).as_vec3().to_array();
    let rotation = glam::DQuat::from_mat3(&motion.matrix3);
    gaussians.quats[i] = crate::turn::turned(rotation, gaussians.quats[i]);
}

struct Scorer<'a> {
    truth: &'a Truth,
    frame: usize,
    previous: &'a [DVec3],
    parts: &'a [Option<u32>],
}

impl Scorer<'_> {
    fn tracker(&self, estimates: &Estimates) -> BTreeMap<String, Cell> {
        self.cells(|i| {
            let ok = estimates.status[i] == EstimateStatus::Ok;
            let state = ok.then(|| (estimates.means[i], estimates.covariances[i]));
            (state, Some(format!("{:?}", estimates.status[i])))
        })
    }

    fn fused(&self, dynamic: &Dynamic) -> BTreeMap<String, Cell> {
        let means = positions(&dynamic.gaussians);
        self.cells(|i| (Some((means[i], dynamic.covariances[i])), None))
    }

    /// Samples by part; what sits on no part is counted without samples.
    fn cells(
        &self,
        state: impl Fn(usize) -> (Option<(DVec3, DMat3)>, Option<String>),
    ) -> BTreeMap<String, Cell> {
        let mut cells = BTreeMap::<String, Cell>::new();
        for (i, part) in self.parts.iter().enumerate() {
            let motion = part.and_then(|p| self.truth.motion(p, self.frame - 1, self.frame));
            let (estimate, status) = state(i);
            let sample = estimate.zip(motion).map(|((mean, covariance), motion)| Sample {
                error: mean - motion.transform_point3(self.previous[i]),
                covariance,
            });
            for name in self.names(*part) {
                let cell = cells.entry(name).or_default();
                cell.candidates += 1;
                cell.samples.extend(sample);
                if let Some(status) = &status {
                    *cell.status.entry(status.clone()).or_default() += 1;
                }
            }
        }
        cells
    }

    /// Groups a part counts in.
    fn names(&self, part: Option<u32>) -> Vec<String> {
        let Some(part) = part else { return vec!["on no part".into()] };
        let kind = match self.truth.kind(part) {
            Kind::Body => "bodies",
            Kind::Wheel => "wheels",
            Kind::Other => "other parts",
        };
        vec![kind.into(), format!("{} ({part})", self.truth.name(part))]
    }
}

fn entries(cells: &Cells) -> BTreeMap<String, BTreeMap<String, Entry>> {
    let entry = |cell: &Cell| Entry {
        candidates: cell.candidates,
        summary: summarise(&cell.samples),
        status: cell.status.clone(),
    };
    cells
        .iter()
        .map(|(name, parts)| (name.clone(), parts.iter().map(|(p, c)| (p.clone(), entry(c))).collect()))
        .collect()
}

fn merge(all: &mut Cells, frame: Cells) {
    for (name, parts) in frame {
        for (part, cell) in parts {
            let sum = all.entry(name.clone()).or_default().entry(part).or_default();
            sum.candidates += cell.candidates;
            sum.samples.extend(cell.samples);
            for (status, count) in cell.status {
                *sum.status.entry(status).or_default() += count;
            }
        }
    }
}

/// The groups of parts, and the fused estimate's single parts.
fn text(cells: &Cells) -> String {
    let mut rows = Vec::new();
    for (name, parts) in cells {
        let shown =
            |part: &str, cell: &Cell| (name == "fused" || !part.contains('(')) && !cell.samples.is_empty();
        for (part, cell) in parts.iter().filter(|(part, cell)| shown(part, cell)) {
            let summary = summarise(&cell.samples);
            rows.push(Row { name: format!("{name}: {part}"), candidates: cell.candidates, summary });
        }
    }
    table(&rows)
}

/// Mean seconds a frame of each stage.
fn stages(frames: &[FrameScore]) -> String {
    let mean = |of: fn(&StageSeconds) -> Option<f64>| {
        frames.iter().filter_map(|f| of(&f.seconds)).sum::<f64>() / frames.len().max(1) as f64
    };
    format!(
        "seconds a frame: load {:.3}, densify {:.3}, agreement {:.3}, association {:.3}, triangulation {:.3}, fusion {:.3}",
        mean(|s| s.load),
        mean(|s| s.voronoi),
        mean(|s| s.agreement),
        mean(|s| s.association),
        mean(|s| s.triangulation),
        mean(|s| s.fusion)
    )
}
