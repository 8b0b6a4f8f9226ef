//! Real spherical harmonics in the basis and with the signs of 3D Gaussian Splatting.

use ffgs_core::SH_C0;
use glam::Vec3;

const C1: f32 = 0.488_602_5;
const C2: [f32; 5] = [1.092_548_4, -1.092_548_4, 0.315_391_57, -1.092_548_4, 0.546_274_2];
const C3: [f32; 7] =
    [-0.590_043_6, 2.890_611_4, -0.457_045_8, 0.373_176_33, -0.457_045_8, 1.445_305_7, -0.590_043_6];

/// Basis values in direction `d` (unit); entries beyond `degree` are zero.
#[inline(always)]
pub fn basis(degree: usize, d: Vec3) -> [f32; 16] {
    let Vec3 { x, y, z } = d;
    let mut b = [0.0; 16];
    b[0] = SH_C0;
    if degree >= 1 {
        b[1] = -C1 * y;
        b[2] = C1 * z;
        b[3] = -C1 * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[4] = C2[0] * x * y;
        b[5] = C2[1] * y * z;
        b[6] = C2[2] * (2.0 * zz - xx - yy);
        b[7] = C2[3] * x * z;
        b[8] = C2[4] * (xx - yy);
    }
    if degree >= 3 {
        b[9] = C3[0] * y * (3.0 * xx - yy);
        b[10] = C3[1] * x * y * z;
        b[11] = C3[2] * y * (4.0 * zz - xx - yy);
        b[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        b[13] = C3[4] * x * (4.0 * zz - xx - yy);
        b[14] = C3[5] * z * (xx - yy);
        b[15] = C3[6] * x * (xx - 3.0 * yy);
    }
    b
}

/// Partial derivatives of each basis polynomial with respect to the direction's components.
#[inline(always)]
pub(crate) fn basis_gradient(degree: usize, d: Vec3) -> [Vec3; 16] {
    let Vec3 { x, y, z } = d;
    let v = Vec3::new;
    let mut g = [Vec3::ZERO; 16];
    if degree >= 1 {
        g[1] = v(0.0, -C1, 0.0);
        g[2] = v(0.0, 0.0, C1);
        g[3] = v(-C1, 0.0, 0.0);
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        g[4] = C2[0] * v(y, x, 0.0);
        g[5] = C2[1] * v(0.0, z, y);
        g[6] = C2[2] * v(-2.0 * x, -2.0 * y, 4.0 * z);
        g[7] = C2[3] * v(z, 0.0, x);
        g[8] = C2[4] * v(2.0 * x, -2.0 * y, 0.0);
    }
    if degree >= 3 {
        g[9] = C3[0] * v(6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0);
        g[10] = C3[1] * v(y * z, x * z, x * y);
        g[11] = C3[2] * v(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
        g[12] = C3[3] * v(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
        g[13] = C3[4] * v(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
        g[14] = C3[5] * v(2.0 * x * z, -2.0 * y * z, xx - yy);
        g[15] = C3[6] * v(3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0);
    }
    g
}

/// Colour `sum basis * sh + 0.5` before the clamp at 0.
#[inline(always)]
pub(crate) fn colour(basis: &[f32; 16], sh: &[[f32; 3]]) -> Vec3 {
    sh.iter().zip(basis).fold(Vec3::splat(0.5), |c, (&s, &b)| c + b * Vec3::from(s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_agrees_with_finite_differences() {
        let d = Vec3::new(0.48, -0.6, 0.64);
        let g = basis_gradient(3, d);
        for axis in 0..3 {
            let mut step = Vec3::ZERO;
            step[axis] = 1e-2;
            let (hi, lo) = (basis(3, d + step), basis(3, d - step));
            for k in 0..16 {
                let numeric = (hi[k] - lo[k]) / 2e-2;
                assert!((numeric - g[k][axis]).abs() < 1e-3, "k {k} axis {axis}: {numeric} {}", g[k][axis]);
            }
        }
    }
}
