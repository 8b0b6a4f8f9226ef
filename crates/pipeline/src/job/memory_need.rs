//! What a run will need of the machine's memory, told before it starts.
//!
//! The sums are those of docs/bench/README.md and depend on settings and capture alone: whatever the budget, a run that begins
//! gives equal bytes.

use crate::job::frame::{init_views, training_views};
use crate::job::memory;
use crate::job::request::RunRequest;
use crate::outputs::folder::RunFolder;
use crate::settings::config::Config;
use anyhow::{Context, Result, ensure};
use ffgs_method::{Capture, Part, ViewAt};
use ffgs_trainer::FirstFrameConfig;
use std::path::Path;

/// Bytes of a pixel's photograph and mask.
const PIXEL: usize = 4;
/// What reduced copies of photographs add, as a share of these: a quarter, a sixteenth and so on.
const REDUCED: f64 = 1.0 / 3.0;
/// Bytes of a trained Gaussian: parameters, gradients, two moments.
const GAUSSIAN: usize = 944;
/// Bytes of a static Gaussian in the five vectors of the static solve.
const SOLVED: usize = 960;
/// Bytes of a pixel in the static solve, besides its contributors.
const SOLVED_PIXEL: usize = 5;
/// Bytes of a Gaussian in a state file, and of an initial point in its file, about.
const SAVED: [u64; 2] = [240, 28];
/// Bytes of a Gaussian on a GPU: as it is trained, twice while density control makes new ones of the old; and a splat with its
/// first (tile, splat) pairs, as `ffgs_rasterizer_gpu::Scratch` has them.
const GAUSSIAN_ON_GPU: usize = 2 * GAUSSIAN + 120 + 4 * 4 + 8 * 64;
/// Bytes of a pixel of the largest view on a GPU: image, derivatives, sums of the loss, layers behind and before.
const PIXEL_ON_GPU: usize = 36 + 96 + 32;
/// What the parts of a view's tiles take on a GPU (MiB).
const PARTS_ON_GPU: f64 = 16.0;
/// What the sums leave out, as a factor: 1.08 was measured at two fifths of the paper's size, and more on small captures.
const REST: f64 = 1.25;
/// The program itself (MiB).
const PROGRAM: f64 = 50.0;

/// What there is memory for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Room {
    /// For the run, with the photographs of the next frame.
    ForReadingAhead,
    /// For the run without them.
    ForTheRun,
}

/// Memory by what it is for (MiB).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Need {
    photographs: f64,
    /// Photographs of the frame to come, which a run can do without.
    ahead: f64,
    solve: f64,
    gaussians: f64,
    /// On a GPU, with photographs that cross to it one by one.
    gpu: f64,
}

/// What the need depends on.
#[derive(Clone, Copy, Debug)]
struct Size {
    /// Pixels of the training views, and of the views that only frame 0 has.
    pixels: [usize; 2],
    /// Pixels of the largest of the training views.
    largest: usize,
    gaussians: usize,
    /// Whether the first frame is trained.
    begins: bool,
    /// Whether lanes train frames after the first.
    streams: bool,
}

impl Need {
    fn new(config: &Config, size: Size) -> Self {
        let mib = |bytes: usize| bytes as f64 / f64::from(1 << 20);
        let [training, initial] = size.pixels;
        let background = &config.background;
        let contributors = if size.streams { background.contributor_bytes(training) } else { 0 };
        // Steps take none.
        let solve = if contributors > 0 {
            contributors + SOLVED_PIXEL * training + SOLVED * size.gaussians
        } else {
            0
        };
        // The frame and the one before it.
        let two_frames = mib(PIXEL * 2 * training);
        let first_frame = copies(&config.first_frame) * mib(PIXEL * (training + initial));
        Self {
            photographs: if size.begins { two_frames.max(first_frame) } else { two_frames },
            ahead: mib(PIXEL * training),
            solve: mib(solve),
            gaussians: mib(GAUSSIAN * size.gaussians),
            gpu: mib(GAUSSIAN_ON_GPU * size.gaussians + PIXEL_ON_GPU * size.largest) + PARTS_ON_GPU,
        }
    }

