//! Points where nothing was matched: pixels at depths that continue those of the matched points around them.
//!
//! On a plane the inverse depth is affine in the pixel (Gallup et al. 2010), and what has one colour is mostly one surface. So a
//! pixel of a bare road gets the affine function that fits the points around it best, those of its own colour above all.

use crate::hull::{Region, common_region};
use crate::rows::{Row, row};
use crate::stereo::StereoPoint;
use crate::views::View;
use ffgs_core::Camera;
use glam::{DMat3, DVec2, DVec3, Vec3Swizzles};
use rayon::prelude::*;

/// Points of the background that are made at most, over all views, and of the foreground.
const STILL: usize = 7_000;
const MOVING: usize = 4_000;
/// With fewer matched points in a view their depths say nothing of the scene, or of the foreground.
const LEAST_STILL: usize = 100;
const LEAST_MOVING: usize = 16;
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
struct Known {
    pixel: DVec2,
    inverse: f64,
    colour: [f32; 3],
}

/// Pixels of every view, outside its mask, at depths that continue those of the matched points; where there are too few, at
/// depths from a quarter to four times that of the scene.
pub(crate) fn background(views: &[View], matched: &[StereoPoint]) -> Vec<Row> {
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let region = common_region(&cameras);
    let per_view = STILL.div_ceil(views.len());
    let of_view = |view: &View| {
        let known = known(view, matched, false);
        (0..per_view).filter_map(|i| sample(view, i, &known, region)).collect::<Vec<_>>()
    };
    views.par_iter().map(of_view).collect::<Vec<_>>().concat()
}

/// Pixels of the mask of a view, one of `views`, at depths that continue those of the points that were `matched` on the foreground; none
/// where too few of them are seen.
pub(crate) fn foreground(view: &View, views: usize, matched: &[StereoPoint]) -> Vec<StereoPoint> {
    let width = view.camera.size().width;
    let known = visible(known(view, matched, true), width as f64);
    let Some(mask) = view.mask.as_ref().filter(|_| known.len() >= LEAST_MOVING) else { return Vec::new() };
    let inside: Vec<usize> = (0..mask.data().len()).filter(|&i| mask.data()[i] > 0).collect();
    let count = MOVING.div_ceil(views).min(inside.len());
    let point = |k: usize| {
        let i = inside[k * inside.len() / count];
        let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let colour = colour(view, pixel);
        StereoPoint { position: at_depth(view, pixel, 1.0 / inverse_depth(&known, pixel, colour)), colour }
    };
    (0..count).into_par_iter().map(point).collect()
}

/// Matched points at pixels of the foreground, or of the rest.
fn known(view: &View, matched: &[StereoPoint], foreground: bool) -> Vec<Known> {
    let seen = matched.iter().filter_map(|p| view.camera.project(p.position));
    let seen = seen.filter(|p| view.camera.shows(p.pixel) && is_foreground(view, p.pixel) == foreground);
    seen.map(|p| Known { pixel: p.pixel, inverse: 1.0 / p.depth, colour: colour(view, p.pixel) }).collect()
}

fn is_foreground(view: &View, pixel: DVec2) -> bool {
    view.mask.as_ref().is_some_and(|m| m.contains(pixel.x as usize, pixel.y as usize))
}

/// Points that no nearer ones hide: a car has two sides, of which a camera sees one.
fn visible(known: Vec<Known>, width: f64) -> Vec<Known> {
    let (count, nearer, share) = HIDING;
    let hides = |k: &Known, other: &Known| {
        other.inverse > nearer * k.inverse && other.pixel.distance(k.pixel) < share * width
    };
    let hidden: Vec<bool> =
        known.iter().map(|k| known.iter().filter(|other| hides(k, other)).count() >= count).collect();
    known.into_iter().zip(hidden).filter(|(_, hidden)| !hidden).map(|(k, _)| k).collect()
}

/// The point of a pixel at a depth.
fn at_depth(view: &View, pixel: DVec2, depth: f64) -> DVec3 {
    let ray = view.camera.ray(pixel);
    let forward = view.camera.rotation().transpose() * DVec3::Z;
    view.camera.center() + ray * (depth / ray.dot(forward))
}

