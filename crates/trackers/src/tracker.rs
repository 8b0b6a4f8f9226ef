//! The tracker itself: corners, matches and pyramidal Lucas-Kanade between two photographs, checked forwards and backwards.

use crate::agreement::agreed;
use crate::corners::corners;
use crate::descriptors::{Descriptor, describe};
use crate::lucas_kanade::track;
use crate::matching::nearest_two;
use crate::pyramid::Pyramid;
use ffgs_core::{ImageRgb8, ImageSize, Mask, TrackSet};
use rayon::prelude::*;

/// How the trackers work; lengths in parts of the picture, so that one setting serves every size.
#[derive(Clone, Copy, Debug)]
pub struct TrackerConfig {
    /// Corners of a picture, about.
    pub corners: usize,
    /// The strongest of them that get a descriptor.
    pub described: usize,
    /// Longest displacement of a match, in parts of the picture's width.
    pub reach: f32,
    /// Lowe's ratio between the nearest and the second descriptor.
    pub ratio: f32,
    /// Largest distance (px) between a point and where its track leads back to.
    pub round_trip_px: f32,
    /// Least correlation of the windows at both ends.
    pub correlation: f32,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            corners: 5000,
            described: 1500,
            reach: 0.25,
            ratio: 0.8,
            round_trip_px: 0.7,
            correlation: 0.85,
        }
    }
}

/// A picture made ready for tracking; used as the end of one step and the start of the next.
#[derive(Clone, Debug)]
pub struct Frame {
    pyramid: Pyramid,
    size: ImageSize,
    interest: Option<Mask>,
    corners: Vec<[f32; 2]>,
    /// Positions of the strongest corners.
    keypoints: Vec<[f32; 2]>,
    descriptors: Vec<Descriptor>,
}

/// Levels of a pyramid; the coarsest sees motions of 2⁵ times a window's radius.
const LEVELS: usize = 5;
/// Corners are found in every cell of so many pixels at least: closer ones share their windows.
const LEAST_CELL: usize = 4;
const LEAST_FINE_CELL: usize = 3;
/// Matches around a point whose displacements are tried besides none.
const SEEDS: usize = 3;
/// A seed within this distance (px) of another adds nothing: one iteration covers it.
const SAME_SEED_PX: f32 = 3.0;

impl Frame {
    /// Finds corners, more densely where `interest` is set, and describes the strongest.
    pub fn new(image: &ImageRgb8, interest: Option<&Mask>, config: &TrackerConfig) -> Self {
        let pyramid = Pyramid::new(image, LEVELS);
        let size = image.size();
        let interest = interest.filter(|m| m.size() == size && m.count() > 0);
        let cell = |pixels: usize, least: usize| {
            (((pixels as f64 / config.corners.max(1) as f64).sqrt()).ceil() as usize).max(least)
        };
        let fine = cell(interest.map_or(0, Mask::count), LEAST_FINE_CELL);
        let mut found = corners(&pyramid.levels[0], interest, cell(size.pixels(), LEAST_CELL), fine);
        let all = found.iter().map(|(p, _)| *p).collect();
        let wanted = |p: &[f32; 2]| interest.is_some_and(|m| m.contains(p[0] as usize, p[1] as usize));
        // What is of interest first, then by strength; the sort is stable.
        found.sort_by(|a, b| wanted(&b.0).cmp(&wanted(&a.0)).then(b.1.total_cmp(&a.1)));
        let keypoints: Vec<[f32; 2]> = found.iter().take(config.described).map(|(p, _)| *p).collect();
        let descriptors = keypoints.iter().map(|p| describe(&pyramid.levels[0], *p)).collect();
        Self { pyramid, size, interest: interest.cloned(), corners: all, keypoints, descriptors }
    }

    /// Positions of all corners.
    pub fn corners(&self) -> &[[f32; 2]] {
        &self.corners
    }

    /// Positions of the corners that have a descriptor.
    pub fn keypoints(&self) -> &[[f32; 2]] {
        &self.keypoints
    }

    /// Descriptors of the keypoints.
    pub fn descriptors(&self) -> &[Descriptor] {
        &self.descriptors
    }
}

/// Sparse tracks: descriptors that are each other's nearest and distinct, refined by Lucas-Kanade, where tracks around them agree.
pub fn matches(prev: &Frame, next: &Frame, config: &TrackerConfig) -> TrackSet {
    let reach = config.reach * prev.size.width as f32;
    let matched: Vec<Option<[f32; 2]>> = (0..prev.keypoints.len())
        .into_par_iter()
        .map(|i| {
            let found = nearest(prev, i, next, reach).filter(|f| f.is_distinct(config.ratio))?;
            let is_mutual = nearest(next, found.index, prev, reach).is_some_and(|back| back.index == i);
            let end = || refined(prev, next, prev.keypoints[i], next.keypoints[found.index], config);
            is_mutual.then(end).flatten()
        })
        .collect();
    collected(prev, &prev.keypoints, matched)
}

