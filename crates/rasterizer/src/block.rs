//! Gaussians in blocks of a fixed size, one column per parameter: a loop over a block runs in the lanes of the dispatched
//! instruction set.

use crate::elementary::sigmoid;
use crate::pinhole::PinholeF32;
use crate::projection::{Extent, Splat, offset, splat};
use ffgs_core::{Gaussians, PixelFilter};
use glam::Vec3;

/// Gaussians per block: one AVX-512 register, two of AVX2.
pub(crate) const BLOCK: usize = 16;

/// One value of each Gaussian of a block.
pub(crate) type Column = [f32; BLOCK];

/// Parameters of a block.
#[derive(Clone, Default)]
pub(crate) struct Block {
    /// Position relative to the camera's centre (m, world axes).
    pub(crate) offset: [Column; 3],
    pub(crate) quat: [Column; 4],
    pub(crate) log_scales: [Column; 3],
    pub(crate) opacity_logit: Column,
    /// Factor of the opacity; 0 = left out.
    pub(crate) factor: Column,
}

impl Block {
    /// Loads Gaussian `i` into lane `k`; `factor` is that of its opacity.
    #[inline(always)]
    pub(crate) fn load(&mut self, k: usize, g: &Gaussians, i: usize, camera: &PinholeF32, factor: f32) {
        let from_camera = offset(g.means[i], camera.center);
        let (quat, scales) = (g.quats[i], g.log_scales[i]);
        for axis in 0..3 {
            self.offset[axis][k] = from_camera[axis];
            self.log_scales[axis][k] = scales[axis];
        }
        for axis in 0..4 {
            self.quat[axis][k] = quat[axis];
        }
        self.opacity_logit[k] = g.opacity_logits[i];
        self.factor[k] = factor;
    }

    /// Position of lane `k`.
    #[inline(always)]
    pub(crate) fn offset(&self, k: usize) -> Vec3 {
        Vec3::new(self.offset[0][k], self.offset[1][k], self.offset[2][k])
    }

    /// Rotation of lane `k`.
    #[inline(always)]
    pub(crate) fn quat(&self, k: usize) -> [f32; 4] {
        [self.quat[0][k], self.quat[1][k], self.quat[2][k], self.quat[3][k]]
    }

    /// Log scales of lane `k`.
    #[inline(always)]
    pub(crate) fn log_scales(&self, k: usize) -> [f32; 3] {
        [self.log_scales[0][k], self.log_scales[1][k], self.log_scales[2][k]]
    }

    /// Opacity of lane `k`, without the antialiasing compensation.
    #[inline(always)]
    pub(crate) fn opacity(&self, k: usize) -> f32 {
        let alpha = sigmoid(self.opacity_logit[k]) * self.factor[k];
        // Not `min`, which would make 1 of a NaN.
        if alpha > 1.0 { 1.0 } else { alpha }
    }

    /// Derivative of [`Block::opacity`] by the logit: none at the bound.
    #[inline(always)]
    pub(crate) fn opacity_slope(&self, k: usize) -> f32 {
        let alpha = sigmoid(self.opacity_logit[k]);
        if alpha * self.factor[k] > 1.0 { 0.0 } else { alpha * (1.0 - alpha) * self.factor[k] }
    }

    /// Projects all lanes.
    #[inline(always)]
    pub(crate) fn project(
        &self,
        camera: &PinholeF32,
        kind: PixelFilter,
        size: [f32; 2],
        out: &mut Projected,
    ) {
        for k in 0..BLOCK {
            let bare = self.opacity(k);
            let (s, e) = splat(self.offset(k), self.quat(k), self.log_scales(k), bare, camera, kind, size);
            out.mean[0][k] = s.mean[0];
            out.mean[1][k] = s.mean[1];
            out.conic[0][k] = s.conic[0];
            out.conic[1][k] = s.conic[1];
            out.conic[2][k] = s.conic[2];
            out.opacity[k] = s.opacity;
            out.depth[k] = s.depth;
            out.reach[k] = s.reach;
            out.half_height[k] = s.half_height;
            out.shrink[k] = s.shrink;
            out.covariance[0][k] = e.covariance[0];
            out.covariance[1][k] = e.covariance[1];
            out.half_width[k] = e.half_width;
        }
    }
}

/// Splats of a block, a column each; see [`Splat`] and [`Extent`].
#[derive(Clone, Default)]
pub(crate) struct Projected {
    mean: [Column; 2],
    conic: [Column; 3],
    /// 0 where nothing shows.
    pub(crate) opacity: Column,
    depth: Column,
    reach: Column,
    half_height: Column,
    shrink: Column,
    covariance: [Column; 2],
    half_width: Column,
}

impl Projected {
    /// Lane `k` as the splat of Gaussian `index`.
    #[inline(always)]
    pub(crate) fn splat(&self, k: usize, index: usize) -> (Splat, Extent) {
        let splat = Splat {
            mean: [self.mean[0][k], self.mean[1][k]],
            conic: [self.conic[0][k], self.conic[1][k], self.conic[2][k]],
            opacity: self.opacity[k],
            depth: self.depth[k],
            reach: self.reach[k],
            half_height: self.half_height[k],
            shrink: self.shrink[k],
            index: index as u32,
            ..Splat::default()
        };
        let covariance = [self.covariance[0][k], self.covariance[1][k]];
        (splat, Extent { covariance, half_width: self.half_width[k] })
    }
}