fn colour(view: &View, pixel: DVec2) -> [f32; 3] {
    view.image.pixel(pixel.y as usize * view.image.size().width + pixel.x as usize)
}

/// The `i`-th sample of a view: a low-discrepancy pixel, so that few samples cover the picture.
fn sample(view: &View, i: usize, known: &[Known], region: Region) -> Option<Row> {
    let size = view.camera.size();
    let pixel = DVec2::new(halton(i, 2) * size.width as f64, halton(i, 3) * size.height as f64);
    if is_foreground(view, pixel) {
        return None;
    }
    let colour = colour(view, pixel);
    let depth = if known.len() >= LEAST_STILL {
        1.0 / inverse_depth(known, pixel, colour)
    } else {
        let distance = view.camera.center().distance((region.low + region.high) / 2.0);
        distance * 4.0_f64.powf(2.0 * halton(i, 5) - 1.0)
    };
    Some(row(at_depth(view, pixel, depth), colour, false))
}

/// The affine function of the pixel that fits the inverse depths round it, at the pixel.
fn inverse_depth(known: &[Known], pixel: DVec2, colour: [f32; 3]) -> f64 {
    let mut near: Vec<(f64, &Known)> = known.iter().map(|k| (k.pixel.distance_squared(pixel), k)).collect();
    let count = NEAREST.min(near.len());
    near.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0));
    let near: Vec<&Known> = near[..count].iter().map(|(_, k)| *k).collect();
    let reach = near.iter().map(|k| k.pixel.distance(pixel)).sum::<f64>() / count as f64;
    let place = |k: &Known| {
        let offset = (k.pixel - pixel) / reach.max(1.0);
        DVec3::new(1.0, offset.x, offset.y)
    };
    let alike: Vec<f64> = near.iter().map(|k| alike(k.colour, colour)).collect();
    let middle = median(near.iter().map(|k| k.inverse).collect());
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
    fit.x.clamp(range.0 / BEYOND, range.1 * BEYOND)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Weight of a point by its colour.
fn alike(a: [f32; 3], b: [f32; 3]) -> f64 {
    let square = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / 3.0;
    OTHER_COLOUR + f64::from((-0.5 * square / (COLOUR * COLOUR)).exp())
}

/// Halton's sequence in a base, from its 20th member on.
fn halton(i: usize, base: usize) -> f64 {
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

    const GREY: [f32; 3] = [0.4; 3];

    fn known(points: impl Iterator<Item = (DVec2, f64, [f32; 3])>) -> Vec<Known> {
        points.map(|(pixel, inverse, colour)| Known { pixel, inverse, colour }).collect()
    }

    /// Pixels round a bare square.
    fn rim() -> impl Iterator<Item = DVec2> {
        let grid = (0..100).map(|i| DVec2::new(f64::from(i % 10), f64::from(i / 10)) * 10.0);
        grid.filter(|p| (*p - DVec2::splat(45.0)).abs().max_element() > 30.0)
    }

    #[test]
    fn a_bare_plane_continues_its_rim() {
        let inverse = |p: DVec2| 0.05 + 0.001 * p.y + 0.0003 * p.x;
        let rim = known(rim().map(|p| (p, inverse(p), GREY)));
        for pixel in [DVec2::new(45.0, 45.0), DVec2::new(30.0, 52.0)] {
            let found = inverse_depth(&rim, pixel, GREY);
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
        let (pixel, points) = (DVec2::new(45.0, 45.0), known(points));
        let found = inverse_depth(&points, pixel, GREY);
        assert!((found / inverse(pixel) - 1.0).abs() < 0.1, "{found} not {}", inverse(pixel));
    }

    #[test]
    fn far_from_all_points_it_stays_in_their_range() {
        let points = known(
            (0..40).map(|i| (DVec2::new(f64::from(i % 4), f64::from(i)), 0.1 + 0.01 * f64::from(i), GREY)),
        );
        let found = inverse_depth(&points, DVec2::new(900.0, 900.0), GREY);
        assert!((0.09..=0.55).contains(&found), "{found}");
    }
}
