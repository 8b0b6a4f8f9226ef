//! Places for new Gaussians where foreground is seen that no Gaussian explains: space carving by masks and colours (Kutulakos
//! and Seitz 2000), one ray after another.
//!
//! Along the ray of such a pixel, a place is possible when it lies before what stands still, and in the masks of all views
//! that see it but for the slack. Of the possible places the one is taken where the other views that lack an explanation
//! there show the same colours.

use crate::validation::{Slack, validate};
use crate::view_counts::ViewCounts;
use ffgs_core::{Camera, ImageRgb8, Mask, median};
use glam::{DVec2, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::collections::HashSet;

/// What a view says of the places for new Gaussians.
#[derive(Clone, Debug)]
pub struct SeedView<'a> {
    /// Camera.
    pub camera: &'a Camera,
    /// Photograph.
    pub image: &'a ImageRgb8,
    /// All foreground, grown as for marking.
    pub mask: Mask,
    /// Foreground that no moving Gaussian explains.
    pub unexplained: &'a Mask,
    /// (H, W) depth of what stands still (m); infinite where nothing does.
    pub depth: Vec<f32>,
}

/// A place for a new Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seed {
    /// World (m).
    pub position: DVec3,
    /// sRGB (0 to 1).
    pub colour: [f32; 3],
}

/// Depths tried along a ray, in a geometric series.
const DEPTHS: usize = 192;
/// The nearest of them, as a share of the farthest.
const NEAREST: f64 = 1.0 / 64.0;
/// Fewest views in which a place is unexplained.
const LEAST_VIEWS: u32 = 2;
/// Difference of two patches (0 to 1 per channel) from which on they say nothing for a place.
const UNLIKE: f32 = 0.15;
/// Up to this multiple of the depth of what stands still, a place counts as in front of it.
const IN_FRONT: f64 = 1.02;
/// Distances between cameras that are searched where nothing stands.
const APART: f64 = 10.0;
/// Pixels of a patch, from its centre.
const PATCH: [(isize, isize); 5] = [(0, 0), (-2, 0), (2, 0), (0, -2), (0, 2)];

/// Places for at most about `most` Gaussians: those that pixels of a grid in each view show, one for each cell of space.
pub fn seeds(views: &[SeedView], slack: Slack, most: usize) -> Vec<Seed> {
    let pixels: usize = views.iter().map(|view| view.unexplained.count()).sum();
    let stride = ((pixels as f64 / most.max(1) as f64).sqrt().ceil() as usize).max(1);
    let farthest = farthest(views);
    let of_view = |v: usize| {
        let size = views[v].camera.size();
        let open = |&p: &usize| {
            let (x, y) = (p % size.width, p / size.width);
            x % stride == 0 && y % stride == 0 && views[v].unexplained.contains(x, y)
        };
        let pixels: Vec<usize> = (0..size.pixels()).filter(open).collect();
        let found: Vec<Option<Found>> =
            pixels.par_iter().map(|&p| seed(views, v, p, farthest, slack)).collect();
        found.into_iter().flatten().collect::<Vec<_>>()
    };
    best_of_each_cell((0..views.len()).flat_map(of_view).collect(), stride as f64)
}

/// A place with how well views agree on it, and the size of a pixel there (m).
struct Found {
    seed: Seed,
    score: f32,
    pixel: f64,
}

/// Of the places in a cell the one that views agree on best: each surface is seen by several views, and needs no more than one Gaussian for
/// each pixel of one of them. The cells are so many pixels large, of the median size.
fn best_of_each_cell(mut found: Vec<Found>, pixels: f64) -> Vec<Seed> {
    let Some(pixel) = median(found.iter().map(|found| found.pixel)) else { return Vec::new() };
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut seeds: Vec<Seed> = found.into_iter().map(|found| found.seed).collect();
    first_of_each_cell(&mut seeds, pixels * pixel, |seed| seed.position);
    seeds
}

/// Keeps the first of the places in each cube of side `cell` (m).
pub fn first_of_each_cell<T>(places: &mut Vec<T>, cell: f64, position: impl Fn(&T) -> DVec3) {
    let mut taken = HashSet::new();
    places.retain(|place| taken.insert((position(place) / cell).floor().as_i64vec3()));
}

