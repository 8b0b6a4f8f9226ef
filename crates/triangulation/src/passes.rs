//! The loops over views. Written as plain loops over the lanes of a block, they are compiled for each instruction set
//! and chosen at run time; no multiplication is contracted, so every machine gets the same bits.

use crate::normal::Normal;
use crate::views::{Block, Column, LANES, RayWeights};
use pulp::{Simd, WithSimd};

/// Sum over the lanes, always in the same order.
#[inline(always)]
fn total(column: &Column) -> f64 {
    let four = [column[0] + column[4], column[1] + column[5], column[2] + column[6], column[3] + column[7]];
    (four[0] + four[2]) + (four[1] + four[3])
}

/// Squared residual (px^2) of a lane; infinite behind the camera.
#[inline(always)]
fn squared_error(block: &Block, k: usize, [x, y, z]: [f64; 3]) -> f64 {
    let near = 1.0 / z;
    let dx = block.target[0][k] - block.focal[0][k] * x * near;
    let dy = block.target[1][k] - block.focal[1][k] * y * near;
    if z > 0.0 { dx * dx + dy * dy } else { f64::INFINITY }
}

/// Square of the depth that turns metres into pixels. A point behind the camera or beside it takes its distance: the
/// first guess may be that bad and still be mended by the other views.
#[inline(always)]
fn squared_depth(z: f64, offset: [f64; 3]) -> f64 {
    let distance2 = (offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]).max(1e-18);
    let depth2 = if z > 0.0 { z * z } else { 0.0 };
    if depth2 > 0.05 * 0.05 * distance2 { depth2 } else { distance2 }
}

/// See [`crate::views::Views::rays`].
pub struct RayPass<'a> {
    pub blocks: &'a [Block],
    pub point: [f64; 3],
    pub weights: RayWeights,
}

impl WithSimd for RayPass<'_> {
    type Output = Normal;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Normal {
        let Self { blocks, point, weights } = self;
        let (by_depth, soft) = match weights {
            RayWeights::Plain => (0.0, 0.0),
            RayWeights::Depth => (1.0, 0.0),
            RayWeights::Soft(scale) => (1.0, 1.0 / (scale * scale)),
        };
        let mut sums = [[0.0; LANES]; 9];
        for block in blocks {
            for k in 0..LANES {
                let p = block.in_camera(k, point);
                let c = [block.center[0][k], block.center[1][k], block.center[2][k]];
                let d = [block.ray[0][k], block.ray[1][k], block.ray[2][k]];
                let depth2 = squared_depth(p[2], [point[0] - c[0], point[1] - c[1], point[2] - c[2]]);
                let error = squared_error(block, k, p);
                // Behind a camera a soft weight is 0; without one the residual does not count at all.
                let penalty = if soft > 0.0 { 1.0 + error * soft } else { 1.0 };
                let (above, below) =
                    if by_depth > 0.0 { (block.focal[0][k] * block.focal[1][k], depth2) } else { (1.0, 1.0) };
                let w = block.weight[k] * above / (below * penalty);
                let along = d[0] * c[0] + d[1] * c[1] + d[2] * c[2];
                sums[0][k] += w * (1.0 - d[0] * d[0]);
                sums[1][k] -= w * d[0] * d[1];
                sums[2][k] -= w * d[0] * d[2];
                sums[3][k] += w * (1.0 - d[1] * d[1]);
                sums[4][k] -= w * d[1] * d[2];
                sums[5][k] += w * (1.0 - d[2] * d[2]);
                sums[6][k] += w * (c[0] - d[0] * along);
                sums[7][k] += w * (c[1] - d[1] * along);
                sums[8][k] += w * (c[2] - d[2] * along);
            }
        }
        normal(&sums)
    }
}

#[inline(always)]
fn normal(sums: &[Column; 9]) -> Normal {
    let mut out = Normal::default();
    for i in 0..6 {
        out.a[i] = total(&sums[i]);
    }
    for i in 0..3 {
        out.b[i] = total(&sums[6 + i]);
    }
    out
}

/// See [`crate::views::Views::reprojection`]; the last result is whether a view that counts has the point behind it.
pub struct ReprojectionPass<'a> {
    pub blocks: &'a [Block],
    pub point: [f64; 3],
}

