//! The surfaces that a view shows, by PatchMatch stereo (Bleyer et al. 2011; with many views Galliani et al. 2015).
//!
//! Every place of a grid begins with a plane by chance, tries those of places around it and random changes of its own, and keeps the one on
//! which neighbouring views agree best. Right planes are few and spread; so no directions need to be known, and walls and
//! roads are found at any angle.

use crate::windows::{Grey, Patch, Window, grid, pixel};
use glam::{DVec2, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::f64::consts::FRAC_PI_4;

/// Rounds in which planes spread and change.
const ROUNDS: u64 = 4;
/// Rounds in which depths are also drawn anew.
const NEW_DEPTHS: u64 = 2;
/// Places around one whose planes are tried there (columns, rows).
const AROUND: [[i64; 2]; 12] =
    [[-1, 0], [1, 0], [0, -1], [0, 1], [-3, 0], [3, 0], [0, -3], [0, 3], [-2, -1], [2, 1], [-1, 2], [1, -2]];
/// Random changes of an inverse depth (share of it) and of a normal, in the first round; half of it in each that follows.
const CHANGES: [(f64, f64); 3] = [(0.15, 0.0), (0.0, 0.5), (0.05, 0.5)];
/// What the correlation with one neighbour alone counts less than the mean of two that agree: a surface may hide from all others, but
/// chance agrees with one more often.
const ALONE: f32 = 0.1;
/// Largest ratio of the areas in which two views show a patch, and largest angle between their rays to it (radians): beyond them surfaces look different.
const STRETCH: f64 = 4.0;
const WIDEST: f64 = FRAC_PI_4;
/// How often a depth is drawn, until a surface can be there.
const DRAWS: usize = 100;
/// Distance between the values of a window (px).
const SPACING: f64 = 1.0;

/// A plane through a point of a place's ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    /// Inverse depth (1/m) of that point.
    pub inverse: f64,
    normal: DVec3,
    /// How well neighbours agree, -1 to 1; -1 where none shows it.
    pub score: f32,
}

/// What a search is limited to.
#[derive(Clone, Copy)]
pub(crate) struct Limits<'a> {
    /// Largest inverse depth (1/m).
    pub nearest: f64,
    /// Whether a pixel's plane is sought.
    pub sought: &'a (dyn Fn(DVec2) -> bool + Sync),
    /// Whether a surface can be at a place.
    pub possible: &'a (dyn Fn(DVec3) -> bool + Sync),
}

/// A view among its neighbours.
pub(crate) struct PatchMatch<'a> {
    view: &'a Grey,
    others: Vec<&'a Grey>,
    limits: Limits<'a>,
    columns: usize,
    places: Vec<Place>,
}

/// A place of the grid.
struct Place {
    pixel: DVec2,
    /// From the camera to a depth of 1 m.
    ray: DVec3,
    /// What the view shows there; `None` where it is bare, and where no plane is sought.
    own: Option<Window>,
}

impl<'a> PatchMatch<'a> {
    /// Of places at distances of `stride` (px).
    pub(crate) fn new(view: &'a Grey, others: Vec<&'a Grey>, stride: f64, limits: Limits<'a>) -> Self {
        let [columns, rows] = grid(view.camera.size(), stride);
        let axis = view.camera.rotation().row(2);
        let place = |i: usize| {
            let pixel = pixel(i, columns, stride);
            let ray = view.camera.ray(pixel);
            let own = (limits.sought)(pixel).then(|| view.own_window(pixel, SPACING)).flatten();
            Place { pixel, ray: ray / ray.dot(axis), own }
        };
        let places = (0..columns * rows).into_par_iter().map(place).collect();
        Self { view, others, limits, columns, places }
    }

    /// The planes of all places, row by row.
    pub(crate) fn planes(&self) -> Vec<Plane> {
        let places = 0..self.places.len();
        let mut planes: Vec<Plane> = places.clone().into_par_iter().map(|i| self.any_plane(i)).collect();
        for round in 0..ROUNDS {
            // As on a chessboard: places of one colour learn from those of the other.
            for colour in 0..2 {
                let turn = |i: usize| (i % self.columns + i / self.columns) % 2 == colour;
                let next = |i: usize| if turn(i) { self.improved(&planes, i, round) } else { planes[i] };
                planes = places.clone().into_par_iter().map(next).collect();
            }
        }
        planes
    }