    fn total(&self) -> f64 {
        REST * (self.photographs + self.solve + self.gaussians) + PROGRAM
    }

    /// What a budget (MiB) is enough for.
    fn room(&self, budget: f64) -> Option<Room> {
        let fits = |mib: f64| mib <= budget;
        if fits(self.total() + REST * self.ahead) {
            Some(Room::ForReadingAhead)
        } else {
            fits(self.total()).then_some(Room::ForTheRun)
        }
    }

    /// Refuses a GPU that may take less than it needs (MiB).
    fn require_on_gpu(&self, budget: f64) -> Result<()> {
        let gib = |mib: f64| mib / 1024.0;
        ensure!(
            self.gpu <= budget,
            "the run needs about {:.2} GiB of the GPU's memory and may take {:.2} GiB. Use fewer Gaussians (first_frame.max_gaussians) \
             or smaller images, --device cpu, or say with --memory how much it may take (MiB)",
            gib(self.gpu),
            gib(budget)
        );
        Ok(())
    }

    /// What does not fit, and what to change.
    fn told(&self, budget: f64) -> String {
        let gib = |mib: f64| mib / 1024.0;
        format!(
            "the run needs about {:.1} GiB of memory and may take {:.1} GiB: {:.1} GiB for the photographs and masks, \
             {:.1} GiB for Gaussians in training, {:.1} GiB for the static solve. Use fewer views (--train-views) or \
             smaller images, lower background.solve_memory_mib, or set background.static_method to \"steps\"; or say with --memory how much it may take (MiB)",
            gib(self.total()),
            gib(budget),
            gib(REST * self.photographs),
            gib(REST * self.gaussians),
            gib(REST * self.solve)
        )
    }
}

/// How often the photographs of a first frame are held while it is trained, at most: reduced, where splats may be coarse, and with their
/// exposures removed, where these may differ.
fn copies(config: &FirstFrameConfig) -> f64 {
    let reduced = if config.coarse_splat_px > 0.0 { REDUCED } else { 0.0 };
    let equal = if config.exposures { 1.0 } else { 0.0 };
    1.0 + reduced + equal
}

/// Refuses a run that needs more than it may take: `--memory`, else what the machine has free. Where the system does not tell,
/// nothing is refused. What a GPU has free is not known before it is taken: `--memory` alone limits it. Results are the same with and without reading ahead.
///
/// # Errors
/// When it would not fit: what needs how much, and what to change. When a camera cannot be read.
pub(crate) fn require(
    request: &RunRequest,
    capture: &dyn Capture,
    views: &[usize],
    (streams, on_gpu): (bool, bool),
) -> Result<Room> {
    let Some(budget) = request.memory.map(|mib| mib as f64).or_else(memory::free_mib) else {
        return Ok(Room::ForReadingAhead);
    };
    let pixels = |views: &[ViewAt]| -> Result<Vec<usize>> {
        views.iter().map(|&at| Ok(capture.camera(at)?.size().pixels())).collect()
    };
    let start = request.frames.map_or(0, |frames| frames.start);
    let [training, initial] = [pixels(&training_views(views, start))?, pixels(&init_views(capture, start))?];
    let largest = training.iter().chain(&initial).copied().max().unwrap_or(0);
    let pixels = [training.iter().sum(), initial.iter().sum()];
    let gaussians = if let Some(run) = &request.first_frame {
        contained(&RunFolder(run.clone()).state(start), SAVED[0])
    } else {
        let first = &request.config.first_frame;
        let points = contained(&capture.part(Part::Points), SAVED[1]);
        // All that start are Gaussians, also those beyond the limit of growth.
        let started = if first.max_points == 0 { points } else { points.min(first.max_points) };
        started.max(first.for_photographs(views.len(), pixels.iter().sum()).max_gaussians)
    };
    let begins = request.first_frame.is_none();
    let need = Need::new(&request.config, Size { pixels, largest, gaussians, begins, streams });
    if let (Some(mib), true) = (request.memory, on_gpu) {
        need.require_on_gpu(mib as f64)?;
    }
    let room = need.room(budget).with_context(|| need.told(budget))?;
    tracing::debug!("about {:.0} MiB of memory, {budget:.0} MiB may be taken", need.total());
    if room == Room::ForTheRun {
        tracing::info!("memory is short: no photographs are read while the frame before them is trained");
    }
    Ok(room)
}

