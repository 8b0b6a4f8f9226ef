//! Depth maps of all views, and the points on which they agree.

use crate::connected::connected;
use crate::patch_match::{PatchMatch, Plane};
use crate::stereo::StereoPoint;
use crate::thinning::evenly;
use crate::windows::{Grey, Pictures, grid, pixel};
use ffgs_core::Camera;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Places at which depths are sought, over all views, and in a view at least.
const PLACES: usize = 100_000;
const LEAST_PLACES: usize = 4_000;
/// Points at most.
const MOST: usize = 30_000;
/// Least score of a plane.
const LEAST_SCORE: f32 = 0.75;
/// It must be better by this than at any depth that is not beside it.
const DISTINCT: f32 = 0.05;
/// Steps of depths beside it.
const BESIDE: f64 = 3.5;
/// Steps of depth at most.
const STEPS: f64 = 192.0;
/// Connected places of a smaller area (px^2), about two windows, must be found by so many neighbours: windows that resemble each other by chance do
/// so in both views, but those beside them do not.
const SPECK: f64 = 100.0;
const SPECK_NEIGHBOURS: usize = 2;
/// Views that must have found the place of a point that was found in another way: the two that it was matched in.
const CONFIRMING: usize = 2;
/// Largest difference to what another view found (steps).
const SAME: f64 = 1.0;
/// The nearest depth, as a share of the distance to the nearest neighbour, where nothing is known of depths.
const NEAREST: f64 = 0.5;
/// Share of the known depths that are less than the nearest one but for a factor, and that factor.
const KNOWN_NEAREST: (f64, f64) = (0.02, 0.5);
/// Fewest known points in a view that say how near things are.
const LEAST_KNOWN: usize = 20;

/// What was found at a grid of a view's pixels.
struct DepthMap {
    stride: f64,
    columns: usize,
    /// Difference of inverse depths (1/m) at which the picture in the farthest neighbour moves by a pixel.
    step: f64,
    /// Inverse depth (1/m) per place of the grid; NaN where nothing was found.
    inverse: Vec<f64>,
    /// Area (px^2) of the connected places of like depths to which a place belongs.
    area: Vec<f64>,
}

/// The depth maps of all views.
pub(crate) struct DepthMaps<'a> {
    pictures: &'a Pictures<'a>,
    maps: Vec<DepthMap>,
}

impl<'a> DepthMaps<'a> {
    /// `known` points say how near things are.
    pub(crate) fn new(pictures: &'a Pictures, known: &[StereoPoint]) -> Self {
        let cameras: Vec<Camera> = pictures.grey.iter().map(|view| view.camera).collect();
        let places = PLACES.max(LEAST_PLACES * cameras.len());
        let stride = pictures.stride(places);
        let map = |view: usize| {
            let others: Vec<&Grey> = pictures.of(&pictures.around[view]).collect();
            let nearest = nearest(&cameras, view, &pictures.around[view], known);
            DepthMap::find(&pictures.grey[view], others, nearest, stride)
        };
        Self { pictures, maps: (0..cameras.len()).map(map).collect() }
    }

    /// Places that a view and its neighbours found: one of these, or more where the place belongs to a small piece.
    pub(crate) fn points(&self) -> Vec<StereoPoint> {
        let of_view = |view: usize| {
            let places = 0..self.maps[view].inverse.len();
            places.filter_map(move |place| self.point(view, place))
        };
        evenly((0..self.maps.len()).into_par_iter().flat_map_iter(of_view).collect(), MOST)
    }

    fn point(&self, view: usize, place: usize) -> Option<StereoPoint> {
        let (pixel, depth) = self.maps[view].at(place)?;
        let point = self.pictures.point(view, pixel, depth);
        let least = if self.maps[view].area[place] < SPECK { SPECK_NEIGHBOURS } else { 1 };
        let mut finders =
            self.pictures.around[view].iter().filter(|&&other| self.finds(other, point.position));
        finders.nth(least - 1).is_some().then_some(point)
    }

    /// Whether a place that was found in another way was found by enough views.
    pub(crate) fn confirm(&self, position: DVec3) -> bool {
        (0..self.maps.len()).filter(|&view| self.finds(view, position)).nth(CONFIRMING - 1).is_some()
    }

    fn finds(&self, view: usize, position: DVec3) -> bool {
        self.maps[view].holds(&self.pictures.grey[view].camera, position)
    }
}

/// The nearest depth (m).
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

