//! Lines 35 to 40.

use super::{Dynamic, MotionInput, MotionOutcome, add_seconds, positions};
use anyhow::Result;
use ffgs_core::{Camera, Mask};
use ffgs_fusion::{count_views, second_chance, validate};
use glam::DVec3;
use std::time::Instant;

/// Lines 35 to 40: who left the masks gets one second chance beside its neighbours, then goes.
pub(super) fn validate_positions(
    input: &MotionInput,
    dynamic: &mut Dynamic,
    outcome: &mut MotionOutcome,
) -> Result<()> {
    let start = Instant::now();
    let mut means = positions(&dynamic.gaussians);
    let valid = valid_positions(input, &means)?;
    second_chance(&outcome.previous, &mut means, &valid)?;
    let valid = valid_positions(input, &means)?;
    let kept: Vec<usize> = (0..means.len()).filter(|&i| valid[i]).collect();
    let lost = means.len() - kept.len();
    outcome.skip("Gaussians removed: outside the masks".into(), lost);
    if lost as f64 > input.config.marking.loss_warning * means.len() as f64 {
        outcome.warnings.push(format!("{lost} of {} dynamic Gaussians left the masks", means.len()));
    }
    for (target, mean) in dynamic.gaussians.means.iter_mut().zip(&means) {
        *target = mean.as_vec3().to_array();
    }
    dynamic.gaussians = dynamic.gaussians.select(&kept);
    dynamic.covariances = kept.iter().map(|&i| dynamic.covariances[i]).collect();
    dynamic.steps = kept.iter().map(|&i| means[i] - outcome.previous[i]).collect();
    outcome.previous = kept.iter().map(|&i| outcome.previous[i]).collect();
    add_seconds(&mut outcome.seconds.validation, start);
    Ok(())
}

/// With the masks grown as for marking: a splat's mean may lie beside the mask that its footprint touches.
fn valid_positions(input: &MotionInput, means: &[DVec3]) -> Result<Vec<bool>> {
    let with_foreground = input.now.iter().filter(|v| v.mask.count() > 0);
    let dilation = input.config.marking.dilation;
    let (cameras, masks): (Vec<Camera>, Vec<Mask>) =
        with_foreground.map(|v| (v.camera, v.mask.dilated(dilation))).unzip();
    let counts = count_views(means, &cameras, &masks)?;
    Ok(counts.into_iter().map(|c| validate(c, input.config.marking.slack)).collect())
}
