//! Progress on the terminal.

use crate::cli::terminal;
use crate::outputs::record::{FrameRecord, Metrics, ViewMetrics, mean};
use ffgs_core::stage;
use ffgs_reconstruction::{Monitor, Report};
use ffgs_trainer::Progress;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The bars of a run: one for the frames, one per training while it runs. Where the error stream is no terminal, lines.
pub(crate) struct Console {
    bars: MultiProgress,
    frames: ProgressBar,
    lines: Option<Arc<Lines>>,
}

/// The bar of one training; it disappears with the training.
struct TrainingBar {
    name: &'static str,
    bar: ProgressBar,
    lines: Option<Arc<Lines>>,
}

/// Lines of progress for a log file, not oftener than [`PACE`] between frames.
struct Lines(Mutex<Instant>);

/// Time between two lines of progress.
const PACE: Duration = Duration::from_secs(10);

impl Lines {
    fn show(&self, line: impl FnOnce() -> String) {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if last.elapsed() >= PACE {
            *last = Instant::now();
            terminal::note(line());
        }
    }
}

fn style(template: &str) -> ProgressStyle {
    // The templates are constants of this file; a broken one shows the default bar.
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

impl Console {
    /// Bars on the error stream, lines when it is no terminal, nothing when `quiet`.
    pub(crate) fn new(quiet: bool, frames: Range<usize>) -> Self {
        let as_lines = !quiet && !std::io::stderr().is_terminal();
        let lines = as_lines.then(|| Arc::new(Lines(Mutex::new(Instant::now()))));
        let target = if quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let bars = MultiProgress::with_draw_target(target);
        let bar = bars.add(ProgressBar::new(frames.len() as u64));
        bar.set_style(style("frames {bar:30} {pos}/{len}  {msg}  {elapsed} passed"));
        Self { bars, frames: bar, lines }
    }

    /// A frame begins.
    pub(crate) fn begin_frame(&self, frame: usize) {
        self.frames.set_message(format!("frame {frame}"));
        self.frames.tick();
    }

    /// A frame is written.
    pub(crate) fn end_frame(&self, record: &FrameRecord) {
        self.estimate_time();
        self.say(&format!(
            "frame {}: {}{}{} + {} Gaussians, {:.1} s",
            record.frame,
            quality("", &record.views),
            quality("training views ", &record.training_views),
            record.static_gaussians,
            record.dynamic_gaussians,
            record.log.seconds.get(stage::WALL).copied().unwrap_or(0.0)
        ));
        for warning in &record.log.warnings {
            tracing::warn!("frame {}: {warning}", record.frame);
        }
    }

    /// A line of the log file, or a message of `-v` beside the bars.
    fn say(&self, line: &str) {
        if self.lines.is_some() {
            terminal::note(line);
        } else {
            tracing::info!("{line}");
        }
    }

    /// The first frame takes far longer than the others and must not enter their estimate.
    fn estimate_time(&self) {
        self.frames.inc(1);
        if self.frames.position() == 1 {
            self.frames.reset_eta();
        } else {
            self.frames.set_style(style("frames {bar:30} {pos}/{len}  {msg}  {elapsed} passed, {eta} left"));
        }
    }

    /// The run is done.
    pub(crate) fn finish(&self, metrics: &Metrics) {
        self.frames.finish_and_clear();
        let m = &metrics.mean;
        let (views, psnr, mpsnr, ssim) = match &metrics.mean_training_views {
            Some(t) => ("the views that were trained on", t.psnr, t.mpsnr, t.ssim),
            None => ("test views", m.psnr, m.mpsnr, m.ssim),
        };
        if psnr.is_none() {
            return;
        }
        let show = |v: Option<f64>| v.map_or_else(|| "-".into(), |v| format!("{v:.2}"));
        self.say(&format!(
            "mean over {views}, frames after the first: PSNR {} dB, MPSNR {} dB, SSIM {}, {} s per frame",
            show(psnr),
            show(mpsnr),
            show(ssim),
            show(m.seconds_per_frame)
        ));
    }
}

/// PSNR and MPSNR of views for the line of a frame; nothing for no views.
fn quality(kind: &str, views: &[ViewMetrics]) -> String {
    let told = |name: &str, value: Option<f64>| {
        value.map_or_else(String::new, |value| format!("{name} {value:.2} dB, "))
    };
    let psnr = mean(views.iter().map(|v| v.psnr));
    told(&format!("{kind}PSNR"), psnr) + &told("MPSNR", mean(views.iter().filter_map(|v| v.mpsnr)))
}

impl Monitor for Console {
    fn begin(&self, name: &'static str, iterations: usize) -> Report<'_> {
        let bar = self.bars.add(ProgressBar::new(iterations as u64));
        bar.set_style(style("  {prefix:12} {bar:24} {pos}/{len}  {msg}  {eta} left"));
        bar.set_prefix(name);
        let training = TrainingBar { name, bar, lines: self.lines.clone() };
        Box::new(move |progress| training.show(progress))
    }
}

impl TrainingBar {
    /// Shows a step; the terminal is touched every 10 steps only, oftener in short trainings.
    fn show(&self, p: Progress) {
        let what = || format!("loss {:.4}  PSNR {:.2} dB  {} Gaussians", p.loss, p.psnr, p.gaussians);
        if let Some(lines) = &self.lines {
            lines.show(|| format!("{} {}/{}  {}", self.name, p.iteration, p.iterations, what()));
        } else if p.iteration.is_multiple_of((p.iterations / 50).clamp(1, 10)) || p.iteration == p.iterations
        {
            self.bar.set_position(p.iteration as u64);
            self.bar.set_message(what());
        }
    }
}

impl Drop for TrainingBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
