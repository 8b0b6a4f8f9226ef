//! Depth maps of all views, and the points on which they agree: of all they show, and closer ones of what moves.

use crate::patch_match::{Limits, PatchMatch, Plane};
use crate::silhouettes::Silhouettes;
use crate::stereo::StereoPoint;
use crate::thinning::evenly;
use crate::windows::{Grey, Pictures, grid, pixel};
use ffgs_core::Camera;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Places at which depths are sought, over all views, and in a view at least.
const PLACES: usize = 100_000;
const LEAST_PLACES: usize = 4_000;
/// Places in masks, over all views.
const MOVING_PLACES: usize = 40_000;
/// What is asked of planes. Of what moves the masks tell much already.
const ANY: Rules = Rules { least_score: 0.75, distinct: 0.05, most: 30_000 };
const MOVING: Rules = Rules { least_score: 0.6, distinct: 0.0, most: 15_000 };
/// Steps of depths beside it.
const BESIDE: f64 = 3.5;
/// Steps of depth at most.
const STEPS: f64 = 192.0;
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

/// What is asked of planes.
struct Rules {
    least_score: f32,
    /// A score must be better by this than at any depth that is not beside it.
    distinct: f32,
    /// Points at most.
    most: usize,
}

/// What was found at a grid of a view's pixels.
struct DepthMap {
    stride: f64,
    columns: usize,
    /// Difference of inverse depths (1/m) at which the picture in the farthest neighbour moves by a pixel.
    step: f64,
    /// Inverse depth (1/m) per place of the grid; NaN where nothing was found.
    inverse: Vec<f64>,
}

/// The depth maps of all views.
pub(crate) struct DepthMaps<'a> {
    pictures: &'a Pictures<'a>,
    rules: Rules,
    maps: Vec<DepthMap>,
}

impl<'a> DepthMaps<'a> {
    /// Of all that the views show. `known` points say how near things are; `tick` is called after each view.
    pub(crate) fn new(pictures: &'a Pictures, known: &[StereoPoint], tick: &dyn Fn()) -> Self {
        let views = pictures.grey.len();
        let stride = pictures.stride(PLACES.max(LEAST_PLACES * views));
        let map = |view: usize| {
            let nearest = 1.0 / nearest(pictures, view, known);
            let limits = Limits { nearest, sought: &|_| true, possible: &|_| true };
            let map = DepthMap::find(pictures, view, stride, limits, &ANY);
            tick();
            map
        };
        Self { pictures, rules: ANY, maps: (0..views).map(map).collect() }
    }

    /// Of what the masks show, at places that most of them hold. For `known` and `tick` see [`DepthMaps::new`].
    pub(crate) fn moving(
        pictures: &'a Pictures,
        silhouettes: &Silhouettes,
        known: &[StereoPoint],
        tick: &dyn Fn(),
    ) -> Self {
        let views = pictures.grey.len();
        let area: f64 = (0..views).map(|view| pictures.foreground_area(view)).sum();
        let stride = (area / MOVING_PLACES as f64).sqrt().max(1.0);
        let map = |view: usize| {
            let nearest = 1.0 / nearest(pictures, view, known);
            let sought = |pixel| pictures.is_foreground(view, pixel);
            let limits = Limits { nearest, sought: &sought, possible: &|place| silhouettes.hold(place) };
            let map = DepthMap::find(pictures, view, stride, limits, &MOVING);
            tick();
            map
        };
        Self { pictures, rules: MOVING, maps: (0..views).map(map).collect() }
    }

    /// Places that a view and one of its neighbours found.
    pub(crate) fn points(&self) -> Vec<StereoPoint> {
        let of_view = |view: usize| {
            let places = 0..self.maps[view].inverse.len();
            places.filter_map(move |place| self.point(view, place))
        };
        evenly((0..self.maps.len()).into_par_iter().flat_map_iter(of_view).collect(), self.rules.most)
    }

    fn point(&self, view: usize, place: usize) -> Option<StereoPoint> {
        let (pixel, depth) = self.maps[view].at(place)?;
        let point = self.pictures.point(view, pixel, depth);
        let mut neighbours = self.pictures.around[view].iter();
        neighbours.any(|&other| self.finds(other, point.position)).then_some(point)
    }

    /// Whether a place that was found in another way was found by enough views.
    pub(crate) fn confirm(&self, position: DVec3) -> bool {
        (0..self.maps.len()).filter(|&view| self.finds(view, position)).nth(CONFIRMING - 1).is_some()
    }

    fn finds(&self, view: usize, position: DVec3) -> bool {
        self.maps[view].holds(&self.pictures.grey[view].camera, position)
    }
}

