use glam::{DMat3, DVec3};

/// A symmetric 3x3 normal system `A x = b`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Normal {
    /// `A`: xx, xy, xz, yy, yz, zz.
    pub a: [f64; 6],
    pub b: [f64; 3],
}

/// Pivots below this fraction of the diagonal are rounding, not information.
const PIVOT: f64 = 1e-13;

/// `A = L D L^T` with a unit diagonal in L.
struct Factors {
    below: [f64; 3],
    inverse: [f64; 3],
}

impl Normal {
    /// `A x = b`; `None` when A is not positive definite to working precision.
    pub fn solve(&self) -> Option<DVec3> {
        Some(self.factors()?.solve(DVec3::from(self.b)))
    }

    /// `A^-1`, as [`Normal::solve`].
    pub fn inverse(&self) -> Option<DMat3> {
        let factors = self.factors()?;
        Some(DMat3::from_cols(factors.solve(DVec3::X), factors.solve(DVec3::Y), factors.solve(DVec3::Z)))
    }

    /// The same system with the diagonal grown by a share of itself.
    pub fn damped(mut self, damping: f64) -> Self {
        for k in [0, 3, 5] {
            self.a[k] *= 1.0 + damping;
        }
        self
    }

    /// Pivots are compared with their diagonal entries: units and weights do not decide what counts as singular.
    fn factors(&self) -> Option<Factors> {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        if !(xx > 0.0 && yy > 0.0 && zz > 0.0 && xx + yy + zz < f64::INFINITY) {
            return None;
        }
        let inverse_x = 1.0 / xx;
        let (yx, zx) = (xy * inverse_x, xz * inverse_x);
        let y = yy - yx * xy;
        if !(y > PIVOT * yy) {
            return None;
        }
        let inverse_y = 1.0 / y;
        let rest = yz - zx * xy;
        let zy = rest * inverse_y;
        let z = zz - zx * xz - zy * rest;
        (z > PIVOT * zz).then(|| Factors { below: [yx, zx, zy], inverse: [inverse_x, inverse_y, 1.0 / z] })
    }
}

impl Factors {
    fn solve(&self, b: DVec3) -> DVec3 {
        let [yx, zx, zy] = self.below;
        let y = b.y - yx * b.x;
        let z = (b.z - zx * b.x - zy * y) * self.inverse[2];
        let y = y * self.inverse[1] - zy * z;
        DVec3::new(b.x * self.inverse[0] - yx * y - zx * z, y, z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum_of_outer_products(vectors: &[DVec3]) -> Normal {
        let mut normal = Normal::default();
        for v in vectors {
            let products = [v.x * v.x, v.x * v.y, v.x * v.z, v.y * v.y, v.y * v.z, v.z * v.z];
            normal.a.iter_mut().zip(products).for_each(|(a, p)| *a += p);
        }
        normal
    }

    #[test]
    fn the_inverse_is_an_inverse_or_refused() {
        let vectors = [DVec3::new(1.0, 2.0, -0.5), DVec3::new(0.1, -1.0, 0.3), DVec3::new(4.0, 0.2, 0.7)];
        let normal = Normal { b: [1.0, -2.0, 3.0], ..sum_of_outer_products(&vectors) };
        let [xx, xy, xz, yy, yz, zz] = normal.a;
        let m = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
        let error = m * normal.inverse().unwrap() - DMat3::IDENTITY;
        assert!(error.to_cols_array().iter().all(|v| v.abs() < 1e-12));
        assert!((m * normal.solve().unwrap() - DVec3::from(normal.b)).length() < 1e-12);
        assert!(sum_of_outer_products(&vectors[..2]).inverse().is_none());
        assert!(Normal { a: [f64::NAN; 6], b: [0.0; 3] }.solve().is_none());
    }
}
