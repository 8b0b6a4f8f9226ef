//! Static Gaussians that what moves covers from all views (docs/adr/0068-what-is-covered-is-not-drawn.md).

use crate::shown::Shown;
use anyhow::Result;
use ffgs_core::{Camera, Mask, Scene, TrainingView};
use ffgs_fusion::{ViewCounts, count_views};
use ffgs_motion::MarkingConfig;
use rayon::prelude::*;

/// Ascending indices of the static Gaussians that all views which see them have where the moving layer is `shown`, widened. Such a place is inside the body
/// or behind it: nothing static is to be seen there, and what is drawn there all the same shows before the body or through it.
pub(crate) fn covered(
    marking: &MarkingConfig,
    scene: &Scene,
    views: &[TrainingView],
    shown: &[Shown],
) -> Result<Vec<u32>> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let shown: Vec<Mask> = shown.par_iter().map(|shown| shown.mask.widened(marking.dilation)).collect();
    let counts = count_views(&scene.static_layer.positions(), &cameras, &shown)?;
    let is_covered = |c: &ViewCounts| c.seen > 0 && c.inside == c.seen;
    Ok((0..).zip(&counts).filter(|(_, counts)| is_covered(counts)).map(|(i, _)| i).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shown::shown;
    use crate::test_scene::{SIZE, ball, photographs, scene, without_masks};
    use ffgs_core::Gaussians;
    use glam::Vec3;

    /// The ball around the origin before static Gaussians at `places`.
    fn with_static(places: &[[f32; 3]]) -> Scene {
        let mut layer = Gaussians::zeros(places.len(), 1);
        layer.means = places.to_vec();
        Scene { static_layer: layer.into(), ..scene(&ball(Vec3::ZERO)) }
    }

    fn found(scene: &Scene, views: &[TrainingView]) -> Vec<u32> {
        let marking = MarkingConfig { dilation: 1, ..MarkingConfig::default() };
        let shown = shown(&marking, &scene.dynamic.gaussians, views);
        covered(&marking, scene, views, &shown).unwrap()
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
