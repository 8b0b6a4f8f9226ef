//! The part of the world that cameras look at.

use ffgs_core::Camera;
use glam::DVec3;

/// An axis-aligned box in the world (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Region {
    pub low: DVec3,
    pub high: DVec3,
}

impl Region {
    /// Multiple of `ray` (m) after which a line from `eye` has left the sphere of `radii` half sides about the middle, or is nearest to it.
    pub(crate) fn exit(self, eye: DVec3, ray: DVec3, radii: f64) -> f64 {
        let to_middle = (self.low + self.high) / 2.0 - eye;
        let radius = radii * (self.high - self.low).x / 2.0;
        let (along, square) = (to_middle.dot(ray), ray.length_squared());
        let inside = along * along - square * (to_middle.length_squared() - radius * radius);
        (along + inside.max(0.0).sqrt()) / square
    }
}

/// The part of the world that the cameras look at: around the point nearest to all optical axes, as far as the
/// cameras are from it. Parallel cameras have no such point; then it is five times as far ahead
/// as the outermost is from their middle.
pub(crate) fn common_region(cameras: &[Camera]) -> Region {
    let centres: Vec<DVec3> = cameras.iter().map(Camera::center).collect();
    let axes: Vec<DVec3> = cameras.iter().map(|c| c.rotation().transpose() * DVec3::Z).collect();
    let mean = centres.iter().sum::<DVec3>() / centres.len() as f64;
    let spread = centres.iter().map(|c| c.distance(mean)).fold(0.0, f64::max);
    let middle = nearest_to_axes(&centres, &axes).filter(|m| {
        let ahead = centres.iter().zip(&axes).filter(|(c, a)| (*m - **c).dot(**a) > 0.0).count();
        ahead * 2 > cameras.len() && m.distance(mean) < 10.0 * spread
    });
    let ahead = axes.iter().sum::<DVec3>().normalize_or(DVec3::Z);
    let middle = middle.unwrap_or(mean + ahead * 5.0 * spread);
    let mut distances: Vec<f64> = centres.iter().map(|c| c.distance(middle)).collect();
    distances.sort_by(f64::total_cmp);
    let radius = distances[distances.len() / 2];
    Region { low: middle - radius, high: middle + radius }
}

/// Least squares: the sum of I - a aᵀ over the axes, solved; `None` for axes that are nearly parallel.
fn nearest_to_axes(centres: &[DVec3], axes: &[DVec3]) -> Option<DVec3> {
    let (mut sum, mut right) = (glam::DMat3::ZERO, DVec3::ZERO);
    for (c, a) in centres.iter().zip(axes) {
        let across = glam::DMat3::IDENTITY - glam::DMat3::from_cols(*a * a.x, *a * a.y, *a * a.z);
        sum += across;
        right += across * *c;
    }
    let n = centres.len() as f64;
    // The determinant of the mean is sin² of the axes' angles, about.
    ((sum * (1.0 / n)).determinant() > 1e-3).then(|| sum.inverse() * right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::DMat4;

    #[test]
    fn parallel_cameras_have_a_region_ahead_of_them() {
        let size = ImageSize { width: 160, height: 120 };
        let intrinsics = Intrinsics { fx: 150.0, fy: 150.0, cx: 80.0, cy: 60.0 };
        let at = |x: f64| {
            Camera::new(intrinsics, DMat4::from_translation(DVec3::new(-x, 0.0, 0.0)), size).unwrap()
        };
        let region = common_region(&[at(-0.5), at(0.0), at(0.5)]);
        let middle = (region.low + region.high) / 2.0;
        assert!(middle.x.abs() < 1e-9 && (middle.z - 2.5).abs() < 1e-9);
    }
}
