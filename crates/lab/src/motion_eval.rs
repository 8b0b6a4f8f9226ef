//! `ffgs-lab motion-eval`: the motion initialisation, frame by frame, against a capture's ground truth.

use crate::cells::{Cell, Cells, merge};
use crate::evaluation::{Evaluation, FlowErrors, Memory, SourceArgs};
use anyhow::Result;
use clap::Args;
use ffgs_core::Seconds;
use ffgs_motion_eval::{BINS_CM, FlowSummary, NOMINAL, Row, Summary, summarise, table};
use ffgs_pipeline::cli::terminal::{self, progress};
use ffgs_pipeline::job::lock::FolderLock;
use ffgs_pipeline::outputs::finished_run::FinishedRun;
use ffgs_pipeline::outputs::json::write_json;
use ffgs_pipeline::outputs::publish::publish;
use ffgs_pipeline::outputs::record::Metrics;
use ffgs_report::MotionAccuracy;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// `ffgs-lab motion-eval`.
#[derive(Clone, Debug, Default, Args)]
#[command(
    about = "Score the motion initialisation against a capture's ground truth",
    long_about = "Runs the motion initialisation of every frame from known places and compares each Gaussian with the \
        true rigid motion of the part that it sits on: end-point errors, share measured, normalised errors and \
        coverage, for every tracker alone and fused. Needs a capture with truth/. Without --run the Gaussians are the \
        capture's initial points; with it, the figures become plots in the run's report.",
    after_help = "Examples:\n  ffgs-lab motion-eval fixtures/scenes/fairmont-mini\n  \
        ffgs-lab motion-eval fixtures/scenes/fairmont-mini --run out/mini --json motion.json"
)]
pub struct MotionEvalArgs {
    /// Folder of the capture, with truth/
    pub capture: PathBuf,
    /// What is moved.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Writes all figures
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// One table per frame, not only that over all frames
    #[arg(long)]
    pub per_frame: bool,
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
    seconds: Seconds,
    scores: BTreeMap<String, BTreeMap<String, Entry>>,
}

#[derive(Debug, Serialize)]
struct Entry {
    candidates: usize,
    summary: Summary,
    /// Gaussians by status, for a tracker alone.
    status: BTreeMap<String, usize>,
}

/// Scores and prints.
///
/// # Errors
/// When the capture, its truth or the run cannot be read, or the table cannot be written.
pub fn run(args: &MotionEvalArgs) -> Result<()> {
    let eval = Evaluation::open(&args.capture, &args.source)?;
    let (mut all, mut frames, mut flow) = (Cells::new(), Vec::new(), FlowErrors::new());
    let mut memory = Memory::default();
    let bar = progress(args.source.log.quiet, "frames", eval.frames.len());
    for frame in eval.frames.clone() {
        let (cells, seconds) = eval.frame(frame, &mut memory, &mut flow)?;
        bar.inc(1);
        if args.per_frame {
            terminal::print(format_args!("frame {frame}\n{}", text(&cells)));
        }
        frames.push(FrameScore { frame, seconds, scores: entries(&cells) });
        merge(&mut all, cells);
    }
    bar.finish_and_clear();
    terminal::print(format_args!("all frames\n{}", text(&all)));
    let flow: BTreeMap<String, FlowSummary> =
        flow.into_iter().map(|(name, mut errors)| (name, FlowSummary::of(&mut errors))).collect();
    for (name, s) in &flow {
        terminal::print(format_args!(
            "{name:<34} {:>9} px: median {:.2} px, 90 % {:.2} px, {:.0} % under 1 px",
            s.pixels,
            s.median_px,
            s.p90_px,
            100.0 * s.below_1px
        ));
    }
    terminal::print(stages(&frames));
    if let Some(file) = &args.json {
        write_json(file, &Report { frames, all_frames: entries(&all), flow })?;
    }
    if let Some(run) = &args.source.run {
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
    let _lock = FolderLock::take(&run.folder.0)?;
    write_json(&run.folder.motion_accuracy(), &accuracy)?;
    publish(&run.folder, &run.manifest, &Metrics::of(run.records()?))?;
    terminal::print(format_args!("plots: {}", run.folder.0.join("report.html").display()));
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

/// Mean seconds per frame of each stage.
fn stages(frames: &[FrameScore]) -> String {
    let names: BTreeSet<&String> = frames.iter().flat_map(|f| f.seconds.keys()).collect();
    let mean = |name: &str| {
        frames.iter().filter_map(|f| f.seconds.get(name)).sum::<f64>() / frames.len().max(1) as f64
    };
    let stages: Vec<String> = names.iter().map(|name| format!("{name} {:.3}", mean(name))).collect();
    format!("seconds per frame: {}", stages.join(", "))
}
