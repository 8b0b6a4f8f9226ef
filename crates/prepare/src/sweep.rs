//! Points from plane sweeps: for a grid of pixels of every view the plane on which neighbouring views agree (Collins 1996; planes of
//! two directions after Gallup et al. 2007), kept where the neighbours found the same place.

use crate::stereo::StereoPoint;
use crate::windows::{Grey, Patch, Pictures, Window, grid, pixel, up};
use ffgs_core::Camera;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Pixels that are looked at, over all views.
const PIXELS: usize = 30_000;
/// Planes of each direction at most.
const PLANES: usize = 192;
/// Least mean correlation with the neighbours that agree best.
const LEAST_SCORE: f32 = 0.75;
/// Neighbours that must agree; others may be occluded.
const AGREEING: usize = 2;
/// The best plane must be better by this than any that is not beside it.
const DISTINCT: f32 = 0.03;
/// Planes beside the best one.
const BESIDE: usize = 3;
/// Neighbours that must have found the same place, where there are at least so many; one of fewer. Stripes that repeat look alike in two views
/// at several depths, but seldom in three.
const CONFIRMING: usize = 2;
const MANY: usize = 4;
/// Largest difference to what a neighbour found (planes).
const SAME: f64 = 2.0;
/// The nearest plane, as a share of the distance to the nearest neighbour, where nothing is known of depths.
const NEAREST: f64 = 0.5;
/// Share of the known depths that lie before the nearest plane but for a factor, and that factor.
const KNOWN_NEAREST: (f64, f64) = (0.02, 0.5);
/// Fewest known points in a view that say how near things are.
const LEAST_KNOWN: usize = 20;

/// What was found at the pixels of a view's grid.
struct Depths {
    stride: f64,
    columns: usize,
    /// Distance between two planes (1/m).
    step: f64,
    /// Inverse depth (1/m) per place of the grid; NaN where nothing was found.
    inverse: Vec<f64>,
}

/// A plane through the point of a pixel at a depth: one of two directions.
type Normal = DVec3;

/// The depths that plane sweeps found in all views.
pub(crate) struct Sweeps<'a> {
    pictures: &'a Pictures<'a>,
    depths: Vec<Depths>,
}

impl<'a> Sweeps<'a> {
    /// Sweeps all views. `known` points say how near things are.
    pub(crate) fn new(pictures: &'a Pictures, known: &[StereoPoint]) -> Self {
        let Pictures { grey, neighbours, .. } = pictures;
        let cameras: Vec<Camera> = grey.iter().map(|view| view.camera).collect();
        let stride = pictures.stride(PIXELS);
        let up = up(&cameras);
        let depths = (0..grey.len())
            .map(|view| {
                let others: Vec<&Grey> = pictures.others(view).collect();
                let nearest = nearest(&cameras, view, &neighbours[view], known);
                Depths::find(&grey[view], &others, up, nearest, stride)
            })
            .collect();
        Self { pictures, depths }
    }

    /// Places that a view and enough of its neighbours found.
    pub(crate) fn points(&self) -> Vec<StereoPoint> {
        let of_view = |view: usize| {
            let places = 0..self.depths[view].inverse.len();
            places.filter_map(move |place| self.point(view, place))
        };
        (0..self.depths.len()).into_par_iter().flat_map_iter(of_view).collect()
    }

    fn point(&self, view: usize, place: usize) -> Option<StereoPoint> {
        let (pixel, depth) = self.depths[view].at(place)?;
        let point = self.pictures.point(view, pixel, depth);
        let neighbours = &self.pictures.neighbours[view];
        let least = if neighbours.len() < MANY { 1 } else { CONFIRMING };
        (self.finders(neighbours.iter().copied(), point.position) >= least).then_some(point)
    }

    /// Whether a place that was found in another way was found by sweeps, too.
    pub(crate) fn confirm(&self, position: DVec3) -> bool {
        self.finders(0..self.depths.len(), position) >= CONFIRMING
    }