/// Distance (m) up to which rays are searched that meet nothing: that of the farthest thing behind any foreground, or many
/// times that of the cameras from each other.
fn farthest(views: &[SeedView]) -> f64 {
    let depths = views.iter().flat_map(|view| view.depth.iter().copied());
    let behind = depths.filter(|d| d.is_finite()).fold(0.0, f32::max);
    let apart = |view: &SeedView| view.camera.center().distance(views[0].camera.center());
    if behind > 0.0 { f64::from(behind) } else { APART * views.iter().map(apart).fold(0.0, f64::max) }
}

/// The place that pixel `p` of view `v` shows.
fn seed(views: &[SeedView], v: usize, p: usize, farthest: f64, slack: Slack) -> Option<Found> {
    let view = &views[v];
    let width = view.camera.size().width;
    let (x, y) = (p % width, p / width);
    let ray = view.camera.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
    let axis = view.camera.rotation().transpose().z_axis;
    let behind = f64::from(view.depth[p]);
    let end = if behind.is_finite() { behind * IN_FRONT } else { farthest } / ray.dot(axis);
    let own = patch(view.image, x, y);
    let place = |k: usize| {
        let share = NEAREST.powf(1.0 - k as f64 / (DEPTHS - 1) as f64);
        view.camera.center() + ray * (end * share)
    };
    let judged = (0..DEPTHS).filter_map(|k| Some((agreement(views, v, place(k), &own, slack)?, k)));
    let (score, best) = judged.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
    let seed = Seed { position: place(best), colour: view.image.pixel(p) };
    let pixel = (seed.position - view.camera.center()).dot(axis) / view.camera.intrinsics().focal();
    (score > 0.0).then_some(Found { seed, score, pixel })
}

/// How well the other views that lack an explanation at `place` agree with the patch `own` of view `v`; `None` when the
/// place is not possible.
fn agreement(views: &[SeedView], v: usize, place: DVec3, own: &Patch, slack: Slack) -> Option<f32> {
    let (mut counts, mut open, mut score) = (ViewCounts { inside: 1, seen: 1 }, 1, 0.0);
    for (_, view) in views.iter().enumerate().filter(|(u, _)| *u != v) {
        let camera = view.camera;
        let Some(shown) = camera.project(place).filter(|shown| camera.shows(shown.pixel)) else { continue };
        let (x, y) = (shown.pixel.x as usize, shown.pixel.y as usize);
        if shown.depth > IN_FRONT * f64::from(view.depth[y * camera.size().width + x]) {
            continue;
        }
        counts.seen += 1;
        counts.inside += u32::from(view.mask.contains(x, y));
        if view.unexplained.contains(x, y) {
            open += 1;
            score += (UNLIKE - difference(own, &patch(view.image, x, y))).max(0.0);
        }
    }
    (open >= LEAST_VIEWS && validate(counts, slack)).then_some(score)
}

type Patch = [[f32; 3]; PATCH.len()];

fn patch(image: &ImageRgb8, x: usize, y: usize) -> Patch {
    let size = image.size();
    PATCH.map(|(dx, dy)| {
        let (x, y) = (
            x.saturating_add_signed(dx).min(size.width - 1),
            y.saturating_add_signed(dy).min(size.height - 1),
        );
        image.pixel(y * size.width + x)
    })
}

/// Mean absolute difference of their channels.
fn difference(a: &Patch, b: &Patch) -> f32 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).sum::<f32>() / (3 * PATCH.len()) as f32
}