/// How many items of so many bytes a file has.
fn contained(file: &Path, bytes: u64) -> usize {
    std::fs::metadata(file).map_or(0, |info| (info.len() / bytes) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_trainer::StaticMethod;

    const PAPER: Size = Size {
        pixels: [60 * 1920 * 1080, 0],
        largest: 1920 * 1080,
        gaussians: 1_200_000,
        begins: false,
        streams: true,
    };

    #[test]
    fn a_first_frame_holds_copies_of_its_photographs() {
        let photographs = |first_frame: FirstFrameConfig, pixels, begins| {
            let config = Config { first_frame, ..Config::default() };
            Need::new(&config, Size { pixels, begins, ..PAPER }).photographs
        };
        let (copied, plain) = (
            FirstFrameConfig::default(),
            FirstFrameConfig { coarse_splat_px: 0.0, exposures: false, ..FirstFrameConfig::default() },
        );
        let pixels = [1 << 20, 1 << 20];
        assert_eq!(photographs(plain, pixels, true), 8.0, "training views and the others");
        assert!((photographs(copied, pixels, true) - 8.0 * 7.0 / 3.0).abs() < 1e-9);
        assert_eq!(photographs(copied, pixels, false), 8.0, "two frames of the training views");
        assert_eq!(photographs(plain, [1 << 20, 0], true), 8.0, "two frames need more than the first");
    }

    #[test]
    fn the_papers_size_needs_what_it_was_computed_to_need() {
        let need = Need::new(&Config::default(), PAPER).total() / 1024.0;
        assert!((7.0..10.0).contains(&need), "{need} GiB");
    }

    #[test]
    fn a_gpu_needs_more_with_more_gaussians_or_larger_views_and_says_so() {
        let need = |size| Need::new(&Config::default(), size);
        let papers = need(PAPER);
        assert!((2.5..4.0).contains(&(papers.gpu / 1024.0)), "{} MiB", papers.gpu);
        assert!(need(Size { gaussians: 600_000, ..PAPER }).gpu < papers.gpu);
        assert!(need(Size { largest: 320 * 180, ..PAPER }).gpu < papers.gpu);
        let more_views = Size { pixels: [120 * 1920 * 1080, 0], ..PAPER };
        assert_eq!(need(more_views).gpu, papers.gpu, "photographs can cross one by one");
        assert!(papers.require_on_gpu(papers.gpu + 1.0).is_ok());
        let told = papers.require_on_gpu(2048.0).unwrap_err().to_string();
        assert!(told.contains("may take 2.00 GiB") && told.contains("--memory"), "{told}");
    }

    #[test]
    fn reading_ahead_is_given_up_before_the_run_is() {
        let need = Need::new(&Config::default(), PAPER);
        let enough = need.total() + REST * need.ahead;
        assert!(need.ahead > 400.0, "photographs and masks of 60 views");
        assert_eq!(need.room(enough), Some(Room::ForReadingAhead));
        assert_eq!(need.room(enough - 1.0), Some(Room::ForTheRun));
        assert_eq!(need.room(need.total() - 1.0), None);
    }

    #[test]
    fn what_is_told_to_change_makes_it_smaller() {
        let config = Config::default();
        let need = |config: &Config, size| Need::new(config, size).total();
        let all = need(&config, PAPER);
        let mut less = config;
        less.background.solve_memory_mib = 1000;
        assert!(need(&less, PAPER) < all, "fewer pixels are solved for");
        less = config;
        less.background.static_method = StaticMethod::Steps;
        assert!(need(&less, PAPER) < all);
        assert!(need(&config, Size { pixels: [20 * 1920 * 1080, 0], ..PAPER }) < all);
        assert!(need(&config, Size { streams: false, ..PAPER }) < all);
        let told = Need::new(&config, PAPER).told(2048.0);
        assert!(told.contains("may take 2.0 GiB") && told.contains("background.solve_memory_mib"), "{told}");
    }
}
