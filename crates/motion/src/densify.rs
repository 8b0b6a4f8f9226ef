//! Lines 41 and 42.

use crate::{MotionInput, pixel_sizes};
use ffgs_core::{Dynamic, StageLog};
use ffgs_fusion::{DensifyConfig, apply_densification, plan_densification};
use std::time::Instant;

/// Splits or clones what is uncertain.
pub(crate) fn densify(input: &MotionInput, dynamic: &mut Dynamic, log: &mut StageLog) {
    let start = Instant::now();
    let config: &DensifyConfig = &input.config.densification;
    let pixel_m = pixel_sizes(&dynamic.gaussians.positions(), input.step.now.iter().map(|view| &view.camera));
    let plan = plan_densification(&dynamic.gaussians, &dynamic.covariances, &pixel_m, config);
    let seed = input.step.seed ^ (input.step.frame as u64) << 32;
    apply_densification(&mut dynamic.gaussians, &mut dynamic.covariances, &plan, seed);
    dynamic.steps.extend(plan.iter().map(|p| dynamic.steps[p.0]).collect::<Vec<_>>());
    dynamic.number_new();
    log.since("fusion", start);
}
