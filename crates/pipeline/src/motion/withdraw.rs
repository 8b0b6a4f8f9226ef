//! What left an image was found by no tracker: its matches lie on what is still to be seen. Beyond the paper.

use super::MotionInput;
use ffgs_core::Observations;
use glam::DVec3;
use rayon::prelude::*;

/// Takes back the observations of Gaussians in views that cannot show them at t, judged by where they are expected
/// then (`expected`, N, m); returns how many. A car that leaves the image on one side otherwise seems to slow down.
pub fn withdraw(input: &MotionInput, expected: &[DVec3], observations: &mut [Observations]) -> usize {
    let shown = |view: usize, place: DVec3| {
        let camera = &input.now[view].camera;
        camera.project(place).is_some_and(|p| camera.shows(p.pixel))
    };
    let mut withdrawn = 0;
    for o in observations {
        let rows = o.weights.par_chunks_mut(expected.len().max(1)).enumerate();
        let in_row = |(view, weights): (usize, &mut [f64])| {
            let seen = weights.iter_mut().zip(expected).filter(|(weight, _)| **weight > 0.0);
            seen.filter(|(_, place)| !shown(view, **place)).map(|(weight, _)| *weight = 0.0).count()
        };
        withdrawn += rows.map(in_row).sum::<usize>();
    }
    withdrawn
}
