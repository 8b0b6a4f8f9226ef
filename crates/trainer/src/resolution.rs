//! At which resolution photographs are compared with a layer (docs/adr/0054-resolution-follows-the-splats.md).

use ffgs_core::{Gaussians, TrainingView, sigmoid};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Gaussians that are looked at, at most.
const SAMPLES: usize = 4096;
/// Part of what the splats cover that may be covered by finer ones than asked for.
const FINER_SHARE: f64 = 0.25;

/// How large photographs are in the frames after the first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ResolutionConfig {
    /// Photographs that the dynamic layer is compared with are halved as often as the splats that cover three quarters of what it covers
    /// keep this standard deviation in reduced pixels; 0 = they stay as they are.
    pub splat_px: f32,
    /// Likewise of the static layer and the sky. Their shape stays, so colours alone have to answer for what a reduced render is off, and the
    /// splats have to be larger.
    pub static_splat_px: f32,
}

impl Default for ResolutionConfig {
    fn default() -> Self {
        Self { splat_px: 1.0, static_splat_px: 2.0 }
    }
}

impl ResolutionConfig {
    /// Side of the blocks of pixels, a power of two, that the photographs of `views` are reduced to where they are compared
    /// with `layer`, the dynamic one; 1 = not at all.
    pub fn dynamic(self, layer: &Gaussians, views: &[TrainingView]) -> usize {
        reduction(self.splat_px, layer, views)
    }

    /// Likewise with the static one.
    pub fn static_layer(self, layer: &Gaussians, views: &[TrainingView]) -> usize {
        reduction(self.static_splat_px, layer, views)
    }
}

/// Side of the blocks of pixels, a power of two, with which the splats that cover three quarters of what `layer` covers keep a standard
/// deviation of `splat_px` blocks; 1 where that is 0.
pub(crate) fn reduction(splat_px: f32, layer: &Gaussians, views: &[TrainingView]) -> usize {
    let finest = fine_splat(layer, views).filter(|_| splat_px > 0.0);
    let Some(finest) = finest else { return 1 };
    let side = |view: &TrainingView| view.camera.size().width.min(view.camera.size().height);
    let smallest = views.iter().map(side).min().unwrap_or(1);
    let fits = |factor: &usize| *factor <= smallest && finest >= f64::from(splat_px) * *factor as f64;
    (1..usize::BITS).map(|halvings| 1 << halvings).take_while(fits).last().unwrap_or(1)
}

/// Standard deviation (px) along their second largest axis, the finest of a disc, that the splats exceed which cover three
/// quarters of what `layer` covers in the views. `None` when no view sees any.
fn fine_splat(layer: &Gaussians, views: &[TrainingView]) -> Option<f64> {
    let stride = layer.len().div_ceil(SAMPLES).max(1);
    let sampled = (0..layer.len()).step_by(stride);
    let mut splats: Vec<[f64; 2]> = sampled.flat_map(|i| seen(layer, i, views)).collect();
    splats.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut left = FINER_SHARE * splats.iter().map(|s| s[1]).sum::<f64>();
    let reaches = |splat: &&[f64; 2]| {
        left -= splat[1];
        left <= 0.0
    };
    splats.iter().find(reaches).map(|splat| splat[0])
}

/// Size (px) and covered area (px^2, times the opacity) of a Gaussian in the views that see its centre.
fn seen(layer: &Gaussians, i: usize, views: &[TrainingView]) -> Vec<[f64; 2]> {
    let place = DVec3::from(layer.means[i].map(f64::from));
    let mut scales = layer.log_scales[i].map(|s| f64::from(s).exp());
    scales.sort_by(f64::total_cmp);
    let opacity = f64::from(sigmoid(layer.opacity_logits[i]));
    let splat = |view: &TrainingView| {
        let seen = view.camera.project(place)?;
        let per_metre = view.camera.intrinsics().focal() / seen.depth;
        let size = per_metre * scales[1];
        let area = size * per_metre * scales[2] * opacity;
        (view.camera.shows(seen.pixel) && area.is_finite() && area > 0.0).then_some([size, area])
    };
    views.iter().filter_map(splat).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};

    /// A camera of so many times 64 x 48 pixels.
    fn view(factor: usize) -> TrainingView {
        let size = ImageSize { width: 64 * factor, height: 48 * factor };
        let f = factor as f64;
        let intrinsics = Intrinsics { fx: 50.0 * f, fy: 50.0 * f, cx: 32.0 * f, cy: 24.0 * f };
        let camera = Camera::new(intrinsics, glam::DMat4::IDENTITY, size).unwrap();
        let image = ImageRgb8::new(size, vec![0; 3 * size.pixels()]).unwrap();
        TrainingView { camera, image, mask: Mask::filled(size, false) }
    }

    /// Discs before the camera whose splats have these standard deviations in an image of 64 x 48 pixels.
    fn discs(pixels: &[f32]) -> Gaussians {
        let mut layer = Gaussians::zeros(pixels.len(), 0);
        for (i, size) in pixels.iter().enumerate() {
            layer.means[i] = [0.0, 0.0, 5.0];
            layer.log_scales[i] = [(size * 0.1).ln(), (size * 0.3).ln(), (size * 0.001).ln()];
        }
        layer
    }

    #[test]
    fn the_reduction_follows_the_splats_and_the_pixels() {
        let layer = discs(&[0.1, 0.1, 0.1, 1.3, 1.3, 1.3]);
        let of = |factor| reduction(1.0, &layer, &[view(factor)]);
        assert_eq!([1, 2, 4, 6, 8].map(of), [1, 2, 4, 4, 8]);
        assert_eq!(reduction(1.0, &discs(&[0.4]), &[view(2)]), 1);
        assert_eq!(reduction(1.0, &discs(&[1e4]), &[view(1)]), 32, "no more than the image has");
        assert_eq!(reduction(2.0, &layer, &[view(8)]), 4, "twice as large splats are asked for");
        assert_eq!(reduction(0.0, &layer, &[view(8)]), 1, "off");
    }

    #[test]
    fn nothing_in_sight_reduces_nothing() {
        let mut behind = discs(&[9.0]);
        behind.means[0][2] = -5.0;
        let none = Gaussians::zeros(0, 0);
        assert_eq!([&behind, &none].map(|layer| reduction(1.0, layer, &[view(4)])), [1, 1]);
        assert_eq!(reduction(1.0, &discs(&[9.0]), &[]), 1);
    }
}
