//! The surfaces that a view shows, as far as its matched points tell.
//!
//! On a plane the inverse depth is affine in the pixel (Gallup et al. 2010), and what has one colour is mostly one surface. So a
//! pixel of a bare road gets the affine function that fits the points around it best, those of its own colour above all.

use crate::ground::Ground;
use crate::stereo::StereoPoint;
use crate::thinning::evenly;
use crate::views::View;
use ffgs_core::{Camera, upper_median};
use glam::{DMat3, DVec2, DVec3, Vec3Swizzles};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use std::num::NonZero;

/// With fewer matched points in a view their depths say nothing of the scene, or of the foreground.
const LEAST_STILL: usize = 100;
const LEAST_MOVING: usize = 16;
/// Matched points of a view that tell its depths at most, evenly chosen: where there are many, the nearest ones lie in one place, and say little
/// of how surfaces slope.
const MOST: usize = 1000;
/// A point is hidden by so many that are nearer by this factor, within this share of the image's width.
const HIDING: (usize, f64, f64) = (3, 1.05, 0.02);
/// Matched points round a pixel that tell its depth.
const NEAREST: usize = 32;
/// Difference of colours (0 to 1, RMS over the channels) that is large.
const COLOUR: f32 = 0.06;
/// Weight of a point of another colour.
const OTHER_COLOUR: f64 = 0.02;
/// Rounds of reweighting, which approach the least absolute error.
const ROUNDS: usize = 8;
/// Least residual that counts less, as a share of the median inverse depth.
const RESIDUAL: f64 = 0.01;
/// Slopes are held back as if there were this share of the weight at the mean distance of the points, level.
const LEVEL: f64 = 0.02;
/// An inverse depth may leave the range of the points around it by this factor.
const BEYOND: f64 = 1.1;

/// A matched point in a view.
#[derive(Clone, Copy, Debug)]
struct Known {
    pixel: DVec2,
    /// Inverse depth (1/m).
    inverse: f64,
    colour: [f32; 3],
}

/// The matched points of a view, inside or outside of its mask.
pub(crate) struct Surfaces<'a> {
    known: Vec<Known>,
    tree: ImmutableKdTree<f64, 2>,
    /// The camera, and what it does not see through.
    floor: Option<(Camera, &'a Ground)>,
}

impl<'a> Surfaces<'a> {
    /// Of all that is outside the mask, none of it beneath the ground; `None` with too few points.
    pub(crate) fn still(view: &View, matched: &[StereoPoint], ground: Option<&'a Ground>) -> Option<Self> {
        let surfaces = Self::new(known(view, matched, false), LEAST_STILL)?;
        Some(Self { floor: ground.map(|ground| (view.camera, ground)), ..surfaces })
    }

    /// Of what the mask shows, from the points that no nearer ones hide: a car has two sides, of which a camera sees one. `None` with too
    /// few points.
    pub(crate) fn moving(view: &View, matched: &[StereoPoint]) -> Option<Self> {
        let all = Self::new(known(view, matched, true), LEAST_MOVING)?;
        Self::new(all.visible(view.camera.size().width as f64), LEAST_MOVING)
    }

    fn new(known: Vec<Known>, least: usize) -> Option<Self> {
        if known.len() < least.max(1) {
            return None;
        }
        let known = evenly(known, MOST);
        let places: Vec<[f64; 2]> = known.iter().map(|k| k.pixel.to_array()).collect();
        Some(Self { tree: ImmutableKdTree::new_from_slice(&places).ok()?, known, floor: None })
    }

    /// Points that no nearer ones hide, in an image of a width (px).
    fn visible(&self, width: f64) -> Vec<Known> {
        let (count, nearer, share) = HIDING;
        let reach = share * width;
        let is_visible = |k: &&Known| {
            let place = k.pixel.to_array();
            let query = self.tree.query(&place);
            let around = query.within::<SquaredEuclidean<f64>>(reach * reach).unsorted().execute();
            around.iter().filter(|n| self.known[n.item as usize].inverse > nearer * k.inverse).count() < count
        };
        self.known.iter().filter(is_visible).copied().collect()
    }