    /// Whether the score of a place's plane is better by a margin than at all other depths. Depths are looked at in steps (1/m); so many of them about
    /// the plane do not count.
    pub(crate) fn is_distinct(
        &self,
        i: usize,
        plane: Plane,
        (step, beside): (f64, f64),
        margin: f32,
    ) -> bool {
        let depths = (1..=(self.limits.nearest / step) as usize).map(|k| k as f64 * step);
        let mut others = depths.filter(|inverse| (inverse - plane.inverse).abs() > beside * step);
        others.all(|inverse| self.plane(i, inverse, plane.normal).score < plane.score - margin)
    }

    fn any_plane(&self, i: usize) -> Plane {
        let mut chance = chance(i, ROUNDS);
        self.plane(i, self.any_depth(i, &mut chance), self.any_normal(i, &mut chance))
    }

    /// The best of a place's plane, those around it and changed ones.
    fn improved(&self, planes: &[Plane], i: usize, round: u64) -> Plane {
        if self.places[i].own.is_none() {
            return planes[i];
        }
        let carried = self.around(i).filter_map(|j| self.carried(planes[j], j, i));
        let mut best = carried.fold(planes[i], better);
        let mut chance = chance(i, round);
        let size = 0.5_f64.powi(round as i32);
        for (depth, turn) in CHANGES {
            let inverse = best.inverse * (1.0 + size * depth * chance.random_range(-1.0..1.0));
            let normal = (best.normal + anywhere(&mut chance) * (size * turn)).normalize_or(best.normal);
            best = better(best, self.plane(i, inverse, normal));
        }
        let normal = self.any_normal(i, &mut chance);
        best = better(best, self.plane(i, best.inverse, normal));
        if round < NEW_DEPTHS {
            best = better(best, self.plane(i, self.any_depth(i, &mut chance), normal));
        }
        best
    }

    /// Places around one.
    fn around(&self, i: usize) -> impl Iterator<Item = usize> {
        let [columns, rows] = [self.columns, self.places.len() / self.columns].map(|n| n as i64);
        let (column, row) = (i as i64 % columns, i as i64 / columns);
        let beside = AROUND.into_iter().map(move |[right, down]| (column + right, row + down));
        let inside = move |&(u, v): &(i64, i64)| (0..columns).contains(&u) && (0..rows).contains(&v);
        beside.filter(inside).map(move |(u, v)| (v * columns + u) as usize)
    }

    /// The plane of place `from` where the ray of place `to` meets it.
    fn carried(&self, plane: Plane, from: usize, to: usize) -> Option<Plane> {
        let [there, here] = [from, to].map(|i| self.places[i].ray.dot(plane.normal));
        let inverse = plane.inverse * here / there;
        (plane.score > 0.0 && inverse <= self.limits.nearest).then(|| self.plane(to, inverse, plane.normal))
    }

    /// One at which a surface can be, unless that is rare.
    fn any_depth(&self, i: usize, chance: &mut ChaCha8Rng) -> f64 {
        let mut any = || self.limits.nearest * chance.random_range(0.0..1.0);
        let place = &self.places[i];
        let drawn = (1..DRAWS)
            .map(|_| any())
            .find(|inverse| place.own.is_none() || self.is_possible(place, *inverse));
        drawn.unwrap_or_else(any)
    }

    fn is_possible(&self, place: &Place, inverse: f64) -> bool {
        inverse > 0.0 && (self.limits.possible)(self.view.camera.center() + place.ray / inverse)
    }

    /// Towards the camera.
    fn any_normal(&self, i: usize, chance: &mut ChaCha8Rng) -> DVec3 {
        let ray = self.places[i].ray;
        let normal = anywhere(chance).normalize_or(-ray.normalize());
        if normal.dot(ray) > 0.0 { -normal } else { normal }
    }

    /// A plane, with its score at a place.
    fn plane(&self, i: usize, inverse: f64, normal: DVec3) -> Plane {
        Plane { inverse, normal, score: self.score(&self.places[i], inverse, normal).unwrap_or(-1.0) }
    }

