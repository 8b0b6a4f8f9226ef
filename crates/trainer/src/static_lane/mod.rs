//! The static lane: the SH colours of the static layer follow the light; geometry and opacity stay.

mod solve;
mod steps;
mod trace;

pub use solve::ColourVariance;

use crate::backend::TrainBackend;
use crate::background::{BackgroundConfig, StaticMethod};
use crate::view::Progress;
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use std::sync::Arc;
use trace::ViewTrace;

/// The photographs that the static lane compares its renders with, and the background of these renders.
#[derive(Clone, Copy, Debug)]
pub struct StaticTargets<'a> {
    /// Photographs and masks.
    pub views: &'a [TrainingView],
    /// Seen behind the layer.
    pub sky: &'a SkyCube,
}

/// Contributors kept per pixel where memory allows; more gain nothing (docs/adr/0007).
const MOST_CONTRIBUTORS: usize = 16;
/// With fewer the model is too coarse to be solved.
const FEWEST_CONTRIBUTORS: usize = 4;

impl BackgroundConfig {
    /// Contributors per pixel that the memory allows, when all views have so many pixels; 0 = too few to be solved.
    fn contributors(&self, pixels: usize) -> usize {
        let bytes = pixels.max(1) * size_of::<trace::Contribution>();
        let fit = (self.solve_memory_mib << 20).checked_div(bytes).unwrap_or(0).min(MOST_CONTRIBUTORS);
        if fit < FEWEST_CONTRIBUTORS { 0 } else { fit }
    }

    /// Most bytes that the contributors of so many pixels take; 0 where `steps` are taken.
    pub fn contributor_bytes(&self, pixels: usize) -> usize {
        let solves = self.static_method == StaticMethod::Solve;
        if solves { self.contributors(pixels) * pixels * size_of::<trace::Contribution>() } else { 0 }
    }
}

/// The static lane of a run. It keeps the contributors of each pixel: a fixed camera is traced once.
#[derive(Clone, Debug, Default)]
pub struct StaticLane {
    traces: Vec<ViewTrace>,
}

impl StaticLane {
    /// Finetunes the colours of `layer`. `known` are the variances of these colours before the frame; empty = nothing is known.
    /// Geometry and opacities must be those of the last call, unless [`forget`](Self::forget) was called since. The steps
    /// run on `backend`, the linear solve always on the CPU.
    ///
    /// # Errors
    /// When the device fails or has too little memory; `layer` is then as it was.
    pub fn train<B: TrainBackend>(
        &mut self,
        backend: &B,
        config: &BackgroundConfig,
        targets: StaticTargets,
        (layer, known): (&mut Arc<Gaussians>, &mut Vec<ColourVariance>),
        seed: u64,
        report: &mut dyn FnMut(Progress),
    ) -> Result<(), B::Error> {
        let StaticTargets { views, sky } = targets;
        if layer.is_empty() || views.is_empty() {
            return Ok(());
        }
        let contributors = config.contributors(views.iter().map(|v| v.camera.size().pixels()).sum());
        if config.static_method == StaticMethod::Solve && contributors > 0 {
            self.trace(contributors, config.solve_degree, views, layer);
            solve::solve(config, &self.traces, views, sky, Arc::make_mut(layer), known, report);
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
    fn trace(&mut self, count: usize, degree: usize, views: &[TrainingView], layer: &Gaussians) {
        self.traces.truncate(views.len());
        for (v, view) in views.iter().enumerate() {
            if self.traces.get(v).is_some_and(|t| t.camera == view.camera) {
                continue;
            }
            let trace = ViewTrace::new(&view.camera, layer, count, degree);
            if v < self.traces.len() { self.traces[v] = trace } else { self.traces.push(trace) }
        }
    }
}
