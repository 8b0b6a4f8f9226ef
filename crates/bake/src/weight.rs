//! Opacities for viewers without compensation, such that each Gaussian blends as much into the pictures as before.

use ffgs_core::{Camera, Gaussians, logit, sigmoid};
use ffgs_rasterizer::{Background, CpuRasterizer, FootprintSums, RenderOptions, RenderTape, View};
use std::ops::Range;

/// Rounds of the fixed point. A Gaussian's weight depends on those in front of it, which change as well.
const ROUNDS: usize = 6;
/// An opacity changes at most by this factor in a round.
const LARGEST_CHANGE: f32 = 8.0;
/// Opacities stay between these: their logits are finite, and a Gaussian remains one.
const OPACITIES: [f32; 2] = [1e-3, 0.999];
/// Summed weight (px) below which a Gaussian is not seen and keeps its opacity.
const LEAST_WEIGHT: f32 = 1e-3;

/// Sets the opacities of the Gaussians in `range` so that each blends as much into all pixels of all `cameras` as it does in
/// `trained`, which has another filter: the sum of `alpha T`, by a multiplicative fixed point.
pub fn conserve_weight(
    gaussians: &mut Gaussians,
    trained: &Gaussians,
    range: Range<usize>,
    cameras: &[Camera],
) {
    let wanted = weights(trained, cameras);
    for _ in 0..ROUNDS {
        let found = weights(gaussians, cameras);
        for i in range.clone() {
            if wanted[i] > LEAST_WEIGHT && found[i] > LEAST_WEIGHT {
                let change = (wanted[i] / found[i]).clamp(1.0 / LARGEST_CHANGE, LARGEST_CHANGE);
                let opacity = sigmoid(gaussians.opacity_logits[i]) * change;
                gaussians.opacity_logits[i] = logit(opacity.clamp(OPACITIES[0], OPACITIES[1]));
            }
        }
    }
}

/// Blending weight of each Gaussian (px), summed over the cameras.
fn weights(gaussians: &Gaussians, cameras: &[Camera]) -> Vec<f32> {
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    let (mut tape, mut sums) = (RenderTape::default(), FootprintSums::default());
    let mut out = vec![0.0; gaussians.len()];
    for camera in cameras {
        let ones = vec![1.0; camera.size().pixels()];
        let view = View { camera, background: Background::Colour([0.0; 3]), tiles: None };
        rasterizer.accumulate(gaussians, &view, &[&ones], &mut tape, &mut sums);
        out.iter_mut().enumerate().for_each(|(i, total)| *total += sums.of(i)[0]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics, PixelFilter};
    use glam::DMat4;

    fn camera(distance: f64) -> Camera {
        let lens = Intrinsics { fx: 50.0, fy: 50.0, cx: 16.0, cy: 16.0 };
        let pose = DMat4::from_translation(glam::DVec3::new(0.0, 0.0, distance));
        Camera::new(lens, pose, ImageSize { width: 32, height: 32 }).unwrap()
    }

    /// A disc of 0.4 m, `thickness` deep, whose axis points at the camera or across.
    fn disc(thickness: f32, quat: [f32; 4]) -> Gaussians {
        let mut g = Gaussians::zeros(1, 0);
        g.quats[0] = quat;
        g.log_scales[0] = [0.4_f32.ln(), 0.4_f32.ln(), thickness.ln()];
        g.opacity_logits[0] = logit(0.8);
        g
    }

    /// With the plain filter, before a camera at 4 m.
    fn baked(trained: &Gaussians, range: Range<usize>) -> Gaussians {
        let mut out = trained.clone().with_filter(PixelFilter::Plain);
        conserve_weight(&mut out, trained, range, &[camera(4.0)]);
        out
    }

    #[test]
    fn a_disc_seen_from_the_front_keeps_its_opacity_and_one_seen_edge_on_loses_the_compensation() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let front = baked(&disc(1e-3, [1.0, 0.0, 0.0, 0.0]), 0..1);
        assert!((sigmoid(front.opacity_logits[0]) - 0.8).abs() < 0.02);
        // At 4 m a pixel is 8 cm: 4 mm of thickness are 0.05 px beside the filter's 0.548 px.
        let edge = baked(&disc(4e-3, [half, 0.0, half, 0.0]), 0..1);
        let kept = sigmoid(edge.opacity_logits[0]) / 0.8;
        assert!((kept - 0.091).abs() < 0.01, "{kept}");
    }

    #[test]
    fn what_is_not_seen_or_not_in_the_range_stays() {
        let mut g = disc(4e-3, [1.0, 0.0, 0.0, 0.0]);
        g.extend(&g.clone());
        g.means[1] = [0.0, 0.0, -100.0];
        assert_eq!(baked(&g, 1..2).opacity_logits, g.opacity_logits);
    }
}