impl DepthMap {
    /// Of a view; nothing where it has no neighbours, or all of them are where it is.
    fn find(view: &Grey, others: Vec<&Grey>, nearest: f64, stride: f64) -> Self {
        let [columns, _] = grid(view.camera.size(), stride);
        if !(nearest.is_finite() && nearest > 0.0) {
            return Self { stride, columns, step: f64::NAN, inverse: Vec::new(), area: Vec::new() };
        }
        let step = step(view, &others, nearest);
        let search = PatchMatch::new(view, others, stride, 1.0 / nearest);
        let planes = search.planes();
        let found = |(place, plane): (usize, &Plane)| {
            let good =
                plane.score > LEAST_SCORE && search.is_distinct(place, *plane, (step, BESIDE), DISTINCT);
            if good { plane.inverse } else { f64::NAN }
        };
        let inverse: Vec<f64> = planes.par_iter().enumerate().map(found).collect();
        let area =
            pieces(&inverse, columns, SAME * step).into_iter().map(|n| n as f64 * stride * stride).collect();
        Self { stride, columns, step, inverse, area }
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

/// Of each place, how many are connected with it by inverse depths (1/m) that differ by less than `like` from one place to the next; 0 where
/// nothing was found.
fn pieces(inverse: &[f64], columns: usize, like: f64) -> Vec<usize> {
    let mut sizes = vec![0; inverse.len()];
    let mut seen: Vec<bool> = inverse.iter().map(|value| value.is_nan()).collect();
    for start in 0..inverse.len() {
        if !seen[start] {
            let piece = connected(start, columns, &mut seen, |a, b| (inverse[a] - inverse[b]).abs() < like);
            piece.iter().for_each(|&i| sizes[i] = piece.len());
        }
    }
    sizes
}

/// See [`DepthMap::step`]; larger where that would be too many steps to the nearest depth (m).
fn step(view: &Grey, others: &[&Grey], nearest: f64) -> f64 {
    let distances = others.iter().map(|o| o.camera.center().distance(view.camera.center()));
    let pixel = 1.0 / (view.camera.intrinsics().focal() * distances.fold(0.0, f64::max));
    pixel.max(1.0 / (nearest * STEPS))
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
        let maps = DepthMaps::new(&pictures, &[]);
        let found = maps.points();
        assert!(found.len() > 5 * SIZE.pixels() / 4, "{} points", found.len());
        let away = |p: &StereoPoint| (p.position.z - WALL).abs().min((p.position.y - FLOOR).abs());
        let mut errors: Vec<f64> = found.iter().map(|p| away(p) / p.position.z).collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 0.01, "median {}", errors[errors.len() / 2]);
        // Two planes are 9 % of the wall's distance apart.
        assert!(errors[errors.len() * 9 / 10] < 0.06, "90 % {}", errors[errors.len() * 9 / 10]);
        let floor = found.iter().filter(|p| p.position.z < 0.8 * WALL && p.position.y > 0.9 * FLOOR).count();
        assert!(floor > found.len() / 10, "{floor} of {} points on the floor", found.len());
        let confirmed = [WALL, 0.5 * WALL].map(|z| maps.confirm(DVec3::new(0.0, -0.5, z)));
        assert_eq!(confirmed, [true, false], "on the wall, and before it");
    }

    #[test]
    fn noise_and_bare_walls_give_next_to_nothing() {
        let noise: Vec<_> = (0..5).map(|i| view(i, |_, pixel| noise(i, pixel))).collect();
        let found = |views: &[View]| DepthMaps::new(&Pictures::new(views), &[]).points().len();
        assert!(found(&noise) < SIZE.pixels() / 50, "{} points in noise", found(&noise));
        let bare: Vec<_> = (0..5).map(|i| view(i, |_, _| 0.6)).collect();
        assert_eq!([found(&bare), found(&bare[..1]), found(&[])], [0; 3]);
    }

    #[test]
    fn two_views_are_enough() {
        let views: Vec<_> = [0, 2].into_iter().map(|i| view(i, painted)).collect();
        let found = DepthMaps::new(&Pictures::new(&views), &[]).points();
        assert!(found.len() > SIZE.pixels() / 4, "{} points", found.len());
        let away = |p: &StereoPoint| (p.position.z - WALL).abs().min((p.position.y - FLOOR).abs());
        let right = found.iter().filter(|p| away(p) < 0.05 * p.position.z).count();
        assert!(right > found.len() * 3 / 4, "{right} of {} points", found.len());
    }

    #[test]
    fn pieces_are_connected_places_of_like_depths() {
        let nan = f64::NAN;
        #[rustfmt::skip]
        let inverse = [
            1.0, 1.1, nan, 5.0,
            9.0, 1.2, nan, 5.1,
            9.0, nan, 1.2, nan,
        ];
        #[rustfmt::skip]
        let sizes = [
            3, 3, 0, 2,
            2, 3, 0, 2,
            2, 0, 1, 0,
        ];
        assert_eq!(pieces(&inverse, 4, 0.15), sizes);
        assert!(pieces(&[], 4, 0.15).is_empty());
    }
}