    /// Mean correlation of the two neighbours that agree best, or, if that is more, of the best one less what it counts less.
    fn score(&self, place: &Place, inverse: f64, normal: DVec3) -> Option<f32> {
        let own = place.own.as_ref().filter(|_| self.is_possible(place, inverse))?;
        let patch = Patch::new(&self.view.camera, place.pixel, 1.0 / inverse, normal)?;
        let correlation = |other: &&Grey| {
            let look = other.look(&patch).filter(|look| (1.0 / STRETCH..STRETCH).contains(&look.area()))?;
            let near = patch.angle(&self.view.camera, &other.camera) < WIDEST;
            near.then(|| other.correlation(look, own)).flatten()
        };
        let seen = self.others.iter().filter_map(correlation);
        let none = [f32::NEG_INFINITY; 2];
        let [first, second] = seen.fold(none, |[a, b], new| [a.max(new), b.max(new.min(a))]);
        first.is_finite().then(|| (first - ALONE).max(0.5 * (first + second)))
    }
}

/// The same numbers in every run.
fn chance(place: usize, round: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(place as u64 * (ROUNDS + 1) + round)
}

/// In a cube about the origin.
fn anywhere(chance: &mut ChaCha8Rng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| chance.random_range(-1.0..1.0)))
}

fn better(a: Plane, b: Plane) -> Plane {
    if b.score > a.score { b } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::painted::{FLOOR, SIZE, WALL, painted, view};
    use crate::windows::Pictures;

    /// All pixels; no inverse depth (1/m) is larger than this.
    fn anywhere_nearer<'a>(nearest: f64) -> Limits<'a> {
        Limits { nearest, sought: &|_| true, possible: &|_| true }
    }

    /// Of five cameras in a row, the one in the middle; what it shows at some of its pixels.
    #[test]
    fn walls_and_floors_have_their_depths_and_directions() {
        let views: Vec<_> = (0..5).map(|i| view(i, painted)).collect();
        let pictures = Pictures::new(&views);
        let search = PatchMatch::new(
            &pictures.grey[2],
            pictures.of(&[0, 1, 3, 4]).collect(),
            1.0,
            anywhere_nearer(0.5),
        );
        let planes = search.planes();
        let of_rows = |rows: std::ops::Range<usize>, normal: DVec3, inverse: &dyn Fn(f64) -> f64| {
            let places = rows.flat_map(|row| (12..60).map(move |column| row * SIZE.width + column));
            let is_right = |&i: &usize| {
                let there = inverse(search.places[i].pixel.y);
                planes[i].score > 0.9
                    && planes[i].normal.dot(normal) > 0.9
                    && (planes[i].inverse / there - 1.0).abs() < 0.05
            };
            let all = places.clone().count();
            places.filter(is_right).count() as f64 / all as f64
        };
        let wall = of_rows(8..22, DVec3::NEG_Z, &|_| 1.0 / WALL);
        // The horizon is at 24 px, the focal length 60 px.
        let floor = of_rows(38..44, DVec3::NEG_Y, &|y| (y - 24.0) / 60.0 / FLOOR);
        assert!(wall > 0.8 && floor > 0.8, "right: {wall} of the wall, {floor} of the floor");
    }
    #[test]
    fn planes_are_only_sought_where_a_surface_can_be() {
        let views: Vec<_> = (0..5).map(|i| view(i, painted)).collect();
        let pictures = Pictures::new(&views);
        let right = |pixel: DVec2| pixel.x > 36.0;
        let beyond = |place: DVec3| place.z > 0.8 * WALL;
        let limits = Limits { nearest: 0.5, sought: &right, possible: &beyond };
        let search = PatchMatch::new(&pictures.grey[2], pictures.of(&[0, 1, 3, 4]).collect(), 1.0, limits);
        let planes = search.planes();
        let found = || planes.iter().enumerate().filter(|(_, plane)| plane.score > 0.9);
        assert!(found().count() > 400, "{}", found().count());
        for (i, plane) in found() {
            let place = &search.places[i];
            assert!(right(place.pixel) && beyond(place.ray / plane.inverse), "{} {plane:?}", place.pixel);
        }
    }
}
