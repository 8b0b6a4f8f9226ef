//! `ffgs-lab compare`: methods on captures, each with its own schedule and at several budgets, as tables and curves.

mod departures;
mod page;
mod plan;
mod results;
mod table;

use anyhow::{Context, Result};
use clap::Args;
use ffgs_core::write_atomically;
use ffgs_pipeline::cli::args::{EvalArgs, LogArgs};
use ffgs_pipeline::cli::terminal;
use ffgs_pipeline::commands::eval;
use ffgs_pipeline::job::device::Device;
use ffgs_pipeline::job::manifest::Manifest;
use ffgs_pipeline::job::request::{FrameRange, RunRequest};
use ffgs_pipeline::job::run;
use ffgs_pipeline::outputs::folder::RunFolder;
use ffgs_pipeline::outputs::json::read_json;
use ffgs_pipeline::outputs::record::Metrics;
use ffgs_pipeline::plugins::registry::open_capture;
use ffgs_pipeline::settings::config::Config;
use plan::{Candidate, candidates, folder_name, scaled};
use results::{Compared, Outcome};
use std::io::Write;
use std::path::{Path, PathBuf};

const HELP: &str = "\
What is compared:
  --methods all               the paper's method as it is here (trackers) and as printed (literal), no motion (none),
                              and every method of others
  --methods initialisations   trackers, none, and each tracker of the capture alone
  --methods departures        trackers, literal, the same word for word, and trackers with each setting that departs from
                              the paper as printed, one by one (without:KEY)
  --methods trackers,queen    these
  --methods all,dynamic3dgs@0.1   a method at a budget of its own, for one whose schedule takes too long

All start from one first frame per capture. Budget 1 is each method's own schedule; --budgets 0.3,1 runs it with 0.3 of its steps
as well, which gives the curves of quality against seconds. The tables and curves are OUT/compare.md and OUT/compare.html,
written again after every run; the runs lie in OUT/CAPTURE/METHOD@BUDGET, each with its report. Finished runs are kept, and
interrupted ones go on, so a comparison grows by calling it again with more captures, methods, budgets or frames.

--gaussians 20000 thins the first frame, and adds -20000 to the names of the captures.

VMAF needs an ffmpeg that has libvmaf: `cargo xtask setup`, or FFGS_FFMPEG.

Examples:
  cargo xtask compare
  cargo xtask compare fixtures/scenes/fairmont-mini --methods all --frames 0..4
  cargo xtask compare captures/rain captures/night --methods trackers,hicom,queen --budgets 0.1,0.3,1";

/// `ffgs-lab compare`.
#[derive(Clone, Debug, Args)]
#[command(after_help = HELP)]
pub(crate) struct CompareArgs {
    /// Folders of captures
    #[arg(default_value = "fixtures/scenes/fairmont-mini")]
    captures: Vec<PathBuf>,
    /// all, initialisations, or names of methods
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',', default_value = "initialisations")]
    methods: Vec<String>,
    /// Shares of each method's own number of steps
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_values_t = [1.0])]
    budgets: Vec<f64>,
    /// Frames [default: all]
    #[arg(long, value_name = "0..B")]
    frames: Option<FrameRange>,
    /// The first frame starts from at most N points and grows to at most N Gaussians: the paper's experiment with fewer
    /// primitives in the background
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    gaussians: Option<u32>,
    /// Where the runs and tables are written; finished runs are kept
    #[arg(long, value_name = "DIR", default_value = "out/compare")]
    out: PathBuf,
    /// Where to compute; auto = a hardware GPU where there is one, else the CPU
    #[arg(long, value_name = "auto|cpu|gpu[:N,N]", default_value = "auto")]
    device: Device,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Runs what is missing, prints the tables and writes them with the curves. A method that fails is a row that says why.
///
/// # Errors
/// When a method or budget is none, or the tables cannot be written.
pub(crate) fn run(args: &CompareArgs) -> Result<()> {
    let mut all: Vec<Compared> = Vec::new();
    plan::check(&args.methods, &args.budgets, args.frames)?;
    for (at, capture) in args.captures.iter().enumerate() {
        all.push(Compared::new(args.name(at)));
        let plan = candidates(capture, &args.methods);
        let budgets =
            |candidate: &Candidate| candidate.budget.map_or_else(|| args.budgets.clone(), |b| vec![b]);
        let runs: Vec<_> = plan.iter().flat_map(|c| budgets(c).into_iter().map(move |b| (c, b))).collect();
        for (done, &(candidate, budget)) in runs.iter().enumerate() {
            let compared = all.last_mut().context("a capture was added")?;
            let name = format!("{}: {} at budget {budget}", compared.capture, candidate.name);
            terminal::note(format_args!("{name} ({} of {})", done + 1, runs.len()));
            let outcome = args.outcome(capture, compared, candidate, budget);
            if let Some(reason) = &outcome.stopped {
                terminal::note(format_args!("{name}: {reason}"));
            }
            compared.outcomes.push(outcome);
            args.write(&all)?;
        }
    }
    terminal::print(table::markdown(&results::tables(&all)).trim_end());
    say_what_is_missing(&all);
    terminal::note(format_args!("tables and curves: {}", args.out.join("compare.html").display()));
    Ok(())
}

