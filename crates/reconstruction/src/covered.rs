//! Static Gaussians that what moves covers from all views (docs/adr/0068-what-is-covered-is-not-drawn.md).

use crate::reconstructor::Reconstructor;
use anyhow::Result;
use ffgs_core::{Camera, Gaussians, Mask, Scene, StageLog, TrainingView, stage};
use ffgs_fusion::{ViewCounts, count_views};
use ffgs_motion::MarkingConfig;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, TileMask, View};
use rayon::prelude::*;
use std::time::Instant;

impl Reconstructor<'_> {
    /// Indices of the static Gaussians that what moves covers at t.
    pub(crate) fn find_covered(
        &self,
        scene: &Scene,
        now: &[TrainingView],
        log: &mut StageLog,
    ) -> Result<Vec<u32>> {
        let start = Instant::now();
        let marking = &self.config.marking;
        let found = marking.covering_alpha > 0.0 && self.method.births();
        let covered = if found { covered(marking, scene, now)? } else { Vec::new() };
        log.since(stage::VALIDATION, start);
        Ok(covered)
    }
}

/// Those that lie where the moving layer, widened, shows, in all views that see them. Such a place is inside the body or behind it:
/// nothing static is to be seen there, and what is drawn there all the same shows before the body or through it.
fn covered(marking: &MarkingConfig, scene: &Scene, views: &[TrainingView]) -> Result<Vec<u32>> {
    let layer = &scene.dynamic.gaussians;
    if layer.is_empty() {
        return Ok(Vec::new());
    }
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let shown = |view| shown(layer, view, marking.covering_alpha).widened(marking.dilation);
    let shown: Vec<Mask> = views.par_iter().map(shown).collect();
    let counts = count_views(&scene.static_layer.positions(), &cameras, &shown)?;
    let is_covered = |c: &ViewCounts| c.seen > 0 && c.inside == c.seen;
    Ok((0..).zip(&counts).filter(|(_, counts)| is_covered(counts)).map(|(i, _)| i).collect())
}

/// The foreground of `view` where `layer`, which moves, has at least this alpha. Masks alone would do where they are right; one that errs has nothing
/// in it that moves.
pub(crate) fn shown(layer: &Gaussians, view: &TrainingView, alpha: f32) -> Mask {
    let tiles = TileMask::covering(&view.mask);
    let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
    let mut tape = RenderTape::default();
    let options = RenderOptions { sh_degree: Some(0), ..RenderOptions::default() };
    CpuRasterizer::new(options).render(layer, &frame, &mut tape);
    let pixels = tape.transmittance().iter().zip(view.mask.data());
    let hidden = pixels.map(|(&t, &inside)| u8::from(inside != 0 && 1.0 - t >= alpha)).collect();
    Mask::new(view.mask.size(), hidden).expect("one value per pixel")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{SIZE, ball, photographs, scene, without_masks};
    use glam::Vec3;

    /// The ball around the origin before static Gaussians at `places`.
    fn with_static(places: &[[f32; 3]]) -> Scene {
        let mut layer = Gaussians::zeros(places.len(), 1);
        layer.means = places.to_vec();
        Scene { static_layer: layer.into(), ..scene(&ball(Vec3::ZERO)) }
    }

    fn found(scene: &Scene, views: &[TrainingView]) -> Vec<u32> {
        covered(&MarkingConfig { dilation: 1, ..MarkingConfig::default() }, scene, views).unwrap()
    }

    #[test]
    fn what_no_view_can_see_is_covered() {
        // Within; just before the surface of the first camera; beside; behind it for that camera alone; behind all cameras.
        let places =
            [[0.1, 0.2, 0.0], [0.55, 0.0, 0.05], [0.0, 0.0, 0.9], [-2.0, 0.0, -0.2], [9.0, -9.0, 9.0]];
        let (scene, mut views) = (with_static(&places), photographs(&ball(Vec3::ZERO)));
        assert_eq!(found(&scene, &views), [0, 1]);
        assert_eq!(found(&scene, &without_masks(views.clone())), [0; 0], "no foreground");
        views[2].mask = Mask::filled(SIZE, false);
        assert_eq!(found(&scene, &views), [0; 0], "a view that looks through it");
    }

    #[test]
    fn masks_that_err_cover_nothing() {
        let mut views = photographs(&ball(Vec3::ZERO));
        views.iter_mut().for_each(|view| view.mask = Mask::filled(SIZE, true));
        let places = [[0.0; 3], [0.0, 0.0, 0.9], [0.9, 0.9, 0.0]];
        assert_eq!(found(&with_static(&places), &views), [0]);
        let mut faint = with_static(&places);
        faint.dynamic.gaussians.opacity_logits.fill(-4.0);
        assert_eq!(found(&faint, &views), [0; 0], "the body is transparent");
        faint.dynamic.gaussians = Gaussians::zeros(0, 1);
        assert_eq!(found(&faint, &views), [0; 0], "there is no body");
    }
}