/// The nearest depth (m) in a view.
fn nearest(pictures: &Pictures, view: usize, known: &[StereoPoint]) -> f64 {
    let camera = &pictures.grey[view].camera;
    let seen = known.iter().filter_map(|point| camera.project(point.position));
    let mut depths: Vec<f64> = seen.filter(|p| camera.shows(p.pixel)).map(|p| p.depth).collect();
    if depths.len() >= LEAST_KNOWN {
        depths.sort_by(f64::total_cmp);
        return KNOWN_NEAREST.1 * depths[(KNOWN_NEAREST.0 * depths.len() as f64) as usize];
    }
    let distances = pictures.of(&pictures.around[view]).map(|o| o.camera.center().distance(camera.center()));
    NEAREST * distances.fold(f64::INFINITY, f64::min)
}

impl DepthMap {
    /// Of a view; nothing where it has no neighbours, or all of them are where it is.
    fn find(pictures: &Pictures, view: usize, stride: f64, limits: Limits, rules: &Rules) -> Self {
        let others: Vec<&Grey> = pictures.of(&pictures.around[view]).collect();
        let view = &pictures.grey[view];
        let [columns, _] = grid(view.camera.size(), stride);
        if !(limits.nearest.is_finite() && limits.nearest > 0.0) {
            return Self { stride, columns, step: f64::NAN, inverse: Vec::new() };
        }
        let step = step(view, &others, limits.nearest);
        let search = PatchMatch::new(view, others, stride, limits);
        let planes = search.planes();
        let found = |(place, plane): (usize, &Plane)| {
            let good = plane.score > rules.least_score
                && search.is_distinct(place, *plane, (step, BESIDE), rules.distinct);
            if good { plane.inverse } else { f64::NAN }
        };
        let inverse = planes.par_iter().enumerate().map(found).collect();
        Self { stride, columns, step, inverse }
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

/// See [`DepthMap::step`]; larger where that would be too many steps to the largest inverse depth (1/m).
fn step(view: &Grey, others: &[&Grey], nearest: f64) -> f64 {
    let distances = others.iter().map(|o| o.camera.center().distance(view.camera.center()));
    let pixel = 1.0 / (view.camera.intrinsics().focal() * distances.fold(0.0, f64::max));
    pixel.max(nearest / STEPS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::painted::{FLOOR, SIZE, WALL, noise, painted, view};
    use crate::views::{View, at_depth};
    use ffgs_core::Mask;

    #[test]
    fn a_wall_and_a_floor_are_found_where_they_are() {
        let views: Vec<_> = (0..5).map(|i| view(i, painted)).collect();
        let pictures = Pictures::new(&views);
        let maps = DepthMaps::new(&pictures, &[], &|| {});
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
        let found = |views: &[View]| DepthMaps::new(&Pictures::new(views), &[], &|| {}).points().len();
        assert!(found(&noise) < SIZE.pixels() / 50, "{} points in noise", found(&noise));
        let bare: Vec<_> = (0..5).map(|i| view(i, |_, _| 0.6)).collect();
        assert_eq!([found(&bare), found(&bare[..1]), found(&[])], [0; 3]);
    }

    #[test]
    fn two_views_are_enough() {
        let views: Vec<_> = [0, 2].into_iter().map(|i| view(i, painted)).collect();
        let found = DepthMaps::new(&Pictures::new(&views), &[], &|| {}).points();
        assert!(found.len() > SIZE.pixels() / 4, "{} points", found.len());
        let away = |p: &StereoPoint| (p.position.z - WALL).abs().min((p.position.y - FLOOR).abs());
        let right = found.iter().filter(|p| away(p) < 0.05 * p.position.z).count();
        assert!(right > found.len() * 3 / 4, "{right} of {} points", found.len());
    }

    /// A square of the wall, seen by masks, in a picture whose rest is bare.
    #[test]
    fn what_moves_is_found_in_its_masks() {
        let shade = |p: DVec3, _: usize| if is_square(p) { painted(p, 0) } else { 0.6 };
        let masked = |i: usize| {
            let view = view(i, shade);
            let inside = |p: usize| {
                let pixel = DVec2::new((p % SIZE.width) as f64 + 0.5, (p / SIZE.width) as f64 + 0.5);
                u8::from(is_square(at_depth(&view.camera, pixel, WALL)))
            };
            let mask = Mask::new(SIZE, (0..SIZE.pixels()).map(inside).collect()).unwrap();
            View { mask: Some(mask), ..view }
        };
        let views: Vec<_> = (0..5).map(masked).collect();
        let pictures = Pictures::new(&views);
        let silhouettes = Silhouettes::new(&views).unwrap();
        let ticks = std::cell::Cell::new(0);
        let tick = || ticks.set(ticks.get() + 1);
        let found = DepthMaps::moving(&pictures, &silhouettes, &[], &tick).points();
        assert_eq!(ticks.get(), 5);
        assert!(found.len() > 500, "{} points", found.len());
        let right = found.iter().filter(|p| (p.position.z - WALL).abs() < 0.05 * WALL).count();
        assert!(right > found.len() * 9 / 10, "{right} of {} points", found.len());
    }

    fn is_square(p: DVec3) -> bool {
        p.z > 0.9 * WALL && (p.x - 0.2).abs() < 0.8 && (p.y + 0.5).abs() < 0.8
    }
}
