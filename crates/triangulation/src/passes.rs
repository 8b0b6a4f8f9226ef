//! The loops over views: one view a lane, compiled for each instruction set and chosen at run time.

use crate::normal::Normal;
use crate::real::{Real, dot};
use crate::views::{Block, Column, LANES, RayWeights};
use pulp::{Simd, WithSimd};

/// The lanes of a block that one vector holds, with a point in each of their cameras.
#[derive(Clone, Copy)]
struct Lanes<'a, S: Simd> {
    simd: S,
    block: &'a Block,
    part: usize,
}

impl<S: Simd> Lanes<'_, S> {
    #[inline(always)]
    fn get(self, column: &Column) -> Real<S> {
        Real::load(self.simd, column, self.part)
    }

    #[inline(always)]
    fn get3(self, columns: &[Column]) -> [Real<S>; 3] {
        [self.get(&columns[0]), self.get(&columns[1]), self.get(&columns[2])]
    }

    #[inline(always)]
    fn number(self, value: f64) -> Real<S> {
        Real::all(self.simd, value)
    }

    /// Camera coordinates of a point (m).
    #[inline(always)]
    fn in_camera(self, p: [Real<S>; 3]) -> [Real<S>; 3] {
        let (r, o) = (&self.block.rotation, self.get3(&self.block.origin_in_camera));
        [
            dot(self.get3(&r[0..3]), p) + o[0],
            dot(self.get3(&r[3..6]), p) + o[1],
            dot(self.get3(&r[6..9]), p) + o[2],
        ]
    }

    /// Squared residual (px^2); infinite behind the camera.
    #[inline(always)]
    fn squared_error(self, [x, y, z]: [Real<S>; 3]) -> Real<S> {
        let near = self.number(1.0) / z;
        let dx = self.get(&self.block.target[0]) - self.get(&self.block.focal[0]) * (x * near);
        let dy = self.get(&self.block.target[1]) - self.get(&self.block.focal[1]) * (y * near);
        let error = dx.times_plus(dx, dy * dy);
        z.select_above(self.number(0.0), error, self.number(f64::INFINITY))
    }

    /// Square of the depth that turns metres into pixels. A point behind the camera or beside it takes its distance: the
    /// first guess may be that bad and still be mended by the other views.
    #[inline(always)]
    fn squared_depth(self, z: Real<S>, offset: [Real<S>; 3]) -> Real<S> {
        let zero = self.number(0.0);
        let distance2 = dot(offset, offset).or_greater(self.number(1e-18));
        let depth2 = z.select_above(zero, z * z, zero);
        depth2.select_above(self.number(0.05 * 0.05) * distance2, depth2, distance2)
    }
}

/// Runs `f(lanes)` for every vector of every block.
macro_rules! for_each_vector {
    ($simd:expr, $blocks:expr, |$lanes:ident| $body:block) => {
        for block in $blocks {
            for part in 0..LANES / S::F64_LANES {
                let $lanes = Lanes { simd: $simd, block, part };
                $body
            }
        }
    };
}

#[inline(always)]
fn point_in_all<S: Simd>(simd: S, p: [f64; 3]) -> [Real<S>; 3] {
    [Real::all(simd, p[0]), Real::all(simd, p[1]), Real::all(simd, p[2])]
}

/// Sums of a normal system, a lane each.
#[derive(Clone, Copy)]
struct NormalSums<S: Simd>([Real<S>; 9]);

impl<S: Simd> NormalSums<S> {
    #[inline(always)]
    fn zero(simd: S) -> Self {
        Self([Real::all(simd, 0.0); 9])
    }

    /// Adds `j j^T w` and `j e w`.
    #[inline(always)]
    fn add_row(&mut self, j: [Real<S>; 3], weight: Real<S>, error: Real<S>) {
        let weighted = [j[0] * weight, j[1] * weight, j[2] * weight];
        let s = &mut self.0;
        s[0] = weighted[0].times_plus(j[0], s[0]);
        s[1] = weighted[0].times_plus(j[1], s[1]);
        s[2] = weighted[0].times_plus(j[2], s[2]);
        s[3] = weighted[1].times_plus(j[1], s[3]);
        s[4] = weighted[1].times_plus(j[2], s[4]);
        s[5] = weighted[2].times_plus(j[2], s[5]);
        s[6] = weighted[0].times_plus(error, s[6]);
        s[7] = weighted[1].times_plus(error, s[7]);
        s[8] = weighted[2].times_plus(error, s[8]);
    }

