//! The static lane: the SH colours of the static layer follow the light; geometry and opacity stay.

mod solve;
mod steps;
mod trace;

use crate::background::{BackgroundConfig, StaticMethod};
use crate::view::{Progress, TrainingView};
use crate::SkyCube;
use ffgs_core::Gaussians;
use trace::ViewTrace;

/// The static lane of a run. It keeps what it learns of the views: a fixed camera is traced once.
#[derive(Clone, Debug, Default)]
pub struct StaticLane {
    traces: Vec<ViewTrace>,
}

impl StaticLane {
    /// Finetunes the colours of `layer`, whose geometry and opacities are those of the first call.
    pub fn train(
        &mut self,
        config: &BackgroundConfig,
        views: &[TrainingView],
        sky: &SkyCube,
        layer: &mut Gaussians,
        seed: u64,
        report: &mut dyn FnMut(Progress),
    ) {
        if layer.is_empty() || views.is_empty() {
            return;
        }
        match config.static_method {
            StaticMethod::Steps => steps::train(config, views, sky, layer, seed, report),
            StaticMethod::Solve => {
                self.trace(config, views, layer);
                solve::solve(config, &self.traces, views, sky, layer, report);
            }
        }
    }

    /// Traces the views whose camera is new.
    fn trace(&mut self, config: &BackgroundConfig, views: &[TrainingView], layer: &Gaussians) {
        self.traces.truncate(views.len());
        for (v, view) in views.iter().enumerate() {
            if self.traces.get(v).is_some_and(|t| t.camera == view.camera) {
                continue;
            }
            let trace = ViewTrace::new(&view.camera, layer, config.solve_contributors, config.solve_degree);
            if v < self.traces.len() { self.traces[v] = trace } else { self.traces.push(trace) }
        }
    }
}
