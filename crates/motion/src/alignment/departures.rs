//! Whether a part of a group departs from its motion, as the photographs show it: its pixels of t-1 are looked up at t where
//! the group takes them, and where the trackers say that they went.

use super::normal::{LEAST_SCALE, NORMAL_MEDIAN};
use super::photograph::Patch;
use super::surface::{SurfacePoint, brightness};
use ffgs_core::TrainingView;
use ffgs_fusion::{Groups, RigidMotion};
use glam::DVec3;
use rayon::prelude::*;

/// Squared difference, in scales, of a pixel that is simply not the same.
const UNLIKE: f64 = 9.0;
/// Pixels of a square whose errors are alike.
const ALIKE: f64 = 9.0;

/// A pixel of t-1 whose Gaussian's cell the trackers saw depart.
struct Pixel {
    cell: usize,
    /// Difference of brightness where the group takes it; `None` off the mask.
    rigid: Option<f64>,
    /// Where the trackers take it.
    apart: Option<f64>,
}

/// Per cell, the logarithm of the odds that it moved by its offset (m) beyond the group.
/// `seen` has the surface points of each view and group at t-1.
pub(crate) fn departures(
    views: &[(&TrainingView, &TrainingView)],
    seen: &[Vec<Vec<SurfacePoint>>],
    groups: &Groups,
    offsets: &[Option<DVec3>],
) -> Vec<f64> {
    let mut cell_of = vec![0; groups.of.len()];
    for (cell, range) in groups.cells.leaves.iter().enumerate() {
        groups.cells.members(range).iter().for_each(|&i| cell_of[i] = cell);
    }
    let of_group = |g: usize| {
        let motion = &groups.found[g].motion;
        let pixels: Vec<Pixel> = (views.iter().zip(seen))
            .flat_map(|((before, now), seen)| compared((before, now), &seen[g], motion, &cell_of, offsets))
            .collect();
        judged(&pixels)
    };
    let mut odds = vec![0.0; offsets.len()];
    let judged: Vec<Vec<(usize, f64)>> = (0..groups.found.len()).into_par_iter().map(of_group).collect();
    judged.into_iter().flatten().for_each(|(cell, share)| odds[cell] += share);
    odds
}

fn compared(
    (before, now): (&TrainingView, &TrainingView),
    points: &[SurfacePoint],
    motion: &RigidMotion,
    cell_of: &[usize],
    offsets: &[Option<DVec3>],
) -> Vec<Pixel> {
    let patch = Patch { view: now, points };
    let pixel = |point: &SurfacePoint| {
        let cell = cell_of[point.gaussian];
        let (rigid, value) = (motion.apply(point.place), brightness(before.image.pixel(point.pixel)));
        let at = |place: DVec3| {
            let pixel = now.camera.project(place)?.pixel;
            now.camera.shows(pixel).then(|| patch.bicubic(pixel).map(|(there, _)| there - value))
        };
        // What leaves the image says nothing.
        Some(Pixel { cell, rigid: at(rigid)?, apart: at(rigid + offsets[cell]?)? })
    };
    points.iter().filter_map(pixel).collect()
}

/// The pixels' shares of their cells' odds.
fn judged(pixels: &[Pixel]) -> Vec<(usize, f64)> {
    let mut sizes: Vec<f64> = pixels.iter().filter_map(|p| Some(p.rigid?.abs())).collect();
    if sizes.is_empty() {
        return Vec::new();
    }
    let half = sizes.len() / 2;
    let scale = (*sizes.select_nth_unstable_by(half, f64::total_cmp).1 / NORMAL_MEDIAN).max(LEAST_SCALE);
    let unlike = |difference: Option<f64>| difference.map_or(UNLIKE, |d| (d / scale).powi(2).min(UNLIKE));
    let share = |p: &Pixel| (p.cell, 0.5 * (unlike(p.rigid) - unlike(p.apart)) / ALIKE);
    pixels.iter().map(share).collect()
}
