//! Static Gaussians before something that moves, which a photograph shows all the same (docs/adr/0079-nothing-stands-before-what-is-seen.md).

use crate::shown::Shown;
use ffgs_core::{Gaussians, Scene, TrainingView, sigmoid};
use ffgs_motion::MarkingConfig;
use glam::DVec3;
use rayon::prelude::*;

/// Share of the distance to what moves by which a Gaussian has to be nearer.
const NEARER: f64 = 0.05;
/// Standard deviations along its longest axis that a Gaussian reaches towards what is behind it.
const REACH: f64 = 2.0;
/// Opacity below which a Gaussian shows nothing.
const LEAST_OPACITY: f32 = 0.01;

/// Ascending indices of the static Gaussians that stand before what moves in at least one of the views, where it is `shown`.
pub(crate) fn denied(
    marking: &MarkingConfig,
    scene: &Scene,
    views: &[TrainingView],
    shown: &[Shown],
) -> Vec<u32> {
    let (layer, moving) = (&scene.static_layer, &scene.dynamic.gaussians);
    let views = views.iter().zip(shown).filter(|(_, shown)| shown.mask.count() > 0);
    let margin = |shown: &Shown| shown.mask.margin(marking.dilation);
    let behind: Vec<Behind> =
        views.map(|(view, shown)| Behind { view, shown, margin: margin(shown), moving }).collect();
    let stands_before = |&i: &usize| {
        sigmoid(layer.opacity_logits[i]) >= LEAST_OPACITY && behind.iter().any(|b| b.denies(layer, i))
    };
    (0..layer.len()).into_par_iter().filter(stands_before).map(|i| i as u32).collect()
}

/// What moves, in a view.
struct Behind<'a> {
    view: &'a TrainingView,
    /// Where it is shown, and by which Gaussians.
    shown: &'a Shown,
    /// Pixels from its edge within which it is not known which of both a pixel shows.
    margin: usize,
    moving: &'a Gaussians,
}

impl Behind<'_> {
    /// Whether it is shown at a pixel and all around it.
    fn surrounds(&self, x: usize, y: usize) -> bool {
        let (mask, margin) = (&self.shown.mask, self.margin);
        let size = mask.size();
        let columns = x.saturating_sub(margin)..(x + margin + 1).min(size.width);
        let mut rows = y.saturating_sub(margin)..(y + margin + 1).min(size.height);
        mask.contains(x, y) && rows.all(|row| columns.clone().all(|column| mask.contains(column, row)))
    }

    /// Whether Gaussian `i` of `layer` lies wholly before it.
    fn denies(&self, layer: &Gaussians, i: usize) -> bool {
        let camera = &self.view.camera;
        let Some((x, y)) = camera.pixel_of(place(layer, i)).filter(|&(x, y)| self.surrounds(x, y)) else {
            return false;
        };
        let depth = |layer: &Gaussians, i: usize| Some(camera.project(place(layer, i))?.depth);
        let shown = usize::try_from(self.shown.gaussians[y * camera.size().width + x]);
        let behind = shown.ok().and_then(|shown| depth(self.moving, shown));
        let longest = layer.log_scales[i].iter().copied().fold(f32::NEG_INFINITY, f32::max).exp();
        let before = |(near, far): (f64, f64)| near + REACH * f64::from(longest) < (1.0 - NEARER) * far;
        depth(layer, i).zip(behind).is_some_and(before)
    }
}

/// Centre of a Gaussian (m).
fn place(layer: &Gaussians, i: usize) -> DVec3 {
    DVec3::from(layer.means[i].map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shown::shown;
    use crate::test_scene::{SIZE, ball, photographs, scene, without_masks};
    use ffgs_core::Mask;
    use glam::Vec3;

    /// The ball around the origin, and static Gaussians of 2 cm at `places`.
    fn with_static(places: &[[f32; 3]]) -> Scene {
        let mut layer = Gaussians::zeros(places.len(), 1);
        layer.means = places.to_vec();
        layer.log_scales.fill([0.02_f32.ln(); 3]);
        Scene { static_layer: layer.into(), ..scene(&ball(Vec3::ZERO)) }
    }

    fn found(scene: &Scene, views: &[TrainingView]) -> Vec<u32> {
        let marking = MarkingConfig { dilation: 1, ..MarkingConfig::default() };
        let shown = shown(&marking, &scene.dynamic.gaussians, views);
        denied(&marking, scene, views, &shown)
    }

    #[test]
    fn what_stands_before_a_body_in_one_view_is_denied() {
        // Half way to the first camera; behind the body for it; within the body; before it by less than the share; before no body.
        let places = [[2.5, 0.0, 0.3], [-2.5, 0.0, -0.3], [0.1, 0.0, 0.0], [0.75, 0.0, 0.0], [2.5, 0.0, 2.0]];
        let (scene, views) = (with_static(&places), photographs(&ball(Vec3::ZERO)));
        assert_eq!(found(&scene, &views), [0]);
        assert_eq!(found(&scene, &views[3..]), [0; 0], "no camera that has it before the body");
        assert_eq!(found(&scene, &without_masks(views)), [0; 0], "no foreground");
    }

    #[test]
    fn what_reaches_the_body_or_shows_nothing_stays() {
        let views = photographs(&ball(Vec3::ZERO));
        let mut wide = with_static(&[[2.5, 0.0, 0.3]]);
        let layer = std::sync::Arc::make_mut(&mut wide.static_layer);
        layer.log_scales[0] = [0.02_f32.ln(), 0.0, 0.0];
        assert_eq!(found(&wide, &views), [0; 0], "it is 1 m long");
        let mut faint = with_static(&[[2.5, 0.0, 0.3]]);
        std::sync::Arc::make_mut(&mut faint.static_layer).opacity_logits[0] = -9.0;
        assert_eq!(found(&faint, &views), [0; 0]);
        let mut none = with_static(&[[2.5, 0.0, 0.3]]);
        none.dynamic.gaussians = Gaussians::zeros(0, 1);
        assert_eq!(found(&none, &views), [0; 0], "nothing moves");
    }

    #[test]
    fn at_the_edge_of_a_body_nothing_is_denied() {
        let mut views = photographs(&ball(Vec3::ZERO));
        // The first camera looks along -x from 5 m: the body ends at 0.6 m, at 0.3 m half way.
        let edge = with_static(&[[2.5, 0.0, 0.585], [2.5, 0.29, 0.3]]);
        assert_eq!(found(&edge, &views), [0; 0]);
        views.iter_mut().for_each(|view| view.mask = Mask::filled(SIZE, true));
        assert_eq!(
            found(&with_static(&[[2.5, 0.0, 1.5]]), &views),
            [0; 0],
            "a mask that errs has no body in it"
        );
    }
}
