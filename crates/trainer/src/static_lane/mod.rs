//! The static lane: the SH colours of the static layer follow the light; geometry and opacity stay.

mod compare;
mod solve;
mod steps;
mod trace;

pub use solve::ColourVariance;

use crate::backend::TrainBackend;
use crate::background::{BackgroundConfig, StaticMethod};
use crate::view::Progress;
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use std::sync::Arc;
use trace::{Tracer, ViewTrace};

/// The photographs that the static lane compares its renders with, and the background of these renders.
#[derive(Clone, Copy, Debug)]
pub struct StaticTargets<'a> {
    /// Photographs and masks.
    pub views: &'a [TrainingView],
    /// Seen behind the layer.
    pub sky: &'a SkyCube,
}

/// The layer whose colours the static lane changes.
#[derive(Debug)]
pub struct StaticColours<'a> {
    /// The layer.
    pub layer: &'a mut Arc<Gaussians>,
    /// (N) variances of its colours; empty = nothing is known.
    pub variances: &'a mut Vec<ColourVariance>,
    /// Becomes the ascending indices of those whose new colours are for this frame alone.
    pub passing: &'a mut Vec<u32>,
}

/// Contributors kept per pixel where memory allows; more gain nothing (docs/adr/0007).
const MOST_CONTRIBUTORS: usize = 16;
/// With fewer the model is too coarse to be solved.
const FEWEST_CONTRIBUTORS: usize = 4;
/// Where not all pixels fit, those of a lattice are traced, this many pixels apart at most.
const LARGEST_STRIDE: usize = 8;

/// What is traced of each view.
#[derive(Clone, Copy, Debug)]
struct Tracing {
    /// Contributors per pixel.
    contributors: usize,
    /// Pixels between those of the lattice; 1 = all.
    stride: usize,
    /// Degree of the colours.
    degree: usize,
}

impl BackgroundConfig {
    /// What is traced of a layer, when all views have so many pixels; `None` where the memory allows too little to be solved.
    fn tracing(&self, pixels: usize, gaussians: usize) -> Option<Tracing> {
        let contributors = |stride: usize| {
            let bytes = pixels.div_ceil(stride * stride).max(1) * size_of::<trace::Contribution>();
            ((self.solve_memory_mib << 20) / bytes).min(MOST_CONTRIBUTORS)
        };
        let enough = |&stride: &usize| contributors(stride) >= FEWEST_CONTRIBUTORS;
        let told = self.solve_pixels.saturating_mul(gaussians);
        let tells = |stride: &usize| *stride == 1 || (told > 0 && pixels / (stride * stride) >= told);
        let sparsest = (1..=LARGEST_STRIDE).rev().find(tells).unwrap_or(1);
        let stride = (sparsest..=LARGEST_STRIDE).find(enough)?;
        Some(Tracing { contributors: contributors(stride), stride, degree: self.solve_degree })
    }

    /// Most bytes that the contributors of so many pixels take, however many Gaussians there are; 0 where `steps` are taken.
    pub fn contributor_bytes(&self, pixels: usize) -> usize {
        let tracing = self.tracing(pixels, usize::MAX).filter(|_| self.static_method == StaticMethod::Solve);
        let traced = |t: Tracing| t.contributors * pixels.div_ceil(t.stride * t.stride);
        tracing.map_or(0, traced) * size_of::<trace::Contribution>()
    }
}

/// The static lane of a run. It keeps the contributors of each pixel: a fixed camera is traced once.
#[derive(Clone, Debug, Default)]
pub struct StaticLane {
    traces: Vec<ViewTrace>,
}

impl StaticLane {
    /// Finetunes the colours. Geometry and opacities must be those of the last call, unless [`forget`](Self::forget) was called since. The steps
    /// run on `backend`, the linear solve always on the CPU.
    ///
    /// # Errors
    /// When the device fails or has too little memory; `layer` is then as it was.
    pub fn train<B: TrainBackend>(
        &mut self,
        backend: &B,
        config: &BackgroundConfig,
        targets: StaticTargets,
        colours: StaticColours,
        seed: u64,
        report: &mut dyn FnMut(Progress),
    ) -> Result<(), B::Error> {
        let StaticTargets { views, sky } = targets;
        let StaticColours { layer, variances, passing } = colours;
        passing.clear();
        if layer.is_empty() || views.is_empty() {
            return Ok(());
        }
        let pixels = views.iter().map(|v| v.camera.size().pixels()).sum();
        let tracing = config.tracing(pixels, layer.len());
        if let Some(tracing) = tracing.filter(|_| config.static_method == StaticMethod::Solve) {
            self.trace(tracing, views, layer);
            // A pixel of the lattice speaks for those that are left out.
            let solve_noise = config.solve_noise / tracing.stride as f32;
            let config = BackgroundConfig { solve_noise, ..*config };
            *passing =
                solve::solve(&config, &self.traces, views, sky, Arc::make_mut(layer), variances, report);
            return Ok(());
        }
        steps::train(backend, config, targets, layer, seed, report)
    }

    /// To be called when positions, shapes or opacities of the layer changed: all views are traced again, as in a run that is
    /// resumed here.
    pub fn forget(&mut self) {
        self.traces.clear();
    }

    /// Traces the views whose camera is new.
    fn trace(&mut self, tracing: Tracing, views: &[TrainingView], layer: &Gaussians) {
        self.traces.truncate(views.len());
        let mut tracer = Tracer::default();
        for (v, view) in views.iter().enumerate() {
            if self.traces.get(v).is_some_and(|t| t.camera == view.camera) {
                continue;
            }
            let trace = ViewTrace::new(&view.camera, layer, tracing, &mut tracer);
            if v < self.traces.len() { self.traces[v] = trace } else { self.traces.push(trace) }
        }
    }
}
