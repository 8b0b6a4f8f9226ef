//! Trackers cannot match points that left the image: their matches lie on something that is still visible. So observations that are
//! expected outside the image are dropped. Beyond the paper.

use ffgs_core::{Camera, Observations};
use glam::DVec3;
use rayon::prelude::*;

/// Takes back the observations of Gaussians in views that cannot show them at t, judged by where they are expected
/// then (`expected`, N, m; `cameras`, V, at t); returns how many. A car that leaves the image on one side otherwise seems
/// to slow down.
pub(crate) fn withdraw(cameras: &[Camera], expected: &[DVec3], observations: &mut [Observations]) -> usize {
    let shown = |camera: &Camera, place: DVec3| camera.project(place).is_some_and(|p| camera.shows(p.pixel));
    let mut withdrawn = 0;
    for o in observations {
        let in_row = |(weights, camera): (&mut [f64], &Camera)| {
            let seen = weights.iter_mut().zip(expected).filter(|(weight, _)| **weight > 0.0);
            seen.filter(|(_, place)| !shown(camera, **place)).map(|(weight, _)| *weight = 0.0).count()
        };
        let rows = o.weights.par_chunks_mut(expected.len().max(1)).zip(cameras);
        withdrawn += rows.map(in_row).sum::<usize>();
    }
    withdrawn
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::DMat4;

    /// Looks along z from the origin: 100 px wide, one pixel per metre at 100 m.
    fn camera() -> Camera {
        let size = ImageSize { width: 100, height: 50 };
        Camera::new(Intrinsics { fx: 100.0, fy: 100.0, cx: 50.0, cy: 25.0 }, DMat4::IDENTITY, size).unwrap()
    }

    #[test]
    fn only_what_lies_outside_an_image_is_withdrawn_there() {
        let at = |x: f64| DVec3::new(x, 0.0, 100.0);
        let behind = DVec3::new(0.0, 0.0, -5.0);
        let expected = [at(0.0), at(49.0), at(51.0), behind, DVec3::NAN];
        let mut seen = Observations::unobserved(2, expected.len());
        seen.weights.fill(2.0);
        // The second camera stands 10 m to the right: it still shows what the first has lost.
        let mut shift = DMat4::IDENTITY;
        shift.w_axis.x = -10.0;
        let right = Camera::new(camera().intrinsics(), shift, camera().size()).unwrap();
        let mut both = [seen.clone(), seen];
        both[1].weights[2] = 0.0;
        let withdrawn = withdraw(&[camera(), right], &expected, &mut both);
        assert_eq!(both[0].weights, [2.0, 2.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 0.0, 0.0]);
        assert_eq!(both[1].weights, both[0].weights);
        assert_eq!(withdrawn, 5 + 4);
    }
}