    /// Inverse depth (1/m) at a pixel of a colour: of the affine function of the pixel that fits the inverse depths round it.
    pub(crate) fn inverse_depth(&self, pixel: DVec2, colour: [f32; 3]) -> f64 {
        let count = NonZero::new(NEAREST.min(self.known.len())).expect("there are points");
        let found = self.tree.query(&pixel.to_array()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let near: Vec<&Known> = found.iter().map(|n| &self.known[n.item as usize]).collect();
        let reach = near.iter().map(|k| k.pixel.distance(pixel)).sum::<f64>() / near.len() as f64;
        let place = |k: &Known| {
            let offset = (k.pixel - pixel) / reach.max(1.0);
            DVec3::new(1.0, offset.x, offset.y)
        };
        let alike: Vec<f64> = near.iter().map(|k| alike(k.colour, colour)).collect();
        let middle = upper_median(near.iter().map(|k| k.inverse)).expect("there are neighbours");
        let mut fit = DVec3::X * middle;
        for _ in 0..ROUNDS {
            let (mut normal, mut right, mut total) = (DMat3::ZERO, DVec3::ZERO, 0.0);
            for (k, alike) in near.iter().zip(&alike) {
                let place = place(k);
                let residual = (fit.dot(place) - k.inverse).abs() / middle;
                let weight = alike / residual.max(RESIDUAL) / (1.0 + place.yz().length_squared());
                normal += DMat3::from_cols(place * place.x, place * place.y, place * place.z) * weight;
                right += place * (weight * k.inverse);
                total += weight;
            }
            normal += DMat3::from_diagonal(DVec3::new(0.0, 1.0, 1.0) * (LEVEL * total));
            fit = normal.inverse() * right;
        }
        let range = near
            .iter()
            .fold((f64::INFINITY, 0.0_f64), |(low, high), k| (low.min(k.inverse), high.max(k.inverse)));
        let fitted = fit.x.clamp(range.0 / BEYOND, range.1 * BEYOND);
        fitted.max(self.of_floor(pixel))
    }

    /// Inverse depth (1/m) of the ground at a pixel; 0 where it does not reach.
    fn of_floor(&self, pixel: DVec2) -> f64 {
        self.floor
            .as_ref()
            .and_then(|(camera, ground)| ground.depth(camera, pixel))
            .map_or(0.0, |depth| 1.0 / depth)
    }
}

/// Matched points at pixels of the foreground, or of the rest.
fn known(view: &View, matched: &[StereoPoint], foreground: bool) -> Vec<Known> {
    let seen = matched.iter().filter_map(|p| view.camera.project(p.position));
    let seen = seen.filter(|p| view.camera.shows(p.pixel) && view.is_foreground(p.pixel) == foreground);
    seen.map(|p| Known { pixel: p.pixel, inverse: 1.0 / p.depth, colour: view.colour(p.pixel) }).collect()
}

/// Weight of a point by its colour.
fn alike(a: [f32; 3], b: [f32; 3]) -> f64 {
    let square = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / 3.0;
    OTHER_COLOUR + f64::from((-0.5 * square / (COLOUR * COLOUR)).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::level;
    use crate::painted::{painted, view};

    const GREY: [f32; 3] = [0.4; 3];

    fn surfaces<'a>(points: impl Iterator<Item = (DVec2, f64, [f32; 3])>) -> Surfaces<'a> {
        let known = points.map(|(pixel, inverse, colour)| Known { pixel, inverse, colour }).collect();
        Surfaces::new(known, 1).unwrap()
    }

    /// Pixels round a bare square.
    fn rim() -> impl Iterator<Item = DVec2> {
        let grid = (0..100).map(|i| DVec2::new(f64::from(i % 10), f64::from(i / 10)) * 10.0);
        grid.filter(|p| (*p - DVec2::splat(45.0)).abs().max_element() > 30.0)
    }

    #[test]
    fn a_bare_plane_continues_its_rim() {
        let inverse = |p: DVec2| 0.05 + 0.001 * p.y + 0.0003 * p.x;
        let rim = surfaces(rim().map(|p| (p, inverse(p), GREY)));
        for pixel in [DVec2::new(45.0, 45.0), DVec2::new(30.0, 52.0)] {
            let found = rim.inverse_depth(pixel, GREY);
            assert!((found / inverse(pixel) - 1.0).abs() < 0.02, "{pixel}: {found} not {}", inverse(pixel));
        }
    }

    #[test]
    fn wrong_points_and_things_of_another_colour_do_not_bend_it() {
        let inverse = |p: DVec2| 0.05 + 0.001 * p.y;
        let points = rim().enumerate().map(|(i, p)| match i % 5 {
            0 => (p, 3.0 * inverse(p), GREY),
            1 => (p, 0.4, [0.9, 0.2, 0.2]),
            _ => (p, inverse(p), GREY),
        });
        let (pixel, points) = (DVec2::new(45.0, 45.0), surfaces(points));
        let found = points.inverse_depth(pixel, GREY);
        assert!((found / inverse(pixel) - 1.0).abs() < 0.1, "{found} not {}", inverse(pixel));
    }

    /// Points far beneath a road, as a mirror image has them: the road is nearer.
    #[test]
    fn nothing_is_seen_through_the_ground() {
        let camera = view(0, painted).camera;
        let ground = level(1.0, &[DVec3::new(0.15 * 3.75, 1.0, 3.75)]);
        let mirrored = surfaces(rim().map(|p| (p, 0.02, GREY)));
        let surfaces = Surfaces { floor: Some((camera, &ground)), ..mirrored };
        let [below, above] = [40.0, 20.0].map(|y| surfaces.inverse_depth(DVec2::new(45.0, y), GREY));
        // 16 pixels below the horizon at a focal length of 60.
        assert!((below - 16.0 / 60.0).abs() < 1e-9, "{below}");
        assert!((above - 0.02).abs() < 0.001, "{above}");
    }

    #[test]
    fn far_from_all_points_it_stays_in_their_range() {
        let points = surfaces(
            (0..40).map(|i| (DVec2::new(f64::from(i % 4), f64::from(i)), 0.1 + 0.01 * f64::from(i), GREY)),
        );
        let found = points.inverse_depth(DVec2::new(900.0, 900.0), GREY);
        assert!((0.09..=0.55).contains(&found), "{found}");
    }
}
