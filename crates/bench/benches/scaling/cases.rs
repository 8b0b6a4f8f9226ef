//! The cases, and how each is measured.

use crate::scene::{camera, discs, pool};
use crate::{held, memory};
use ffgs_core::{Gaussians, ImageRgb8, ImageSize, Mask, SkyCube, StageLog, TrainingView};
use ffgs_rasterizer::TileMask;
use ffgs_trainer::{
    BackgroundConfig, CpuBackend, DynamicLaneConfig, FirstFrame, FirstFrameConfig, FirstFrameTask,
    StaticColours, StaticLane, StaticTargets, Surroundings, TILE_DILATION, train_dynamic, train_first_frame,
};
use std::fmt;
use std::sync::Arc;
use std::time::Instant;

/// Standard deviation over spacing, as trained scenes have it.
const SPREAD: f32 = 0.45;
/// Steps that are timed.
const STEPS: usize = 24;
const THREADS: usize = 2;
const SKY_FACE: usize = 64;

/// What is trained.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Lane {
    FirstFrame,
    /// With this share of the image as foreground (percent).
    Dynamic(usize),
    Static,
}

/// One row of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Case {
    lane: Lane,
    gaussians: usize,
    size: ImageSize,
    views: usize,
}

/// The table: one quantity varies at a time.
pub(crate) fn all() -> Vec<Case> {
    let size = |width, height| ImageSize { width, height };
    let (small, medium, large, full) = (size(320, 180), size(640, 360), size(1280, 720), size(1920, 1080));
    let case = |lane, gaussians, size, views| Case { lane, gaussians, size, views };
    let mut cases: Vec<Case> =
        [20_000, 200_000, 1_000_000, 2_000_000].map(|n| case(Lane::FirstFrame, n, large, 4)).into();
    cases.extend([small, medium, full].map(|s| case(Lane::FirstFrame, 200_000, s, 4)));
    cases.extend([16, 64].map(|v| case(Lane::FirstFrame, 200_000, medium, v)));
    cases.extend([1, 5, 20, 50].map(|p| case(Lane::Dynamic(p), 100_000, medium, 4)));
    cases.extend([16, 64].map(|v| case(Lane::Dynamic(5), 100_000, medium, v)));
    cases.extend([20_000, 200_000].map(|n| case(Lane::Dynamic(5), n, medium, 4)));
    cases.extend([(20_000, 4), (200_000, 4), (200_000, 16)].map(|(n, v)| case(Lane::Static, n, small, v)));
    cases.push(case(Lane::Static, 200_000, medium, 4));
    cases
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let ImageSize { width, height } = self.size;
        let (lane, share) = match self.lane {
            Lane::FirstFrame => ("first_frame", 100),
            Lane::Dynamic(percent) => ("dynamic", percent),
            Lane::Static => ("static", 100),
        };
        write!(f, "{lane},{},{width},{height},{},{share}%", self.gaussians, self.views)
    }
}

/// Times of a lane's steps.
struct Clock {
    start: Instant,
    steps: Vec<f64>,
    last: Instant,
}

impl Clock {
    fn start() -> Self {
        let now = Instant::now();
        Self { start: now, steps: Vec::new(), last: now }
    }

    fn tick(&mut self) {
        let now = Instant::now();
        self.steps.push((now - self.last).as_secs_f64());
        self.last = now;
    }

    /// Seconds before the first step, and the median of the steps after it.
    fn summary(mut self) -> (f64, f64) {
        let total = (self.last - self.start).as_secs_f64();
        let mut later = self.steps.split_off(1);
        later.sort_by(f64::total_cmp);
        let median = later.get(later.len() / 2).copied().unwrap_or(f64::NAN);
        (total - median * (later.len() + 1) as f64, median)
    }
}

impl Case {
    /// The row of this case.
    pub(crate) fn measure(&self) -> String {
        let views = self.training_views();
        let gaussians = discs(self.gaussians, 3, SPREAD);
        let (clock, peak, held) = pool(THREADS).install(|| match self.lane {
            Lane::FirstFrame => self.first_frame(&views, gaussians),
            Lane::Dynamic(_) => self.dynamic(&views, gaussians),
            Lane::Static => self.static_solve(&views, gaussians),
        });
        let (setup, step) = clock.summary();
        let mib = |bytes: f64| bytes / f64::from(1 << 20);
        let ratio = peak / held;
        let (step, peak, held) = (step * 1e3, mib(peak), mib(held));
        format!("{self},{THREADS},{setup:.3},{step:.2},{peak:.1},{held:.1},{ratio:.2}")
    }

