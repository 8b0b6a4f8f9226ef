//! A frame of HiCoM and ReCon-GS: nodes move all Gaussians, then some are added.

use crate::added::{AddedConfig, grow};
use crate::deformation::{Deformation, Deltas, MotionFitConfig, fit};
use crate::one_layer;
use crate::photographs::{Photographs, frame_seed};
use anyhow::Result;
use ffgs_core::{Scene, StageLog};
use ffgs_method::Step;
use ffgs_trainer::camera_extent;
use std::time::Instant;

/// Settings of both.
pub(crate) struct Stages<'a> {
    pub motion: &'a MotionFitConfig,
    pub added: &'a AddedConfig,
}

impl Stages<'_> {
    /// Trains a frame. `nodes` says which nodes the Gaussians at these positions (m) follow. Returns how many Gaussians were added; they
    /// are the last ones.
    ///
    /// # Errors
    /// When the training diverges.
    pub(crate) fn train<'d>(
        &self,
        step: &Step,
        scene: &mut Scene,
        log: &mut StageLog,
        nodes: impl FnOnce(&[[f32; 3]]) -> Result<(Deformation, &'d mut Deltas)>,
    ) -> Result<usize> {
        let Scene { dynamic, sky, .. } = scene;
        if dynamic.gaussians.is_empty() {
            return Ok(0);
        }
        let start = Instant::now();
        let mut gaussians = std::mem::take(&mut dynamic.gaussians);
        let mut photographs = Photographs::new(step, sky);
        let (deformation, deltas) = nodes(&gaussians.means)?;
        let sums = fit(&deformation, deltas, &mut gaussians, &mut photographs, self.motion)?;
        log.since("motion", start);
        let (start, kept) = (Instant::now(), gaussians.len());
        let (extent, seed) = (camera_extent(step.now), frame_seed(step));
        let gaussians = grow(gaussians, &sums, &mut photographs, self.added, extent, seed)?;
        log.since("added Gaussians", start);
        let added = gaussians.len() - kept;
        one_layer::replace(dynamic, gaussians, &(0..kept).collect::<Vec<_>>());
        Ok(added)
    }
}

/// At the start of a frame: the Gaussians that the last one added belong to the others, and as many are removed, those of lowest opacity.
pub(crate) fn merge(scene: &mut Scene, added: usize) {
    one_layer::join(scene);
    if added == 0 {
        return;
    }
    let opacities = &scene.dynamic.gaussians.opacity_logits;
    let mut order: Vec<usize> = (0..opacities.len()).collect();
    order.sort_by(|&a, &b| opacities[a].total_cmp(&opacities[b]).then(a.cmp(&b)));
    let mut kept = order.split_off(added.min(order.len()));
    kept.sort_unstable();
    scene.dynamic.keep(&kept);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::World;

    #[test]
    fn the_faintest_go_and_the_order_stays() {
        let mut scene = World::new().scene();
        merge(&mut scene, 0);
        let all = scene.dynamic.ids.clone();
        scene.dynamic.gaussians.opacity_logits[3] = -9.0;
        scene.dynamic.gaussians.opacity_logits[1] = -8.0;
        merge(&mut scene, 2);
        let without: Vec<u32> = all.iter().copied().filter(|id| ![1, 3].contains(id)).collect();
        assert_eq!(scene.dynamic.ids, without);
        merge(&mut scene, 10_000);
        assert!(scene.dynamic.gaussians.is_empty());
    }
}
