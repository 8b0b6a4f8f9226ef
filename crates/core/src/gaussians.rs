//! Gaussians as a structure of arrays: the columns that training changes and splat files hold.

use crate::Exposure;
use glam::DVec3;
use rayon::prelude::*;
use thiserror::Error;

/// The constant spherical harmonic, `1 / (2 sqrt(pi))`: a colour is `SH_C0 * coefficient + 0.5`.
pub const SH_C0: f32 = 0.282_094_8;

/// Columns of a Gaussian set disagree in length, or a degree is out of range.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("Gaussian columns do not match: {0}")]
pub struct ShapeError(pub String);

/// Number of SH coefficients per colour channel for a degree: `(degree + 1)^2`.
pub const fn sh_coefficients(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// `1 / (1 + exp(-x))`.
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Inverse of [`sigmoid`]; `p` strictly between 0 and 1.
pub fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// How the width of a pixel enters a projected Gaussian: its covariance is widened by the filter's in both cases.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelFilter {
    /// The opacity is multiplied by the share of the splat that survives the filter, so that a Gaussian keeps its weight at every
    /// distance (Mip-Splatting, Yu et al. 2024, section 5.2).
    #[default]
    Compensated,
    /// The opacity stays, as in ordinary viewers and in the original 3D Gaussian Splatting.
    Plain,
}

/// A set of 3D Gaussians in the parametrisation of 3D Gaussian Splatting, structure of arrays.
///
/// Invariant: every column has the length [`Gaussians::len`] (`sh` that times its coefficient count). Quaternions
/// need not be normalised; the rasterizer normalises.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Positions in the world (m).
    pub means: Vec<[f32; 3]>,
    /// Rotations (w, x, y, z).
    pub quats: Vec<[f32; 4]>,
    /// Natural logarithm of the three standard deviations (m).
    pub log_scales: Vec<[f32; 3]>,
    /// Logit of the opacity.
    pub opacity_logits: Vec<f32>,
    /// SH colour, Gaussian-major: entry `gaussian * coefficients + coefficient`, RGB.
    pub sh: Vec<[f32; 3]>,
    sh_degree: usize,
    /// The filter under which the parameters were found, and with which they are drawn.
    pub filter: PixelFilter,
}

impl Gaussians {
    /// No Gaussians, with room for SH of `sh_degree` (0..=3).
    pub fn empty(sh_degree: usize) -> Self {
        assert!(sh_degree <= 3, "SH degree {sh_degree} is not supported");
        Self { sh_degree, ..Self::default() }
    }

    /// The same parameters, drawn with another filter.
    #[must_use]
    pub fn with_filter(self, filter: PixelFilter) -> Self {
        Self { filter, ..self }
    }

    /// `n` Gaussians with every parameter zero (gradients, moments).
    pub fn zeros(n: usize, sh_degree: usize) -> Self {
        let mut out = Self::empty(sh_degree);
        out.means = vec![[0.0; 3]; n];
        out.quats = vec![[0.0; 4]; n];
        out.log_scales = vec![[0.0; 3]; n];
        out.opacity_logits = vec![0.0; n];
        out.sh = vec![[0.0; 3]; n * sh_coefficients(sh_degree)];
        out
    }