    fn mask(&self) -> Mask {
        match self.lane {
            Lane::Dynamic(percent) => disc(self.size, percent as f64 / 100.0),
            _ => Mask::filled(self.size, false),
        }
    }

    fn training_views(&self) -> Vec<TrainingView> {
        let bytes: Vec<u8> = (0..self.size.pixels() * 3).map(|i| (i * 7919 % 251) as u8).collect();
        let image = ImageRgb8::new(self.size, bytes).expect("three bytes per pixel");
        let side = |v: usize| 0.02 * (v as f64 - 0.5 * self.views as f64);
        let view =
            |v| TrainingView { camera: camera(self.size, side(v)), image: image.clone(), mask: self.mask() };
        (0..self.views).map(view).collect()
    }

    fn first_frame(&self, views: &[TrainingView], gaussians: Gaussians) -> (Clock, f64, f64) {
        let config = FirstFrameConfig { iterations: STEPS, densify_every: 0, ..FirstFrameConfig::default() };
        let sky = SkyCube::filled(SKY_FACE, [0.5; 3]);
        memory::restart_peak();
        let mut clock = Clock::start();
        let log = &mut StageLog::default();
        let start = FirstFrame { gaussians, sky };
        let task = FirstFrameTask { views, start, extent: 1e-6, seed: 1 };
        let Ok(trained) =
            train_first_frame(&CpuBackend, &config, task, &mut |_| None, log, &mut |_| clock.tick());
        let peak = memory::peak();
        (clock, peak, held::first_frame(&trained.gaussians, self.size, views.len()) as f64)
    }

    fn dynamic(&self, views: &[TrainingView], all: Gaussians) -> (Clock, f64, f64) {
        let middle = camera(self.size, 0.0);
        let mask = self.mask();
        let inside = |i: &usize| {
            let mean = glam::Vec3::from(all.means[*i]).as_dvec3();
            middle.pixel_of(mean).is_some_and(|(x, y)| mask.contains(x, y))
        };
        let (moving, still): (Vec<usize>, Vec<usize>) = (0..all.len()).partition(inside);
        let (mut moving, still) = (all.select(&moving), Arc::new(all.select(&still)));
        let config = DynamicLaneConfig { iterations: STEPS, ..DynamicLaneConfig::default() };
        drop(all);
        let sky = SkyCube::filled(SKY_FACE, [0.5; 3]);
        let around = Surroundings { static_layer: &still, sky: &sky, prior: None };
        memory::restart_peak();
        let mut clock = Clock::start();
        let Ok(_) = train_dynamic(&CpuBackend, &config, views, around, &mut moving, 1, &mut |_| clock.tick());
        let peak = memory::peak();
        let tiles = TileMask::covering(&mask.dilated(TILE_DILATION));
        (clock, peak, held::dynamic(&moving, &still, self.size, &tiles, views.len()) as f64)
    }

    fn static_solve(&self, views: &[TrainingView], layer: Gaussians) -> (Clock, f64, f64) {
        let config = BackgroundConfig::default();
        let sky = SkyCube::filled(SKY_FACE, [0.5; 3]);
        memory::restart_peak();
        let mut clock = Clock::start();
        let (mut layer, seen) = (Arc::new(layer), StaticTargets { views, sky: &sky });
        let lane = &mut StaticLane::default();
        let Ok(()) = lane.train(
            &CpuBackend,
            &config,
            seen,
            StaticColours { layer: &mut layer, variances: &mut Vec::new(), passing: &mut Vec::new() },
            1,
            &mut |_| clock.tick(),
        );
        let peak = memory::peak();
        (clock, peak, held::static_solve(&layer, self.size, views.len()) as f64)
    }
}

/// A disc with the given share of the image, in its middle.
fn disc(size: ImageSize, share: f64) -> Mask {
    let (w, h) = (size.width as f64, size.height as f64);
    let radius = (share / std::f64::consts::PI).sqrt();
    let inside = |i: usize| {
        let (x, y) = ((i % size.width) as f64 / w - 0.5, (i / size.width) as f64 / h - 0.5);
        u8::from(x.hypot(y) < radius)
    };
    Mask::new(size, (0..size.pixels()).map(inside).collect()).expect("one byte per pixel")
}
