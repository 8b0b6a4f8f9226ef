//! Gaussians that the views show outside their masks (docs/adr/0092-what-is-shown-outside-the-masks-is-static.md).

use ffgs_core::{Gaussians, TrainingView};
use ffgs_motion::MarkingConfig;
use ffgs_rasterizer::{Background, CpuRasterizer, FootprintSums, RenderOptions, RenderTape, View};
use glam::DVec3;
use rayon::prelude::*;

/// Weights of its pixels, summed over all views of the first frame, below which a Gaussian is hidden in them; as of images whose longer side has 320
/// pixels ([`ffgs_core::ImageSize::enlargement`]): a splat covers more pixels of a larger image.
pub(crate) const HIDDEN_BELOW: f32 = 1.0;

/// Per Gaussian the sums of its weights `alpha T` over the pixels of all views, `[inside their masks, all]`; masks are widened by `marking.dilation`, and the
/// pixels of an image that is larger than one of 320 count for the part of it that they are.
pub(crate) fn shown_weights(
    marking: &MarkingConfig,
    gaussians: &Gaussians,
    views: &[TrainingView],
) -> Vec<[f32; 2]> {
    let mut sums = vec![[0.0; 2]; gaussians.len()];
    let (mut tape, mut footprints) = (RenderTape::default(), FootprintSums::default());
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    for view in views {
        let mask = view.mask.widened(marking.dilation);
        let pixel = view.camera.size().enlargement().powi(-2) as f32;
        let inside: Vec<f32> = mask.data().iter().map(|&held| if held == 0 { 0.0 } else { pixel }).collect();
        let all = vec![pixel; inside.len()];
        let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: None };
        rasterizer.accumulate(gaussians, &frame, &[&inside, &all], &mut tape, &mut footprints);
        sums.par_iter_mut().enumerate().for_each(|(i, sums)| {
            sums.iter_mut().zip(footprints.of(i)).for_each(|(sum, shown)| *sum += shown);
        });
    }
    sums
}

/// Whether less than `marking.shown_share` of what a Gaussian colours lies in the masks. A kerb behind a car lies in the masks of the cameras that the car hides it
/// from; those show nothing of it. What no view shows is outside where `looking`, the number of views that look there, is one: that a single mask covers a place says
/// nothing of how far away what moves is. It is not judged elsewhere.
pub(crate) fn is_outside(
    marking: &MarkingConfig,
    [inside, all]: [f32; 2],
    looking: impl Fn() -> usize,
) -> bool {
    let on_chance = || marking.shown_share > 0.0 && all < HIDDEN_BELOW && looking() < 2;
    inside < marking.shown_share * all || on_chance()
}

/// How many of the views have a place in their image.
pub(crate) fn looking_at(place: DVec3, views: &[TrainingView]) -> usize {
    views.iter().filter(|view| view.camera.pixel_of(place).is_some()).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{ball, photographs, without_masks};
    use glam::Vec3;

    #[test]
    fn what_one_camera_shows_beside_the_body_and_the_others_hide_behind_it_is_outside() {
        let body = ball(Vec3::ZERO);
        let views = photographs(&body);
        let mut all = body.clone();
        // Behind the body for the first camera; the others see it beside the body.
        let centre = views[0].camera.center().as_vec3();
        all.extend(&ball(Vec3::ZERO).select(&[0]));
        let last = all.len() - 1;
        all.means[last] = (-centre.normalize() * 1.5).to_array();
        let marking = MarkingConfig::default();
        let outside = |marking: &MarkingConfig, gaussians: &Gaussians, views: &[TrainingView]| {
            let weights = shown_weights(marking, gaussians, views);
            let places = gaussians.positions();
            let of = |(&weights, &place)| is_outside(marking, weights, || looking_at(place, views));
            weights.iter().zip(&places).map(of).collect::<Vec<_>>()
        };
        let found = outside(&marking, &all, &views);
        assert!(found[last], "in the mask of the first camera, which does not show it");
        assert!(found[..last].iter().all(|outside| !outside), "the body itself");
        let behind = |views: &[TrainingView]| outside(&marking, &all, views)[last];
        assert!(behind(&views[..1]), "nobody shows it, and one camera alone looks there");
        let beside = [views[0].clone(), views[0].clone()];
        assert!(!behind(&beside), "nobody shows it: not judged by two that look there");
        assert!(outside(&marking, &all, &beside)[..last].iter().any(|outside| !outside), "the body");
        let off = MarkingConfig { shown_share: 0.0, ..marking };
        assert!(outside(&off, &all, &views).iter().all(|outside| !outside));
        assert!(outside(&marking, &body, &without_masks(views)).iter().any(|outside| *outside), "no masks");
    }
}
