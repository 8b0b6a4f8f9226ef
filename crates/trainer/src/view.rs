//! Views of a training loop, and its progress.

use crate::constants::RUNNING_RATE;
use ffgs_core::{TrainingView, upper_median};
use glam::DVec3;

/// A camera farther out than this many times the median does not count for the extent: rigs of near and far cameras reach 3.
const FAR_OUT: f64 = 6.0;

/// Radius of the camera positions around their mean (m), a tenth larger as in 3DGS; without cameras that stand far out from
/// the others, which would raise all rates. 0 for fewer than two.
pub fn camera_extent(views: &[TrainingView]) -> f32 {
    let centers: Vec<DVec3> = views.iter().map(|v| v.camera.center()).collect();
    let coordinate = |axis: usize| upper_median(centers.iter().map(|c| c[axis])).unwrap_or(0.0);
    let middle = DVec3::from_array(std::array::from_fn(coordinate));
    let usual = upper_median(centers.iter().map(|c| c.distance(middle))).unwrap_or(0.0);
    // Half of the cameras at one place say nothing of the others.
    let counts = |c: &&DVec3| !(usual > 0.0) || c.distance(middle) <= FAR_OUT * usual;
    let near: Vec<DVec3> = centers.iter().filter(counts).copied().collect();
    let mean = near.iter().sum::<DVec3>() / near.len().max(1) as f64;
    1.1 * near.iter().map(|c| (*c - mean).length()).fold(0.0, f64::max) as f32
}

/// What a training loop reports after a step.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Steps done.
    pub iteration: usize,
    /// Steps in all.
    pub iterations: usize,
    /// Running mean of the loss.
    pub loss: f64,
    /// PSNR of the running mean squared error over counted pixels (dB).
    pub psnr: f64,
    /// Gaussians now.
    pub gaussians: usize,
}

/// Exponential running means of the loss and the squared error.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Running {
    loss: Option<(f64, f64)>,
}

impl Running {
    pub(crate) fn add(&mut self, loss: f64, mse: f64) {
        let (l, m) = self.loss.unwrap_or((loss, mse));
        self.loss = Some((l + RUNNING_RATE * (loss - l), m + RUNNING_RATE * (mse - m)));
    }

    pub(crate) fn progress(&self, iteration: usize, iterations: usize, gaussians: usize) -> Progress {
        let (loss, mse) = self.loss.unwrap_or((f64::NAN, f64::NAN));
        Progress { iteration, iterations, loss, psnr: -10.0 * mse.max(1e-12).log10(), gaussians }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};
    use glam::DMat4;

    fn views(places: &[DVec3]) -> Vec<TrainingView> {
        let size = ImageSize { width: 4, height: 3 };
        let intrinsics = Intrinsics { fx: 4.0, fy: 4.0, cx: 2.0, cy: 1.5 };
        let view = |place: &DVec3| TrainingView {
            camera: Camera::new(intrinsics, DMat4::from_translation(-*place), size).unwrap(),
            image: ImageRgb8::new(size, vec![0; 36]).unwrap(),
            mask: Mask::filled(size, false),
        };
        places.iter().map(view).collect()
    }

    #[test]
    fn one_camera_far_away_does_not_raise_the_extent() {
        let mut ring: Vec<DVec3> =
            (0..12).map(|i| 5.0 * DVec3::new(f64::from(i).cos(), f64::from(i).sin(), 0.0)).collect();
        let alone = camera_extent(&views(&ring));
        assert!((4.5..6.5).contains(&alone), "{alone}");
        ring.push(DVec3::new(400.0, 0.0, 30.0));
        assert!((camera_extent(&views(&ring)) / alone - 1.0).abs() < 0.01);
        assert_eq!(camera_extent(&[]), 0.0);
        let pair = camera_extent(&views(&[DVec3::ZERO, DVec3::X]));
        assert!((pair - 0.55).abs() < 1e-6, "{pair}");
        let most_at_one_place = [DVec3::ZERO, DVec3::ZERO, DVec3::ZERO, DVec3::X];
        assert!(camera_extent(&views(&most_at_one_place)) > 0.5);
    }
}
