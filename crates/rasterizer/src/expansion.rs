//! Where the projection of a Gaussian is linearised (docs/adr/0064-projections-are-linear-where-they-are-seen.md).
//!
//! At its centre, as in EWA splatting, while the centre lies inside the widened frustum. Else within the part that is seen: a kerb that
//! begins beside the camera is as wide in the image as it is there, and not as wide as it would be beside the lens. Cut off by
//! the side of the frustum that the centre lies `m` standard deviations outside of, the Gaussian has its mean
//! `phi(m) / Phi(-m)` standard deviations from its centre. [`to_mean`] follows that from 0 on, where nothing may jump.

use crate::constants::LEAST_VARIANCE;
use crate::pinhole::PinholeF32;
use glam::{Mat3, Vec3};

/// The point of linearisation, `centre - rest`, with what its derivative needs.
pub(crate) struct Expansion {
    /// The point in the camera (m).
    pub(crate) point: Vec3,
    /// From the point to the centre, camera axes (m); 0 inside the frustum.
    pub(crate) rest: Vec3,
    /// Normal of the frustum's side, camera axes; not of unit length.
    normal: Vec3,
    /// `shape^T R^T normal`.
    scaled: Vec3,
    /// Covariance times normal, camera axes.
    along: Vec3,
    /// Variance along the normal.
    variance: f32,
    /// Distance of the centre from the side, in units of the normal.
    distance: f32,
}

/// Derivatives with respect to what the point of linearisation depends on.
pub(crate) struct ExpansionGradient {
    /// With respect to the centre in the camera.
    pub(crate) centre: Vec3,
    /// With respect to `rotation * diag(scales)`.
    pub(crate) shape: Mat3,
    /// With respect to the camera's rotation: the sum of the outer products of these pairs, camera axes with world axes.
    pub(crate) rotation: [(Vec3, Vec3); 2],
}

/// From the side to the mean of what lies behind it: factor of the distance, and its derivative, for the square of the distance in
/// standard deviations. Within 0.1 standard deviations of the inverse Mills ratio from 0.8 on; at 0 it is 0 instead of 0.8.
#[inline(always)]
fn to_mean(squared: f32) -> (f32, f32) {
    let damped = 1.0 / (1.0 + squared);
    (1.0 + damped, -damped * damped)
}

impl Expansion {
    /// Of a Gaussian at `centre` (m, camera axes) of `shape`, `rotation * diag(scales)` in world axes. No branches: see
    /// [`ewa`](crate::projection::ewa).
    #[inline(always)]
    pub(crate) fn new(centre: Vec3, shape: Mat3, camera: &PinholeF32) -> Self {
        let (sx, sy) = (centre.x / centre.z, centre.y / centre.z);
        let (x, y) = (sx.max(camera.low[0]).min(camera.high[0]), sy.max(camera.low[1]).min(camera.high[1]));
        let normals = [Vec3::new(1.0, 0.0, -x), Vec3::new(0.0, 1.0, -y)];
        let distances = [
            if sx == x { 0.0 } else { camera.beyond * (centre.x - x * centre.z) },
            if sy == y { 0.0 } else { camera.beyond * (centre.y - y * centre.z) },
        ];
        let to_axes = shape.transpose();
        let back = camera.rotation.transpose();
        let scaled = [to_axes * (back * normals[0]), to_axes * (back * normals[1])];
        let variances =
            [scaled[0].length_squared().max(LEAST_VARIANCE), scaled[1].length_squared().max(LEAST_VARIANCE)];
        let sideways =
            distances[0] * distances[0] * variances[1] >= distances[1] * distances[1] * variances[0];
        let pick = |a: Vec3, b: Vec3| Vec3::select(glam::BVec3::splat(sideways), a, b);
        let normal = pick(normals[0], normals[1]);
        let scaled = pick(scaled[0], scaled[1]);
        let variance = if sideways { variances[0] } else { variances[1] };
        let distance = if sideways { distances[0] } else { distances[1] };
        let along = camera.rotation * (shape * scaled);
        let (factor, _) = to_mean(distance * distance / variance);
        let rest = along * (factor * distance / variance);
        Self { point: centre - rest, rest, normal, scaled, along, variance, distance }
    }

    /// From the derivatives with respect to point and rest.
    #[inline(always)]
    pub(crate) fn gradient(
        &self,
        point: Vec3,
        rest: Vec3,
        shape: Mat3,
        camera: &PinholeF32,
    ) -> ExpansionGradient {
        let d_rest = rest - point;
        let ratio = self.distance / self.variance;
        let squared = self.distance * ratio;
        let (factor, slope) = to_mean(squared);
        let d_share = d_rest.dot(self.along);
        let d_distance = if self.distance == 0.0 {
            0.0
        } else {
            d_share * (factor + 2.0 * slope * squared) / self.variance
        };
        let d_variance = if self.distance == 0.0 {
            0.0
        } else {
            -d_share * ratio * (factor + slope * squared) / self.variance
        };
        let d_along = d_rest * (factor * ratio);
        let back = camera.rotation.transpose();
        let (d_along_world, normal_world) = (back * d_along, back * self.normal);
        let d_scaled = shape.transpose() * d_along_world + self.scaled * (2.0 * d_variance);
        let outer = |a: Vec3, b: Vec3| Mat3::from_cols(a * b.x, a * b.y, a * b.z);
        ExpansionGradient {
            centre: point + self.normal * d_distance,
            shape: outer(d_along_world, self.scaled) + outer(normal_world, d_scaled),
            rotation: [(d_along, shape * self.scaled), (self.normal, shape * d_scaled)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::to_mean;

    /// Mean of a standard normal variable that exceeds `least`, by summation.
    fn mean_above(least: f64) -> f64 {
        let values = || (0..20_000).map(|i| least + (f64::from(i) + 0.5) * 5e-4);
        let density = |x: f64| (-0.5 * (x * x - least * least)).exp();
        values().map(|x| x * density(x)).sum::<f64>() / values().map(density).sum::<f64>()
    }

    #[test]
    fn the_point_is_the_mean_of_what_lies_behind_the_side() {
        for deviations in [0.8, 1.0, 1.5, 2.0, 3.0, 5.0] {
            let found = deviations * f64::from(to_mean((deviations * deviations) as f32).0);
            assert!((found - mean_above(deviations)).abs() < 0.1, "{deviations}: {found}");
        }
    }
}