    #[inline(always)]
    fn total(self) -> Normal {
        let mut out = Normal::default();
        for i in 0..6 {
            out.a[i] = self.0[i].total();
        }
        for i in 0..3 {
            out.b[i] = self.0[6 + i].total();
        }
        out
    }
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
    fn with_simd<S: Simd>(self, simd: S) -> Normal {
        let (zero, one) = (Real::all(simd, 0.0), Real::all(simd, 1.0));
        let point = point_in_all(simd, self.point);
        let mut sums = NormalSums::zero(simd);
        for_each_vector!(simd, self.blocks, |lanes| {
            let block = lanes.block;
            let (center, ray) = (lanes.get3(&block.center), lanes.get3(&block.ray));
            let observed = lanes.get(&block.weight);
            let weight = if let RayWeights::Plain = self.weights {
                observed
            } else {
                let in_camera = lanes.in_camera(point);
                let offset = [point[0] - center[0], point[1] - center[1], point[2] - center[2]];
                let mut below = lanes.squared_depth(in_camera[2], offset);
                if let RayWeights::Soft(scale) = self.weights {
                    // Behind the camera this is infinite and the weight 0.
                    let share = lanes.squared_error(in_camera) * lanes.number(1.0 / (scale * scale));
                    below = below * (one + share);
                }
                observed * lanes.get(&block.focal[0]) * lanes.get(&block.focal[1]) / below
            };
            // w (I - d d^T) and w (c - d (d.c)).
            let s = &mut sums.0;
            let minus = [zero - ray[0] * weight, zero - ray[1] * weight, zero - ray[2] * weight];
            let along = dot(ray, center);
            s[0] = minus[0].times_plus(ray[0], s[0] + weight);
            s[1] = minus[0].times_plus(ray[1], s[1]);
            s[2] = minus[0].times_plus(ray[2], s[2]);
            s[3] = minus[1].times_plus(ray[1], s[3] + weight);
            s[4] = minus[1].times_plus(ray[2], s[4]);
            s[5] = minus[2].times_plus(ray[2], s[5] + weight);
            s[6] = minus[0].times_plus(along, weight.times_plus(center[0], s[6]));
            s[7] = minus[1].times_plus(along, weight.times_plus(center[1], s[7]));
            s[8] = minus[2].times_plus(along, weight.times_plus(center[2], s[8]));
        });
        sums.total()
    }
}

/// See [`crate::views::Views::reprojection`]; the last result is whether a view that counts has the point behind it.
pub struct ReprojectionPass<'a> {
    pub blocks: &'a [Block],
    pub point: [f64; 3],
}

impl WithSimd for ReprojectionPass<'_> {
    type Output = (Normal, f64, bool);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (Normal, f64, bool) {
        let (zero, one) = (Real::all(simd, 0.0), Real::all(simd, 1.0));
        let point = point_in_all(simd, self.point);
        let (mut sums, mut cost, mut hidden) = (NormalSums::zero(simd), zero, zero);
        for_each_vector!(simd, self.blocks, |lanes| {
            let block = lanes.block;
            let [x, y, z] = lanes.in_camera(point);
            let near = one / z.select_above(zero, z, one);
            let observed = lanes.get(&block.weight);
            let weight = z.select_above(zero, observed, zero);
            hidden = hidden + (observed - weight);
            let away = lanes.get3(&block.rotation[6..9]);
            for (axis, slope) in [(0, x * near), (1, y * near)] {
                let focal = lanes.get(&block.focal[axis]);
                let across = lanes.get3(&block.rotation[3 * axis..3 * axis + 3]);
                let (error, scale) = (lanes.get(&block.target[axis]) - focal * slope, focal * near);
                let jacobian = [
                    scale * (across[0] - slope * away[0]),
                    scale * (across[1] - slope * away[1]),
                    scale * (across[2] - slope * away[2]),
                ];
                sums.add_row(jacobian, weight, error);
                cost = (weight * error).times_plus(error, cost);
            }
        });
        (sums.total(), cost.total(), hidden.total() > 0.0)
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
    fn with_simd<S: Simd>(self, simd: S) {
        let point = point_in_all(simd, self.point);
        for (block, out) in self.blocks.iter().zip(self.errors) {
            for part in 0..LANES / S::F64_LANES {
                let lanes = Lanes { simd, block, part };
                lanes.squared_error(lanes.in_camera(point)).store(out, part);
            }
        }
    }
}

/// See [`crate::views::Views::truncated_cost`].
pub struct TruncatedPass<'a> {
    pub blocks: &'a [Block],
    pub point: [f64; 3],
    pub cut2: f64,
}

impl WithSimd for TruncatedPass<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let point = point_in_all(simd, self.point);
        let (mut cost, cut2) = (Real::all(simd, 0.0), Real::all(simd, self.cut2));
        for_each_vector!(simd, self.blocks, |lanes| {
            let error = lanes.squared_error(lanes.in_camera(point));
            let truncated = cut2.select_above(error, error, cut2);
            cost = lanes.get(&lanes.block.weight).times_plus(truncated, cost);
        });
        cost.total()
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
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let zero = Real::all(simd, 0.0);
        let point = point_in_all(simd, self.point);
        let mut cost = zero;
        for_each_vector!(simd, self.blocks, |lanes| {
            let block = lanes.block;
            let z = lanes.in_camera(point)[2];
            let (ray, center) = (lanes.get3(&block.ray), lanes.get3(&block.center));
            let offset = [point[0] - center[0], point[1] - center[1], point[2] - center[2]];
            let along = dot(ray, offset);
            // The vector, not the difference of squares: that would round to less than nothing.
            let across = [offset[0] - ray[0] * along, offset[1] - ray[1] * along, offset[2] - ray[2] * along];
            let focal2 = lanes.get(&block.focal[0]) * lanes.get(&block.focal[1]);
            let pixels2 = dot(across, across) * focal2 / lanes.squared_depth(z, offset);
            let pixels2 = z.select_above(zero, pixels2, lanes.number(f64::INFINITY));
            let weight = lanes.get(&block.weight);
            cost = cost + weight.select_above(zero, weight * pixels2, zero);
        });
        cost.total()
    }
}
