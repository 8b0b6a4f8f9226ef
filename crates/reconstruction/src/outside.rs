//! Gaussians that the views show outside their masks (docs/adr/0092-what-is-shown-outside-the-masks-is-static.md).

use ffgs_core::{Gaussians, TrainingView};
use ffgs_motion::MarkingConfig;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, View};

/// Heaviest contributors of a pixel that are counted.
const CONTRIBUTORS: usize = 16;

/// Per Gaussian the sums of its weights `alpha T` over the pixels of all views, `[inside their masks, all]`; masks are widened by `marking.dilation`.
pub(crate) fn shown_weights(
    marking: &MarkingConfig,
    gaussians: &Gaussians,
    views: &[TrainingView],
) -> Vec<[f32; 2]> {
    let mut sums = vec![[0.0; 2]; gaussians.len()];
    let mut tape = RenderTape::default();
    views.iter().for_each(|view| add(&mut sums, marking, gaussians, view, &mut tape));
    sums
}

/// Whether less than `marking.shown_share` of what a Gaussian colours lies in the masks. A kerb behind a car lies in the masks of the cameras that the car hides it
/// from; those show nothing of it. What no view shows is not judged.
pub(crate) fn is_outside(marking: &MarkingConfig, [inside, all]: [f32; 2]) -> bool {
    inside < marking.shown_share * all
}

/// Adds what one view shows.
fn add(
    sums: &mut [[f32; 2]],
    marking: &MarkingConfig,
    gaussians: &Gaussians,
    view: &TrainingView,
    tape: &mut RenderTape,
) {
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: None };
    let top = rasterizer.top_contributors(gaussians, &frame, CONTRIBUTORS, tape);
    let mask = view.mask.widened(marking.dilation);
    let pixels = top.indices.chunks(CONTRIBUTORS).zip(top.weights.chunks(CONTRIBUTORS));
    for ((indices, weights), &held) in pixels.zip(mask.data()) {
        for (&i, &weight) in indices.iter().zip(weights).filter(|(i, _)| **i >= 0) {
            let [inside, all] = &mut sums[i as usize];
            *inside += if held == 0 { 0.0 } else { weight };
            *all += weight;
        }
    }
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
            weights.iter().map(|&weights| is_outside(marking, weights)).collect::<Vec<_>>()
        };
        let found = outside(&marking, &all, &views);
        assert!(found[last], "in the mask of the first camera, which does not show it");
        assert!(found[..last].iter().all(|outside| !outside), "the body itself");
        assert!(!outside(&marking, &all, &views[..1])[last], "nobody shows it: not judged");
        let off = MarkingConfig { shown_share: 0.0, ..marking };
        assert!(outside(&off, &all, &views).iter().all(|outside| !outside));
        assert!(outside(&marking, &body, &without_masks(views)).iter().any(|outside| *outside), "no masks");
    }
}
