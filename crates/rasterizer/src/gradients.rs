//! Derivatives of a loss: what the backward pass takes in, and what it returns per Gaussian and parameter.

use ffgs_core::{Gaussians, PlanarImage};
use glam::{DMat3, DVec3};

/// Derivatives of a loss with respect to a rendered view.
#[derive(Clone, Copy, Debug)]
pub struct PixelGradients<'a> {
    /// With respect to the image.
    pub image: &'a PlanarImage,
    /// With respect to the transmittance (minus that of alpha), row-major; `None` = zero.
    pub transmittance: Option<&'a [f32]>,
}

/// Derivatives of a loss with respect to everything that was rendered. Sums over the `backward` calls since the
/// last [`Gradients::reset`].
#[derive(Clone, Debug, Default)]
pub struct Gradients {
    /// Per Gaussian and parameter; entries of Gaussians that were not `touched` are not meaningful.
    pub gaussians: Gaussians,
    /// Whether a Gaussian received any gradient.
    pub touched: Vec<bool>,
    /// Sum over views of the norm of the derivative with respect to the projected mean (1/px), and of half the
    /// image size times it, as 3DGS' densification reads it.
    pub mean2d_norm: Vec<f32>,
    /// Number of views that contributed to `mean2d_norm`.
    pub views_seen: Vec<u32>,
    /// Derivative with respect to the rotation block of `camera_from_world`.
    pub camera_rotation: DMat3,
    /// Derivative with respect to the translation of `camera_from_world`.
    pub camera_translation: DVec3,
    /// Derivative with respect to a constant background colour.
    pub background: [f64; 3],
}

impl Gradients {
    /// Prepares for `n` Gaussians; costs one flag a Gaussian, stale values are overwritten when first touched.
    pub fn reset(&mut self, n: usize, sh_degree: usize) {
        if self.gaussians.len() != n || self.gaussians.sh_degree() != sh_degree {
            self.gaussians.reset(n, sh_degree);
        }
        self.touched.clear();
        self.touched.resize(n, false);
        self.mean2d_norm.clear();
        self.mean2d_norm.resize(n, 0.0);
        self.views_seen.clear();
        self.views_seen.resize(n, 0);
        self.camera_rotation = DMat3::ZERO;
        self.camera_translation = DVec3::ZERO;
        self.background = [0.0; 3];
    }

    /// Writes zero where nothing was touched, so that the columns can be read as they are.
    pub fn fill_untouched(&mut self) {
        let k = self.gaussians.sh_stride();
        for i in (0..self.touched.len()).filter(|&i| !self.touched[i]) {
            self.gaussians.means[i] = [0.0; 3];
            self.gaussians.quats[i] = [0.0; 4];
            self.gaussians.log_scales[i] = [0.0; 3];
            self.gaussians.opacity_logits[i] = 0.0;
            self.gaussians.sh[i * k..(i + 1) * k].fill([0.0; 3]);
        }
    }
}
