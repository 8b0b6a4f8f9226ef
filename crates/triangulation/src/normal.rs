//! Symmetric 3x3 normal systems, one per SIMD lane.

use crate::simd::{F64s, LaneMask, dot};
use pulp::Simd;

/// A symmetric 3x3 normal system `A x = b` in every lane.
#[derive(Clone, Copy)]
pub(crate) struct Normal<S: Simd> {
    /// `A`: xx, xy, xz, yy, yz, zz.
    pub a: [F64s<S>; 6],
    pub b: [F64s<S>; 3],
}

/// A determinant below this fraction of a third of the trace cubed, the largest it can be, is rounding and not information.
/// A pivot alone does not tell: after a small one those that follow have lost as many digits.
const SINGULAR: f64 = 1e-13;

/// `A = L D L^T` with a unit diagonal in L.
struct Factors<S: Simd> {
    below: [F64s<S>; 3],
    inverse: [F64s<S>; 3],
    sound: LaneMask<S>,
}

impl<S: Simd> Normal<S> {
    #[inline(always)]
    pub(crate) fn zero(simd: S) -> Self {
        Self { a: [F64s::all(simd, 0.0); 6], b: [F64s::all(simd, 0.0); 3] }
    }

    /// Adds `j j^T w` and `j e`.
    #[inline(always)]
    pub(crate) fn add_row(&mut self, j: [F64s<S>; 3], weight: F64s<S>, error: F64s<S>) {
        let weighted = [j[0] * weight, j[1] * weight, j[2] * weight];
        let (a, b) = (&mut self.a, &mut self.b);
        a[0] = weighted[0].mul_add(j[0], a[0]);
        a[1] = weighted[0].mul_add(j[1], a[1]);
        a[2] = weighted[0].mul_add(j[2], a[2]);
        a[3] = weighted[1].mul_add(j[1], a[3]);
        a[4] = weighted[1].mul_add(j[2], a[4]);
        a[5] = weighted[2].mul_add(j[2], a[5]);
        for k in 0..3 {
            b[k] = j[k].mul_add(error, b[k]);
        }
    }

    /// Adds `w (I - d d^T)` and `w (I - d d^T) c`: the lines through `c` along the unit vectors `d`.
    #[inline(always)]
    pub(crate) fn add_line(&mut self, d: [F64s<S>; 3], c: [F64s<S>; 3], weight: F64s<S>) {
        let (a, b) = (&mut self.a, &mut self.b);
        let weighted = [d[0] * weight, d[1] * weight, d[2] * weight];
        let along = dot(d, c);
        a[0] = weighted[0].neg_mul_add(d[0], a[0] + weight);
        a[1] = weighted[0].neg_mul_add(d[1], a[1]);
        a[2] = weighted[0].neg_mul_add(d[2], a[2]);
        a[3] = weighted[1].neg_mul_add(d[1], a[3] + weight);
        a[4] = weighted[1].neg_mul_add(d[2], a[4]);
        a[5] = weighted[2].neg_mul_add(d[2], a[5] + weight);
        for k in 0..3 {
            b[k] = weighted[k].neg_mul_add(along, weight.mul_add(c[k], b[k]));
        }
    }

    /// `A x = b`, and where A is positive definite to working precision.
    #[inline(always)]
    pub(crate) fn solve(&self, simd: S) -> ([F64s<S>; 3], LaneMask<S>) {
        let factors = self.factors(simd);
        (factors.solve(self.b), factors.sound)
    }

    /// `A^-1` (xx, xy, xz, yy, yz, zz), as [`Normal::solve`].
    #[inline(always)]
    pub(crate) fn inverse(&self, simd: S) -> ([F64s<S>; 6], LaneMask<S>) {
        let (zero, one) = (F64s::all(simd, 0.0), F64s::all(simd, 1.0));
        let factors = self.factors(simd);
        let (x, y) = (factors.solve([one, zero, zero]), factors.solve([zero, one, zero]));
        let z = factors.solve([zero, zero, one]);
        ([x[0], y[0], z[0], y[1], z[1], z[2]], factors.sound)
    }

