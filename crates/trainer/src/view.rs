//! Views of a training loop, and its progress.

use crate::constants::RUNNING_RATE;
use ffgs_core::TrainingView;
use glam::DVec3;

/// Radius of the camera positions around their mean (m), a tenth larger as in 3DGS.
pub fn camera_extent(views: &[TrainingView]) -> f32 {
    let centers = || views.iter().map(|v| v.camera.center());
    let mean = centers().sum::<DVec3>() / views.len().max(1) as f64;
    1.1 * centers().map(|c| (c - mean).length()).fold(0.0, f64::max) as f32
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
