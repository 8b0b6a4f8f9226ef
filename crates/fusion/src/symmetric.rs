//! Symmetric 3x3 matrices: six numbers instead of nine, and an inverse that stays symmetric.

use glam::{DMat3, DVec3};
use std::ops::{Add, AddAssign, Mul};

/// A symmetric matrix by its upper triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Symmetric {
    pub xx: f64,
    pub xy: f64,
    pub xz: f64,
    pub yy: f64,
    pub yz: f64,
    pub zz: f64,
}

impl Symmetric {
    /// `value` times the identity.
    pub fn scalar(value: f64) -> Self {
        Self { xx: value, yy: value, zz: value, ..Self::default() }
    }

    /// `v` times its transpose.
    pub fn outer(v: DVec3) -> Self {
        Self { xx: v.x * v.x, xy: v.x * v.y, xz: v.x * v.z, yy: v.y * v.y, yz: v.y * v.z, zz: v.z * v.z }
    }

    /// By cofactors; not finite where the matrix is singular.
    pub fn inverse(self) -> Self {
        let Self { xx, xy, xz, yy, yz, zz } = self;
        let (a, b, c) = (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy);
        let cofactors =
            Self { xx: a, xy: b, xz: c, yy: xx * zz - xz * xz, yz: xy * xz - xx * yz, zz: xx * yy - xy * xy };
        cofactors * (xx * a + xy * b + xz * c).recip()
    }

    /// `v . self v`.
    pub fn quadratic(self, v: DVec3) -> f64 {
        v.dot(self * v)
    }

    pub fn trace(self) -> f64 {
        self.xx + self.yy + self.zz
    }

    pub fn is_finite(self) -> bool {
        self.to_array().iter().all(|v| v.is_finite())
    }

    /// xx, xy, xz, yy, yz, zz.
    pub fn to_array(self) -> [f64; 6] {
        [self.xx, self.xy, self.xz, self.yy, self.yz, self.zz]
    }
}

impl From<DMat3> for Symmetric {
    /// The symmetric part.
    fn from(m: DMat3) -> Self {
        let mean = |a: f64, b: f64| 0.5 * (a + b);
        Self {
            xx: m.x_axis.x,
            xy: mean(m.x_axis.y, m.y_axis.x),
            xz: mean(m.x_axis.z, m.z_axis.x),
            yy: m.y_axis.y,
            yz: mean(m.y_axis.z, m.z_axis.y),
            zz: m.z_axis.z,
        }
    }
}

impl From<Symmetric> for DMat3 {
    fn from(m: Symmetric) -> Self {
        DMat3::from_cols(
            DVec3::new(m.xx, m.xy, m.xz),
            DVec3::new(m.xy, m.yy, m.yz),
            DVec3::new(m.xz, m.yz, m.zz),
        )
    }
}

impl Add for Symmetric {
    type Output = Self;

    fn add(self, o: Self) -> Self {
        Self {
            xx: self.xx + o.xx,
            xy: self.xy + o.xy,
            xz: self.xz + o.xz,
            yy: self.yy + o.yy,
            yz: self.yz + o.yz,
            zz: self.zz + o.zz,
        }
    }
}

impl AddAssign for Symmetric {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Mul<f64> for Symmetric {
    type Output = Self;

    fn mul(self, s: f64) -> Self {
        Self {
            xx: self.xx * s,
            xy: self.xy * s,
            xz: self.xz * s,
            yy: self.yy * s,
            yz: self.yz * s,
            zz: self.zz * s,
        }
    }
}

impl Mul<DVec3> for Symmetric {
    type Output = DVec3;

    fn mul(self, v: DVec3) -> DVec3 {
        DVec3::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_product_and_conversion_are_those_of_the_full_matrix() {
        let full = DMat3::from_cols_array(&[4.0, 1.0, -0.5, 1.0, 3.0, 0.7, -0.5, 0.7, 2.0]);
        let m = Symmetric::from(full);
        assert_eq!(DMat3::from(m), full);
        assert!((DMat3::from(m.inverse()) - full.inverse()).to_cols_array().iter().all(|e| e.abs() < 1e-15));
        let v = DVec3::new(0.3, -2.0, 1.5);
        assert!((m * v - full * v).length() < 1e-15 && (m.quadratic(v) - v.dot(full * v)).abs() < 1e-14);
        assert_eq!(m.trace(), 9.0);
        assert!((DMat3::from(Symmetric::outer(v)) * DVec3::X - v * v.x).length() < 1e-15);
        assert!(!Symmetric::default().inverse().is_finite());
    }
}
