//! Lines 35 to 40.

use crate::MotionInput;
use anyhow::Result;
use ffgs_core::{Camera, Dynamic, Mask, StageLog};
use ffgs_fusion::{count_views, second_chance, validate};
use glam::DVec3;
use rayon::prelude::*;
use std::time::Instant;

/// Lines 35 to 40: who left the masks gets one second chance beside its neighbours, then goes.
pub(crate) fn validate_positions(
    input: &MotionInput,
    dynamic: &mut Dynamic,
    log: &mut StageLog,
) -> Result<()> {
    let start = Instant::now();
    let mut means = dynamic.gaussians.positions();
    let views = GrownMasks::new(input);
    let mut valid = views.valid(&means)?;
    second_chance(input.previous, &mut means, &valid)?;
    // Only those that moved are looked at again.
    let moved: Vec<usize> = (0..means.len()).filter(|&i| !valid[i]).collect();
    let again = views.valid(&moved.iter().map(|&i| means[i]).collect::<Vec<_>>())?;
    moved.iter().zip(again).for_each(|(&i, now)| valid[i] = now);
    let kept: Vec<usize> = (0..means.len()).filter(|&i| valid[i]).collect();
    let lost = means.len() - kept.len();
    log.skip("Gaussians removed: outside the masks", lost);
    if lost as f64 > input.config.marking.loss_warning * means.len() as f64 {
        log.warn(format!("{lost} of {} dynamic Gaussians left the masks", means.len()));
    }
    for (target, mean) in dynamic.gaussians.means.iter_mut().zip(&means) {
        *target = mean.as_vec3().to_array();
    }
    dynamic.gaussians = dynamic.gaussians.select(&kept);
    dynamic.covariances = kept.iter().map(|&i| dynamic.covariances[i]).collect();
    dynamic.steps = kept.iter().map(|&i| means[i] - input.previous[i]).collect();
    if !dynamic.knowledge.information.is_empty() {
        dynamic.knowledge.information = dynamic.knowledge.information.select(&kept);
    }
    dynamic.ids = kept.iter().map(|&i| dynamic.ids[i]).collect();
    log.since("validation", start);
    Ok(())
}

/// Views at t with foreground, their masks grown as for marking: a splat's mean may lie beside the mask that its footprint
/// touches.
struct GrownMasks {
    cameras: Vec<Camera>,
    masks: Vec<Mask>,
    slack: u32,
}

impl GrownMasks {
    fn new(input: &MotionInput) -> Self {
        let marking = &input.config.marking;
        let grown = input.step.now.par_iter().filter(|v| v.mask.count() > 0);
        let (cameras, masks) = grown.map(|v| (v.camera, v.mask.dilated(marking.dilation))).unzip();
        Self { cameras, masks, slack: marking.slack }
    }

    fn valid(&self, means: &[DVec3]) -> Result<Vec<bool>> {
        let counts = count_views(means, &self.cameras, &self.masks)?;
        Ok(counts.into_iter().map(|c| validate(c, self.slack)).collect())
    }
}