    /// How many of the views found a place.
    fn finders(&self, views: impl Iterator<Item = usize>, position: DVec3) -> usize {
        views.filter(|&view| self.depths[view].holds(&self.pictures.grey[view].camera, position)).count()
    }
}

/// Depth of the nearest plane (m).
fn nearest(cameras: &[Camera], view: usize, neighbours: &[usize], known: &[StereoPoint]) -> f64 {
    let camera = &cameras[view];
    let seen = known.iter().filter_map(|point| camera.project(point.position));
    let mut depths: Vec<f64> = seen.filter(|p| camera.shows(p.pixel)).map(|p| p.depth).collect();
    if depths.len() >= LEAST_KNOWN {
        depths.sort_by(f64::total_cmp);
        return KNOWN_NEAREST.1 * depths[(KNOWN_NEAREST.0 * depths.len() as f64) as usize];
    }
    let distance = |&other: &usize| cameras[other].center().distance(camera.center());
    NEAREST * neighbours.iter().map(distance).fold(f64::INFINITY, f64::min)
}

impl Depths {
    fn find(view: &Grey, others: &[&Grey], up: Normal, nearest: f64, stride: f64) -> Self {
        let size = view.camera.size();
        let [columns, rows] = grid(size, stride);
        let step = step(view, others, nearest);
        let find = |place: usize| {
            let pixel = pixel(place, columns, stride);
            inverse_depth(view, others, pixel, [None, Some(up)], (1.0 / nearest, step)).unwrap_or(f64::NAN)
        };
        let found = nearest.is_finite() && nearest > 0.0 && !others.is_empty();
        let places = if found { columns * rows } else { 0 };
        Self { stride, columns, step, inverse: (0..places).into_par_iter().map(find).collect() }
    }

    /// Pixel and depth (m) of what was found at a place.
    fn at(&self, place: usize) -> Option<(DVec2, f64)> {
        let inverse = self.inverse[place];
        (!inverse.is_nan()).then(|| (pixel(place, self.columns, self.stride), 1.0 / inverse))
    }

    /// Whether the view found this place, too.
    fn holds(&self, camera: &Camera, position: DVec3) -> bool {
        let Some(projection) = camera.project(position).filter(|p| camera.shows(p.pixel)) else {
            return false;
        };
        let [x, y] = projection.pixel.to_array().map(|v| (v / self.stride) as usize);
        let near = |v: usize| v.saturating_sub(1)..=v + 1;
        let inverse = 1.0 / projection.depth;
        let columns = self.columns;
        near(y).flat_map(|row| near(x).map(move |column| (column, row))).any(|(column, row)| {
            let found = (column < columns).then(|| self.inverse.get(row * columns + column)).flatten();
            found.is_some_and(|found| (found - inverse).abs() < SAME * self.step)
        })
    }
}

/// Distance of planes in inverse depth (1/m), at which the picture in the farthest neighbour moves by a pixel.
fn step(view: &Grey, others: &[&Grey], nearest: f64) -> f64 {
    let baseline =
        others.iter().map(|o| o.camera.center().distance(view.camera.center())).fold(0.0, f64::max);
    let pixel = 1.0 / (view.camera.intrinsics().focal() * baseline);
    pixel.max(1.0 / (nearest * PLANES as f64))
}

/// Inverse depth (1/m) of the plane on which `others` agree with `view` about a pixel. Planes face the camera, or have the normals that are given.
fn inverse_depth(
    view: &Grey,
    others: &[&Grey],
    pixel: DVec2,
    normals: [Option<Normal>; 2],
    (nearest, step): (f64, f64),
) -> Option<f64> {
    let own = view.own_window(pixel)?;
    let planes = (nearest / step) as usize;
    let sweep = |normal: Option<Normal>| -> Vec<f32> {
        (1..=planes)
            .map(|i| score(view, others, (pixel, &own), 1.0 / (step * i as f64), normal).unwrap_or(-1.0))
            .collect()
    };
    let scores = normals.map(sweep);
    let best_of = |scores: &[f32]| (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]));
    let bests = [best_of(&scores[0])?, best_of(&scores[1])?];
    let way = usize::from(scores[1][bests[1]] > scores[0][bests[0]]);
    let (scores, best) = (&scores[way], bests[way]);
    let others = scores.iter().enumerate().filter(|(i, _)| i.abs_diff(best) > BESIDE);
    let second = others.map(|(_, score)| *score).fold(-1.0, f32::max);
    let good = scores[best] > LEAST_SCORE && scores[best] > second + DISTINCT;
    good.then(|| step * (best as f64 + 1.0 + peak(scores, best)))
}

