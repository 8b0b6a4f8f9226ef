//! An origin near the cameras: positions are kept as f32, which has seven digits for all of them together.

use ffgs_core::{Camera, RigExtent};
use glam::DVec3;

/// Zero, or for cameras far from it a round place near them (m).
pub(crate) fn near(cameras: impl Iterator<Item = Camera>) -> DVec3 {
    let centres: Vec<DVec3> = cameras.map(|camera| camera.center()).collect();
    let rig = RigExtent::of(&centres);
    if !(rig.radius > 0.0 && rig.is_far_from_zero()) {
        return DVec3::ZERO;
    }
    // A multiple of a power of two: what has it taken off or added to it keeps its digits.
    let unit = rig.radius.log2().floor().exp2();
    (rig.middle / unit).round() * unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::DMat4;

    fn ring(middle: DVec3) -> impl Iterator<Item = Camera> {
        let size = ImageSize { width: 16, height: 8 };
        let intrinsics = Intrinsics { fx: 16.0, fy: 16.0, cx: 8.0, cy: 4.0 };
        let at = move |i: usize| middle + 10.0 * DVec3::new((i as f64).cos(), (i as f64).sin(), 0.0);
        (0..6).map(move |i| Camera::new(intrinsics, DMat4::from_translation(-at(i)), size).unwrap())
    }

    #[test]
    fn only_what_is_far_away_is_brought_near() {
        assert_eq!(near(ring(DVec3::new(300.0, -200.0, 5.0))), DVec3::ZERO);
        assert_eq!(near(std::iter::empty()), DVec3::ZERO);
        let utm = DVec3::new(500_000.0, 4_000_000.0, 80.0);
        let origin = near(ring(utm));
        assert!(origin.distance(utm) < 20.0 && origin % 8.0 == DVec3::ZERO, "{origin}");
    }

    #[test]
    fn a_camera_sees_the_same_from_a_nearer_origin() {
        let utm = DVec3::new(500_000.0, 4_000_000.0, 80.0);
        let camera = ring(utm).next().unwrap();
        let place = DVec3::new(1.5, -2.0, 30.0);
        let (far, near) = (camera.project(utm + place), camera.relative_to(utm).project(place));
        assert!(far.unwrap().pixel.distance(near.unwrap().pixel) < 1e-6);
    }
}
