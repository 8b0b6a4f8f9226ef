//! Points where nothing was matched: pixels at depths that continue those of the matched points around them.

use crate::free_space::FreeSpace;
use crate::ground::Ground;
use crate::region::{Region, common_region};
use crate::stereo::StereoPoint;
use crate::surfaces::Surfaces;
use crate::thinning::evenly;
use crate::views::View;
use ffgs_core::Camera;
use glam::DVec2;
use rayon::prelude::*;
use std::iter::successors;

/// Points of the background that are made at most, over all views, and of the foreground.
const STILL: usize = 7_000;
const MOVING: usize = 4_000;

/// Radii of what the cameras look at, beyond which a sample is moved that other views look through: its own view shows something there, and they do
/// not see where it is. Cameras stand about one radius from the middle, so a wall that one sees behind another is farther.
const BEYOND: f64 = 1.5;
/// Depths that are tried there: each by this factor behind the one before, none so many times as far as its surroundings say.
const STEP: f64 = 1.05;
const FARTHEST: f64 = 4.0;

/// Points of the background.
pub(crate) struct Still {
    pub points: Vec<StereoPoint>,
    /// How many of them were moved behind what other views look through.
    pub moved: usize,
}

/// Pixels of every view, outside its mask, at depths that continue those of the matched points; where there are too few, at
/// depths from a quarter to four times that of the scene. Those that other views look through stand farther back.
pub(crate) fn background(
    views: &[View],
    matched: &[StereoPoint],
    space: &FreeSpace,
    ground: Option<&Ground>,
) -> Still {
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let region = common_region(&cameras);
    let per_view = STILL.div_ceil(views.len());
    let of_view = |view: &View| {
        let surfaces = Surfaces::still(view, matched, ground);
        let samples = (0..per_view).filter_map(|i| sample(view, i, surfaces.as_ref(), region));
        let placed = |from: StereoPoint| Some((from, behind_the_air(view, from, space, region)?));
        samples.filter_map(placed).collect::<Vec<_>>()
    };
    let placed = views.par_iter().map(of_view).collect::<Vec<_>>().concat();
    let moved = placed.iter().filter(|(from, to)| to.position != from.position).count();
    Still { points: placed.into_iter().map(|(_, to)| to).collect(), moved }
}

/// Pixels of the mask of a view, one of `views`, at depths that continue those of the points that were `matched` on the foreground; none
/// where too few of them are seen.
pub(crate) fn foreground(view: &View, views: usize, matched: &[StereoPoint]) -> Vec<StereoPoint> {
    let (Some(surfaces), Some(mask)) = (Surfaces::moving(view, matched), &view.mask) else {
        return Vec::new();
    };
    let width = view.camera.size().width;
    let inside: Vec<usize> = (0..mask.data().len()).filter(|&i| mask.data()[i] > 0).collect();
    let point = |i: usize| {
        let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let colour = view.colour(pixel);
        StereoPoint { position: view.at_depth(pixel, 1.0 / surfaces.inverse_depth(pixel, colour)), colour }
    };
    evenly(inside, MOVING.div_ceil(views)).into_par_iter().map(point).collect()
}

/// The `i`-th sample of a view: a low-discrepancy pixel, so that few samples cover the picture.
fn sample(view: &View, i: usize, surfaces: Option<&Surfaces>, region: Region) -> Option<StereoPoint> {
    let size = view.camera.size();
    let pixel = DVec2::new(halton(i, 2) * size.width as f64, halton(i, 3) * size.height as f64);
    if view.is_foreground(pixel) {
        return None;
    }
    let colour = view.colour(pixel);
    let depth = if let Some(surfaces) = surfaces {
        1.0 / surfaces.inverse_depth(pixel, colour)
    } else {
        let distance = view.camera.center().distance((region.low + region.high) / 2.0);
        distance * 4.0_f64.powf(2.0 * halton(i, 5) - 1.0)
    };
    Some(StereoPoint { position: view.at_depth(pixel, depth), colour })
}

/// A sample where no majority of views denies it: at its own depth, or else at the first one beyond what the cameras look at. `None` where they
/// deny it everywhere.
fn behind_the_air(
    view: &View,
    sample: StereoPoint,
    space: &FreeSpace,
    region: Region,
) -> Option<StereoPoint> {
    if space.allows(&sample) {
        return Some(sample);
    }
    let eye = view.camera.center();
    let ray = sample.position - eye;
    let nearest = region.exit(eye, ray, BEYOND).max(STEP);
    let factors = successors(Some(nearest), |factor| Some(factor * STEP)).take_while(|&f| f < FARTHEST);
    let moved = |factor: f64| StereoPoint { position: eye + ray * factor, ..sample };
    factors.map(moved).find(|point| space.allows(point))
}

/// Halton's sequence in a base, from its 20th member on.
pub(crate) fn halton(i: usize, base: usize) -> f64 {
    let (mut i, mut part, mut value) = (i + 20, 1.0, 0.0);
    while i > 0 {
        part /= base as f64;
        value += part * (i % base) as f64;
        i /= base;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free_space;
    use crate::free_space::tests::{WALL, point, views, wall};

    #[test]
    fn what_others_look_through_stands_behind_what_they_see() {
        let views = views();
        let (_, space) = free_space::consistent(&views, &[], wall(), None);
        let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
        let region = common_region(&cameras);
        let (middle, radius) = ((region.low + region.high) / 2.0, (region.high - region.low).x / 2.0);
        // In the middle of the last view, 0.6 m to the right.
        let depth = |z: f64| {
            let sample = point(0.6, 0.0, z);
            behind_the_air(&views[4], sample, &space, region).map(|p| (p.position.z, p.position))
        };
        assert_eq!(depth(WALL).map(|d| d.0), Some(WALL), "on the wall");
        let (moved, place) = depth(3.0).unwrap();
        assert!(moved > WALL && moved < 2.0 * WALL, "{moved}");
        assert!((place.distance(middle) / radius - BEYOND).abs() < 1e-9, "{place} is not at the sphere");
        assert_eq!(depth(1.5), None, "the sphere is five times as far");
        assert_eq!((place.x, place.y), (0.6, 0.0), "along its ray");
    }
}