/// Where a parabola through the best score and those beside it has its peak, from -0.5 to 0.5.
fn peak(scores: &[f32], best: usize) -> f64 {
    let beside = |i: usize| scores.get(i).copied().filter(|score| *score > 0.0);
    let (Some(before), Some(after)) = (best.checked_sub(1).and_then(beside), beside(best + 1)) else {
        return 0.0;
    };
    let bend = before - 2.0 * scores[best] + after;
    if bend < 0.0 { f64::from(0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Mean correlation of the neighbours that agree best with the window of a pixel, on a plane at a depth.
fn score(
    view: &Grey,
    others: &[&Grey],
    (pixel, own): (DVec2, &Window),
    depth: f64,
    normal: Option<Normal>,
) -> Option<f32> {
    let normal = normal.unwrap_or(view.camera.rotation().row(2));
    let patch = Patch::new(&view.camera, pixel, depth, normal)?;
    let mut scores: Vec<f32> =
        others.iter().filter_map(|other| other.correlation(other.look(&patch)?, own)).collect();
    scores.sort_unstable_by(|a, b| b.total_cmp(a));
    let agreeing = AGREEING.min(others.len());
    (scores.len() >= agreeing).then(|| scores[..agreeing].iter().sum::<f32>() / agreeing as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::painted::{FLOOR, SIZE, WALL, noise, painted, view};
    use crate::views::View;

    #[test]
    fn a_wall_and_a_floor_are_found_where_they_are() {
        let views: Vec<_> = (0..5).map(|i| view(i, painted)).collect();
        let pictures = Pictures::new(&views);
        let sweeps = Sweeps::new(&pictures, &[]);
        let found = sweeps.points();
        assert!(found.len() > 5 * SIZE.pixels() / 4, "{} points", found.len());
        let away = |p: &StereoPoint| (p.position.z - WALL).abs().min((p.position.y - FLOOR).abs());
        let mut errors: Vec<f64> = found.iter().map(|p| away(p) / p.position.z).collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 0.01, "median {}", errors[errors.len() / 2]);
        // Two planes are 9 % of the wall's distance apart.
        assert!(errors[errors.len() * 9 / 10] < 0.06, "90 % {}", errors[errors.len() * 9 / 10]);
        let floor = found.iter().filter(|p| p.position.z < 0.8 * WALL && p.position.y > 0.9 * FLOOR).count();
        assert!(floor > found.len() / 10, "{floor} of {} points on the floor", found.len());
        let confirmed = [WALL, 0.5 * WALL].map(|z| sweeps.confirm(DVec3::new(0.0, -0.5, z)));
        assert_eq!(confirmed, [true, false], "on the wall, and before it");
    }

    #[test]
    fn noise_and_bare_walls_give_next_to_nothing() {
        let noise: Vec<_> = (0..5).map(|i| view(i, |_, pixel| noise(i, pixel))).collect();
        let found = |views: &[View]| Sweeps::new(&Pictures::new(views), &[]).points().len();
        assert!(found(&noise) < SIZE.pixels() / 50, "{} points in noise", found(&noise));
        let bare: Vec<_> = (0..5).map(|i| view(i, |_, _| 0.6)).collect();
        assert_eq!([found(&bare), found(&bare[..1]), found(&[])], [0; 3]);
    }
}
