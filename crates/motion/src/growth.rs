//! Growth: removes faded Gaussians, splits or clones those with an uncertain position (Algorithm 1, lines 41 and 42).

use crate::{MotionInput, pixel_sizes};
use ffgs_core::{Dynamic, StageLog, sigmoid, stage};
use ffgs_fusion::{GrowthConfig, apply_growth, plan_growth};
use std::time::Instant;

/// Removes what has faded, then splits or clones what is uncertain, as far as that makes up for what is gone.
pub(crate) fn grow(input: &MotionInput, dynamic: &mut Dynamic, log: &mut StageLog) {
    let start = Instant::now();
    let config = &input.config.densification;
    remove_faded(config.min_opacity, dynamic, log);
    let most = config.max_dynamic.min((config.max_growth * dynamic.growth_limit as f64) as usize);
    let config = GrowthConfig { max_dynamic: most, ..*config };
    let pixel_m = pixel_sizes(&dynamic.gaussians.positions(), input.step.now.iter().map(|view| &view.camera));
    let plan = plan_growth(&dynamic.gaussians, &dynamic.covariances, &pixel_m, &config);
    let seed = input.step.seed ^ (input.step.frame as u64) << 32;
    apply_growth(&mut dynamic.gaussians, &mut dynamic.covariances, &plan, seed);
    dynamic.flexibility.extend(plan.iter().map(|p| dynamic.flexibility[p.0]).collect::<Vec<_>>());
    dynamic.steps.extend(plan.iter().map(|p| dynamic.steps[p.0]).collect::<Vec<_>>());
    dynamic.number_new();
    log.change("split or cloned", plan.len());
    log.since(stage::GROWTH, start);
}

/// Removes Gaussians that show next to nothing wherever they are.
fn remove_faded(least: f32, dynamic: &mut Dynamic, log: &mut StageLog) {
    let logits = &dynamic.gaussians.opacity_logits;
    let kept: Vec<usize> = (0..logits.len()).filter(|&i| sigmoid(logits[i]) >= least).collect();
    log.change("removed: faded", logits.len() - kept.len());
    dynamic.keep(&kept);
}