    /// The same system with the diagonal grown by a share of itself.
    #[inline(always)]
    pub(crate) fn damped(mut self, simd: S, damping: F64s<S>) -> Self {
        for k in [0, 3, 5] {
            self.a[k] = self.a[k] * (F64s::all(simd, 1.0) + damping);
        }
        self
    }

    /// `yes` where true, elsewhere `no`.
    #[inline(always)]
    pub(crate) fn select(place: LaneMask<S>, yes: Self, no: Self) -> Self {
        let mut out = no;
        for k in 0..6 {
            out.a[k] = place.select(yes.a[k], no.a[k]);
        }
        out.b = place.select3(yes.b, no.b);
        out
    }

    /// The determinant is compared with the trace: units and weights do not decide what counts as singular.
    #[inline(always)]
    fn factors(&self, simd: S) -> Factors<S> {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let (zero, one) = (F64s::all(simd, 0.0), F64s::all(simd, 1.0));
        let trace = xx + yy + zz;
        let inverse_x = one / xx;
        let (yx, zx) = (xy * inverse_x, xz * inverse_x);
        let y = yy - yx * xy;
        let inverse_y = one / y;
        let rest = yz - zx * xy;
        let zy = rest * inverse_y;
        let z = zz - zx * xz - zy * rest;
        let least = F64s::all(simd, SINGULAR / 27.0) * trace * trace * trace;
        let sound = xx.gt(zero) & y.gt(zero) & z.gt(zero) & (xx * y * z).gt(least) & least.finite();
        Factors { below: [yx, zx, zy], inverse: [inverse_x, inverse_y, one / z], sound }
    }
}

impl<S: Simd> Factors<S> {
    #[inline(always)]
    fn solve(&self, b: [F64s<S>; 3]) -> [F64s<S>; 3] {
        let [yx, zx, zy] = self.below;
        let y = b[1] - yx * b[0];
        let z = (b[2] - zx * b[0] - zy * y) * self.inverse[2];
        let y = y * self.inverse[1] - zy * z;
        [b[0] * self.inverse[0] - yx * y - zx * z, y, z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::all3;
    use glam::{DMat3, DVec3};
    use pulp::Scalar;

    fn sum_of_outer_products(vectors: &[DVec3]) -> Normal<Scalar> {
        let simd = Scalar::new();
        let mut normal = Normal::zero(simd);
        let (zero, one) = (F64s::all(simd, 0.0), F64s::all(simd, 1.0));
        vectors.iter().for_each(|&v| normal.add_row(all3(simd, v), one, zero));
        normal
    }

    fn symmetric(a: [F64s<Scalar>; 6]) -> DMat3 {
        let [xx, xy, xz, yy, yz, zz] = a.map(|v| v.lane(0));
        DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
    }

    #[test]
    fn the_inverse_is_an_inverse_or_refused() {
        let simd = Scalar::new();
        let vectors = [DVec3::new(1.0, 2.0, -0.5), DVec3::new(0.1, -1.0, 0.3), DVec3::new(4.0, 0.2, 0.7)];
        let b = DVec3::new(1.0, -2.0, 3.0);
        let normal = Normal { b: all3(simd, b), ..sum_of_outer_products(&vectors) };
        let (inverse, sound) = normal.inverse(simd);
        let error = symmetric(normal.a) * symmetric(inverse) - DMat3::IDENTITY;
        assert!(sound.any() && error.to_cols_array().iter().all(|v| v.abs() < 1e-12));
        let x = DVec3::from(normal.solve(simd).0.map(|v| v.lane(0)));
        assert!((symmetric(normal.a) * x - b).length() < 1e-12);
        assert!(!sum_of_outer_products(&vectors[..2]).inverse(simd).1.any());
        let nan = Normal { a: [F64s::all(simd, f64::NAN); 6], ..normal };
        assert!(!nan.solve(simd).1.any());
    }
}
