//! Points where nothing was matched: pixels at depths that continue those of the matched points around them.

use crate::ground::Ground;
use crate::hull::{Region, common_region};
use crate::stereo::StereoPoint;
use crate::surfaces::Surfaces;
use crate::thinning::evenly;
use crate::views::View;
use ffgs_core::Camera;
use glam::DVec2;
use rayon::prelude::*;

/// Points of the background that are made at most, over all views, and of the foreground.
const STILL: usize = 7_000;
const MOVING: usize = 4_000;

/// Pixels of every view, outside its mask, at depths that continue those of the matched points; where there are too few, at
/// depths from a quarter to four times that of the scene.
pub(crate) fn background(
    views: &[View],
    matched: &[StereoPoint],
    ground: Option<&Ground>,
) -> Vec<StereoPoint> {
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let region = common_region(&cameras);
    let per_view = STILL.div_ceil(views.len());
    let of_view = |view: &View| {
        let surfaces = Surfaces::still(view, matched, ground);
        (0..per_view).filter_map(|i| sample(view, i, surfaces.as_ref(), region)).collect::<Vec<_>>()
    };
    views.par_iter().map(of_view).collect::<Vec<_>>().concat()
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