/// Medium tracks: every corner, from no motion and from the motions of the sparse tracks around it; the best of
/// those that lead back to the corner counts, where tracks around it agree.
pub fn lucas_kanade(prev: &Frame, next: &Frame, sparse: &TrackSet, config: &TrackerConfig) -> TrackSet {
    let tracked: Vec<Option<[f32; 2]>> =
        prev.corners.par_iter().map(|p| best_track(prev, next, *p, sparse, config)).collect();
    collected(prev, &prev.corners, tracked)
}

/// The tracks that have an end, and neighbours that agree.
fn collected(prev: &Frame, starts: &[[f32; 2]], ends: Vec<Option<[f32; 2]>>) -> TrackSet {
    let (src, tgt): (Vec<_>, Vec<_>) =
        starts.iter().zip(ends).filter_map(|(start, end)| Some((*start, end?))).unzip();
    let tracks = TrackSet { visibility: vec![1.0; src.len()], src, tgt };
    agreed(&tracks, prev.interest.as_ref(), prev.size.width)
}

/// The nearest descriptors of `to` to keypoint `i` of `from`.
fn nearest(from: &Frame, i: usize, to: &Frame, reach: f32) -> Option<crate::Neighbours> {
    let p = from.keypoints[i];
    let near = |q: [f32; 2]| (p[0] - q[0]).abs() <= reach && (p[1] - q[1]).abs() <= reach;
    let candidates = (0..to.keypoints.len()).filter(|&j| near(to.keypoints[j]));
    nearest_two(&from.descriptors[i], &to.descriptors, candidates)
}

/// The subpixel end of a match, if Lucas-Kanade agrees with it.
fn refined(
    prev: &Frame,
    next: &Frame,
    start: [f32; 2],
    end: [f32; 2],
    config: &TrackerConfig,
) -> Option<[f32; 2]> {
    let (found, _) = checked(prev, next, start, Some([end[0] - start[0], end[1] - start[1]]), config)?;
    // A corner is found to a pixel or so; farther away is something else.
    (distance(found, end) < 3.0).then_some(found)
}

fn best_track(
    prev: &Frame,
    next: &Frame,
    at: [f32; 2],
    sparse: &TrackSet,
    config: &TrackerConfig,
) -> Option<[f32; 2]> {
    let guesses = std::iter::once(None).chain(seeds(at, sparse).into_iter().map(Some));
    let found = guesses.filter_map(|guess| checked(prev, next, at, guess, config));
    found.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(end, _)| end)
}

/// Different displacements of the nearest sparse tracks.
fn seeds(at: [f32; 2], sparse: &TrackSet) -> Vec<[f32; 2]> {
    let mut nearest: Vec<(f32, usize)> = Vec::with_capacity(2 * SEEDS + 1);
    for (i, src) in sparse.src.iter().enumerate() {
        let d = distance(*src, at);
        let place = nearest.partition_point(|n| n.0 <= d);
        if place < 2 * SEEDS {
            nearest.insert(place, (d, i));
            nearest.truncate(2 * SEEDS);
        }
    }
    let mut out: Vec<[f32; 2]> = Vec::new();
    for (_, i) in nearest {
        let d = [sparse.tgt[i][0] - sparse.src[i][0], sparse.tgt[i][1] - sparse.src[i][1]];
        let is_new =
            distance(d, [0.0; 2]) > SAME_SEED_PX && out.iter().all(|o| distance(*o, d) > SAME_SEED_PX);
        if is_new && out.len() < SEEDS {
            out.push(d);
        }
    }
    out
}

/// A track that leads back to its start and whose ends look alike, with their correlation.
fn checked(
    prev: &Frame,
    next: &Frame,
    at: [f32; 2],
    guess: Option<[f32; 2]>,
    config: &TrackerConfig,
) -> Option<([f32; 2], f32)> {
    let (end, correlation) = track(&prev.pyramid, &next.pyramid, at, guess)?;
    if !(correlation >= config.correlation) {
        return None;
    }
    let (home, _) = track(&next.pyramid, &prev.pyramid, end, guess.map(|g| g.map(|v| -v)))?;
    (distance(home, at) <= config.round_trip_px).then_some((end, correlation))
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