    /// Sets every parameter to zero and the count to `n`, keeping allocations.
    pub fn reset(&mut self, n: usize, sh_degree: usize) {
        self.sh_degree = sh_degree;
        refill(&mut self.means, n, [0.0; 3]);
        refill(&mut self.quats, n, [0.0; 4]);
        refill(&mut self.log_scales, n, [0.0; 3]);
        refill(&mut self.opacity_logits, n, 0.0);
        refill(&mut self.sh, n * sh_coefficients(sh_degree), [0.0; 3]);
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// SH degree of the colour (0..=3).
    pub fn sh_degree(&self) -> usize {
        self.sh_degree
    }

    /// SH coefficients per Gaussian and channel.
    pub fn sh_stride(&self) -> usize {
        sh_coefficients(self.sh_degree)
    }

    /// SH coefficients of Gaussian `i`.
    pub fn sh_of(&self, i: usize) -> &[[f32; 3]] {
        let k = self.sh_stride();
        &self.sh[i * k..(i + 1) * k]
    }

    /// Shows the colours in another light: their means over all directions change by the light's offsets of the log odds, what depends on the
    /// direction in proportion.
    pub fn relight(&mut self, light: Exposure) {
        let stride = self.sh_stride();
        self.sh.par_chunks_exact_mut(stride).for_each(|sh| {
            let (shown, slopes) = light.of_colour(sh[0].map(|v| SH_C0 * v + 0.5));
            sh[0] = shown.map(|v| (v - 0.5) / SH_C0);
            sh[1..].iter_mut().for_each(|rest| *rest = std::array::from_fn(|c| rest[c] * slopes[c]));
        });
    }

    /// Checks the invariant; call after filling the columns from a file.
    ///
    /// # Errors
    /// When the columns differ in length, or the SH coefficients are those of no degree.
    pub fn validate(&self) -> Result<(), ShapeError> {
        let n = self.len();
        let lengths = [self.quats.len(), self.log_scales.len(), self.opacity_logits.len()];
        if lengths.iter().any(|&l| l != n) || self.sh.len() != n * self.sh_stride() {
            let sh = self.sh.len();
            return Err(ShapeError(format!("means {n}, quats/scales/opacities {lengths:?}, sh {sh}")));
        }
        Ok(())
    }

    /// Appends Gaussian `i` of `other` (same SH degree and filter).
    pub fn push_from(&mut self, other: &Self, i: usize) {
        debug_assert_eq!((self.sh_degree, self.filter), (other.sh_degree, other.filter));
        self.means.push(other.means[i]);
        self.quats.push(other.quats[i]);
        self.log_scales.push(other.log_scales[i]);
        self.opacity_logits.push(other.opacity_logits[i]);
        self.sh.extend_from_slice(other.sh_of(i));
    }

    /// Gaussian `i` becomes Gaussian `from` of `other` (same SH degree).
    pub fn set_from(&mut self, i: usize, other: &Self, from: usize) {
        debug_assert_eq!(self.sh_degree, other.sh_degree);
        self.means[i] = other.means[from];
        self.quats[i] = other.quats[from];
        self.log_scales[i] = other.log_scales[from];
        self.opacity_logits[i] = other.opacity_logits[from];
        let k = self.sh_stride();
        self.sh[i * k..(i + 1) * k].copy_from_slice(other.sh_of(from));
    }

    /// The Gaussians at `indices`, in that order.
    #[must_use]
    pub fn select(&self, indices: &[usize]) -> Self {
        let mut out = Self { filter: self.filter, ..Self::empty(self.sh_degree) };
        for &i in indices {
            out.push_from(self, i);
        }
        out
    }

    /// Appends all of `other` (same SH degree and filter).
    pub fn extend(&mut self, other: &Self) {
        debug_assert_eq!((self.sh_degree, self.filter), (other.sh_degree, other.filter));
        self.means.extend_from_slice(&other.means);
        self.quats.extend_from_slice(&other.quats);
        self.log_scales.extend_from_slice(&other.log_scales);
        self.opacity_logits.extend_from_slice(&other.opacity_logits);
        self.sh.extend_from_slice(&other.sh);
    }

    /// Positions in f64 (m).
    pub fn positions(&self) -> Vec<DVec3> {
        self.means.iter().map(|m| DVec3::from_array(m.map(f64::from))).collect()
    }

    /// Whether every parameter is finite.
    pub fn is_finite(&self) -> bool {
        self.means.as_flattened().iter().all(|v| v.is_finite())
            && self.quats.as_flattened().iter().all(|v| v.is_finite())
            && self.log_scales.as_flattened().iter().all(|v| v.is_finite())
            && self.opacity_logits.iter().all(|v| v.is_finite())
            && self.sh.as_flattened().iter().all(|v| v.is_finite())
    }
}

fn refill<T: Clone>(column: &mut Vec<T>, n: usize, value: T) {
    column.clear();
    column.resize(n, value);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_depends_on_the_direction_changes_in_proportion_to_the_slope() {
        let mut gaussians = Gaussians::zeros(2, 1);
        gaussians.sh[1] = [0.1, 0.2, -0.3];
        let light = Exposure { offsets: [0.5; 3] };
        let (shown, slopes) = light.of_colour([0.5; 3]);
        gaussians.relight(light);
        assert!((SH_C0 * gaussians.sh[0][0] + 0.5 - shown[0]).abs() < 1e-6);
        let expected: [f32; 3] = std::array::from_fn(|c| [0.1, 0.2, -0.3][c] * slopes[c]);
        assert_eq!((gaussians.sh[1], gaussians.sh[5]), (expected, [0.0; 3]));
        assert!(gaussians.is_finite());
    }

    #[test]
    fn select_keeps_columns_together() {
        let mut g = Gaussians::zeros(3, 1);
        for i in 0..3 {
            g.opacity_logits[i] = i as f32;
            g.sh[i * 4 + 3] = [i as f32; 3];
        }
        let s = g.select(&[2, 0]);
        s.validate().unwrap();
        assert_eq!(s.opacity_logits, [2.0, 0.0]);
        assert_eq!(s.sh_of(0)[3], [2.0; 3]);
    }

    #[test]
    fn a_short_column_is_refused() {
        let mut g = Gaussians::zeros(3, 0);
        g.quats.pop();
        assert!(g.validate().is_err());
    }
}