/// Once more after the tables, as a long log hides it.
fn say_what_is_missing(all: &[Compared]) {
    if !eval::has_vmaf() {
        terminal::note(
            "VMAF is left out: no ffmpeg with libvmaf; `cargo xtask setup` installs one, FFGS_FFMPEG names one",
        );
    }
    for compared in all {
        for outcome in &compared.outcomes {
            if let Some(reason) = &outcome.stopped {
                terminal::note(format_args!("{}: {}: {reason}", compared.capture, outcome.title()));
            }
        }
    }
}

impl CompareArgs {
    /// Of a capture's runs: the name of their folder and of its tables.
    fn name(&self, at: usize) -> String {
        let name = folder_name(&self.captures, at);
        self.gaussians.map_or_else(|| name.clone(), |limit| format!("{name}-{limit}"))
    }

    fn outcome(
        &self,
        capture: &Path,
        compared: &mut Compared,
        candidate: &Candidate,
        budget: f64,
    ) -> Outcome {
        let folder = self.out.join(&compared.capture);
        let first = folder.join("first");
        let failed = |reason: String| Outcome::new(candidate, budget, Metrics::default(), Some(reason));
        if compared.first.is_none() {
            let only = FrameRange { start: 0, end: Some(1) };
            let mut request = RunRequest { frames: Some(only), ..self.request(capture, &first) };
            if let Some(limit) = self.gaussians {
                let first = &mut request.config.first_frame;
                (first.max_points, first.max_gaussians) = (limit as usize, limit as usize);
            }
            match finished(&request).map_or_else(|| started(&request), Ok) {
                Ok(metrics) => compared.first = Some(metrics),
                Err(error) => return failed(format!("no first frame: {error:#}")),
            }
        }
        let out = folder.join(candidate.folder(budget));
        let mut request = RunRequest { first_frame: Some(first), ..self.request(capture, &out) };
        (request.method, request.config) = (Some(candidate.method.clone()), scaled(candidate.config, budget));
        let result = finished(&request).map_or_else(|| started(&request), Ok);
        let (metrics, stopped) = match result.and_then(|metrics| self.measured(&out, metrics)) {
            Ok(metrics) => (metrics, None),
            // The last good frames are kept and count.
            Err(error) => {
                let kept = read_json(&out.join("metrics.json")).unwrap_or_default();
                (kept, Some(format!("{error:#}")))
            }
        };
        let end = self.frames.and_then(|frames| frames.end).unwrap_or(usize::MAX);
        let frames = metrics.frames.into_iter().filter(|frame| frame.frame < end).collect();
        Outcome::new(candidate, budget, Metrics::of(frames), stopped)
    }

    /// With the scores of the videos, which a run does not find.
    fn measured(&self, out: &Path, metrics: Metrics) -> Result<Metrics> {
        let mean = &metrics.mean;
        // Runs of older versions have no MSSIM where they have an MPSNR.
        let whole = mean.flicker.is_some() && mean.mssim.is_some() == mean.mpsnr.is_some();
        let found = whole && (mean.vmaf.is_some() || !eval::has_vmaf());
        if found || mean.psnr.is_none() {
            return Ok(metrics);
        }
        let (run, device) = (out.to_owned(), self.device.clone());
        eval::measure(&EvalArgs { run, no_vmaf: false, device, log: self.log }).map(|found| found.0)
    }

    fn write(&self, all: &[Compared]) -> Result<()> {
        let tables = results::tables(all);
        for (name, text) in
            [("compare.md", table::markdown(&tables)), ("compare.html", page::html(&tables, all))]
        {
            let file = self.out.join(name);
            write_atomically(&file, |out| out.write_all(text.as_bytes()))
                .with_context(|| format!("cannot write {}", file.display()))?;
        }
        Ok(())
    }

    /// A run with the default settings into `out`.
    fn request(&self, capture: &Path, out: &Path) -> RunRequest {
        RunRequest {
            capture: capture.to_owned(),
            out: out.to_owned(),
            resume: true,
            method: None,
            frames: self.frames,
            train_views: None,
            first_frame: None,
            refine_first: None,
            keep: None,
            memory: None,
            device: self.device.clone(),
            quiet: self.log.quiet,
            config: Config::default(),
        }
    }
}

fn started(request: &RunRequest) -> Result<Metrics> {
    run::run(request)?;
    read_json(&request.out.join("metrics.json"))
}

/// The numbers of a run that has all frames asked for, made by whichever version of the program.
fn finished(request: &RunRequest) -> Option<Metrics> {
    let all = || open_capture(&request.capture).ok().map(|capture| capture.frames());
    let end = request.frames.and_then(|frames| frames.end).or_else(all)?;
    let manifest: Manifest = read_json(&RunFolder(request.out.clone()).manifest()).ok()?;
    let same = manifest.config == request.config
        && request.method.as_ref().is_none_or(|method| *method == manifest.method);
    let metrics: Metrics = read_json(&request.out.join("metrics.json")).ok()?;
    let whole = (0..end).all(|frame| metrics.frames.iter().any(|record| record.frame == frame));
    (same && whole).then_some(metrics)
}
