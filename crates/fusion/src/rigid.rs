//! Rigid motions, and their weighted least-squares fit to pairs of points.

use glam::{DQuat, DVec3};
use nalgebra::{Matrix4, SymmetricEigen};

/// A rigid motion about a centre: `x -> rotation (x - centre) + centre + step`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidMotion {
    /// Centre of rotation at t-1 (m).
    pub centre: DVec3,
    /// Rotation from t-1 to t.
    pub rotation: DQuat,
    /// Displacement of the centre (m).
    pub step: DVec3,
}

impl RigidMotion {
    /// Where a point of t-1 is at t (m).
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * (point - self.centre) + self.centre + self.step
    }
}

/// Weighted least-squares rigid motion from `from` to `to` (Kabsch, by Horn's quaternion); `None` without weight.
pub fn fit_rigid(from: &[DVec3], to: &[DVec3], weights: &[f64]) -> Option<RigidMotion> {
    let total: f64 = weights.iter().sum();
    let has_weight = total > 0.0 && total.is_finite();
    if !has_weight {
        return None;
    }
    let mean =
        |points: &[DVec3]| points.iter().zip(weights).fold(DVec3::ZERO, |sum, (&p, &w)| sum + p * w) / total;
    let (centre, target) = (mean(from), mean(to));
    let mut s = [DVec3::ZERO; 3];
    for ((&a, &b), &w) in from.iter().zip(to).zip(weights) {
        let (a, b) = ((a - centre) * w, b - target);
        s = [s[0] + b * a.x, s[1] + b * a.y, s[2] + b * a.z];
    }
    let [sx, sy, sz] = s;
    // Horn 1987, equation for N: its largest eigenvector is the quaternion (w, x, y, z).
    #[rustfmt::skip]
    let n = Matrix4::new(
        sx.x + sy.y + sz.z, sy.z - sz.y, sz.x - sx.z, sx.y - sy.x,
        sy.z - sz.y, sx.x - sy.y - sz.z, sx.y + sy.x, sz.x + sx.z,
        sz.x - sx.z, sx.y + sy.x, sy.y - sx.x - sz.z, sy.z + sz.y,
        sx.y - sy.x, sz.x + sx.z, sy.z + sz.y, sz.z - sx.x - sy.y,
    );
    if !n.iter().all(|v| v.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::new(n);
    let q = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    let rotation = DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize();
    let rotation = if rotation.w < 0.0 { -rotation } else { rotation };
    Some(RigidMotion { centre, rotation, step: target - centre })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_a_rotation_and_translation() {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1);
        let from: Vec<DVec3> =
            (0..9).map(|i| DVec3::new(f64::from(i % 3), f64::from(i / 3), f64::from(i * i % 5))).collect();
        let to: Vec<DVec3> = from.iter().map(|&p| rotation * p + DVec3::new(5.0, -1.0, 2.0)).collect();
        let motion = fit_rigid(&from, &to, &[1.0; 9]).unwrap();
        assert!(from.iter().zip(&to).all(|(&a, &b)| (motion.apply(a) - b).length() < 1e-12));
        assert!(fit_rigid(&from, &to, &[0.0; 9]).is_none());
    }
}