impl WithSimd for ReprojectionPass<'_> {
    type Output = (Normal, f64, bool);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> (Normal, f64, bool) {
        let Self { blocks, point } = self;
        let mut sums = [[0.0; LANES]; 9];
        let (mut cost, mut hidden) = ([0.0; LANES], [0.0; LANES]);
        for block in blocks {
            let r = &block.rotation;
            for k in 0..LANES {
                let [x, y, z] = block.in_camera(k, point);
                let in_front = z > 0.0;
                let near = 1.0 / if in_front { z } else { 1.0 };
                let w = if in_front { block.weight[k] } else { 0.0 };
                hidden[k] += block.weight[k] - w;
                let (u, v) = (x * near, y * near);
                let (fx, fy) = (block.focal[0][k], block.focal[1][k]);
                let (ex, ey) = (block.target[0][k] - fx * u, block.target[1][k] - fy * v);
                let (sx, sy) = (fx * near, fy * near);
                let jx = [
                    sx * (r[0][k] - u * r[6][k]),
                    sx * (r[1][k] - u * r[7][k]),
                    sx * (r[2][k] - u * r[8][k]),
                ];
                let jy = [
                    sy * (r[3][k] - v * r[6][k]),
                    sy * (r[4][k] - v * r[7][k]),
                    sy * (r[5][k] - v * r[8][k]),
                ];
                sums[0][k] += w * (jx[0] * jx[0] + jy[0] * jy[0]);
                sums[1][k] += w * (jx[0] * jx[1] + jy[0] * jy[1]);
                sums[2][k] += w * (jx[0] * jx[2] + jy[0] * jy[2]);
                sums[3][k] += w * (jx[1] * jx[1] + jy[1] * jy[1]);
                sums[4][k] += w * (jx[1] * jx[2] + jy[1] * jy[2]);
                sums[5][k] += w * (jx[2] * jx[2] + jy[2] * jy[2]);
                sums[6][k] += w * (jx[0] * ex + jy[0] * ey);
                sums[7][k] += w * (jx[1] * ex + jy[1] * ey);
                sums[8][k] += w * (jx[2] * ex + jy[2] * ey);
                cost[k] += w * (ex * ex + ey * ey);
            }
        }
        (normal(&sums), total(&cost), total(&hidden) > 0.0)
    }
}

/// See [`crate::views::Views::errors`].
pub struct ErrorPass<'a> {
    pub blocks: &'a [Block],
    pub point: [f64; 3],
    pub errors: &'a mut [Column],
}

impl WithSimd for ErrorPass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (block, out) in self.blocks.iter().zip(self.errors) {
            for k in 0..LANES {
                out[k] = squared_error(block, k, block.in_camera(k, self.point));
            }
        }
    }
}

/// See [`crate::views::Views::ray_cost`].
pub struct RayResidualPass<'a> {
    pub blocks: &'a [Block],
    pub point: [f64; 3],
}

impl WithSimd for RayResidualPass<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let Self { blocks, point } = self;
        let mut cost = [0.0; LANES];
        for block in blocks {
            for k in 0..LANES {
                let z = block.in_camera(k, point)[2];
                let d = [block.ray[0][k], block.ray[1][k], block.ray[2][k]];
                let o = [
                    point[0] - block.center[0][k],
                    point[1] - block.center[1][k],
                    point[2] - block.center[2][k],
                ];
                let along = d[0] * o[0] + d[1] * o[1] + d[2] * o[2];
                // The vector, not the difference of squares: that would round to less than nothing.
                let across = [o[0] - d[0] * along, o[1] - d[1] * along, o[2] - d[2] * along];
                let metres2 = across[0] * across[0] + across[1] * across[1] + across[2] * across[2];
                let pixels2 = metres2 * block.focal[0][k] * block.focal[1][k] / squared_depth(z, o);
                let pixels2 = if z > 0.0 { pixels2 } else { f64::INFINITY };
                cost[k] += if block.weight[k] > 0.0 { block.weight[k] * pixels2 } else { 0.0 };
            }
        }
        total(&cost)
    }
}