/// Per new place (m), the step of the nearest of `places` (m).
pub fn steps_of_nearest(places: &[[f32; 3]], steps: &[DVec3], new: &[[f32; 3]]) -> Vec<DVec3> {
    if places.is_empty() {
        return vec![DVec3::ZERO; new.len()];
    }
    let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(places).expect("finite places");
    let nearest = |place: &[f32; 3]| {
        steps[tree.query(place).nearest_one::<SquaredEuclidean<f32>>().execute().item as usize]
    };
    new.par_iter().map(nearest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::{DMat3, DMat4};

    const SIZE: ImageSize = ImageSize { width: 120, height: 90 };
    const SLACK: Slack = Slack { views: 0, share: 0.2, all_views: false };

    /// On a circle of radius 4 m around the origin, over an arc (rad), looking at it.
    fn arc(count: usize, angle: f64) -> Vec<Camera> {
        let intrinsics = Intrinsics { fx: 120.0, fy: 120.0, cx: 60.0, cy: 45.0 };
        let camera = |i: usize| {
            let a = angle * i as f64 / (count - 1) as f64;
            let eye = DVec3::new(4.0 * a.cos(), 4.0 * a.sin(), 0.5);
            let forward = -eye.normalize();
            let right = forward.cross(DVec3::Z).normalize();
            let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
            let mut pose = DMat4::from_mat3(rotation);
            pose.w_axis = (-(rotation * eye)).extend(1.0);
            Camera::new(intrinsics, pose, SIZE).unwrap()
        };
        (0..count).map(camera).collect()
    }

    /// A ball of radius 0.5 m at the origin, its colour a function of the place, as a camera sees it.
    fn ball(camera: &Camera) -> (ImageRgb8, Mask) {
        let (mut image, mut mask) = (Vec::new(), Vec::new());
        for p in 0..SIZE.pixels() {
            let pixel = DVec2::new((p % SIZE.width) as f64 + 0.5, (p / SIZE.width) as f64 + 0.5);
            let (eye, ray) = (camera.center(), camera.ray(pixel));
            let along = -eye.dot(ray);
            let across = (eye + ray * along).length();
            let hit = (across < 0.5).then(|| eye + ray * (along - (0.25 - across * across).sqrt()));
            mask.push(u8::from(hit.is_some()));
            let colour = hit.map_or([0.1; 3], |p| [p.x, p.y, p.z].map(|v| 0.5 + 0.4 * (9.0 * v).sin()));
            image.extend(colour.map(|v| (v * 255.0) as u8));
        }
        (ImageRgb8::new(SIZE, image).unwrap(), Mask::new(SIZE, mask).unwrap())
    }

    fn found(cameras: &[Camera], behind: f32, open: impl Fn(usize) -> bool) -> Vec<Seed> {
        let seen: Vec<(ImageRgb8, Mask)> = cameras.iter().map(ball).collect();
        let nothing = Mask::filled(SIZE, false);
        let view = |v: usize| SeedView {
            camera: &cameras[v],
            image: &seen[v].0,
            mask: seen[v].1.clone(),
            unexplained: if open(v) { &seen[v].1 } else { &nothing },
            depth: vec![behind; SIZE.pixels()],
        };
        let views: Vec<SeedView> = (0..cameras.len()).map(view).collect();
        seeds(&views, SLACK, 4000)
    }

    #[test]
    fn seeds_lie_on_the_surface_that_all_views_show() {
        let seeds = found(&arc(5, 1.2), 6.0, |_| true);
        assert!(seeds.len() > 1000, "{}", seeds.len());
        let mut away: Vec<f64> = seeds.iter().map(|seed| (seed.position.length() - 0.5).abs()).collect();
        away.sort_by(f64::total_cmp);
        let [median, most] = [0.5, 0.9].map(|share| away[(share * away.len() as f64) as usize]);
        assert!(median < 0.03 && most < 0.12, "{median} {most}");
        let colour = |p: DVec3| [p.x, p.y, p.z].map(|v| 0.5 + 0.4 * (9.0 * v).sin());
        let right = |seed: &&Seed| (colour(seed.position)[2] - f64::from(seed.colour[2])).abs() < 0.2;
        assert!(seeds.iter().filter(right).count() * 10 > seeds.len() * 9);
    }

    #[test]
    fn a_surface_that_more_views_show_gets_no_more_seeds() {
        let [few, many] = [3, 9].map(|count| found(&arc(count, 1.2), 6.0, |_| true).len());
        assert!(few > 800 && many * 2 < few * 3, "{few} seeds of three views, {many} of nine");
    }

    #[test]
    fn one_view_alone_is_not_believed_and_nothing_lies_behind_what_stands_still() {
        let cameras = arc(5, 1.2);
        assert!(found(&cameras, 6.0, |v| v == 2).is_empty());
        assert!(found(&cameras, 2.0, |_| true).is_empty(), "a wall stands before the ball");
        assert!(found(&cameras, 6.0, |v| v < 2).len() > 200);
        assert!(found(&cameras, f32::INFINITY, |_| true).len() > 1000, "nothing stands behind");
    }

    #[test]
    fn new_places_take_the_steps_of_the_nearest() {
        let places = [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]];
        let steps = [DVec3::X, DVec3::Y];
        assert_eq!(
            steps_of_nearest(&places, &steps, &[[4.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
            [DVec3::Y, DVec3::X]
        );
        assert_eq!(steps_of_nearest(&[], &[], &[[1.0; 3]]), [DVec3::ZERO]);
    }
}
