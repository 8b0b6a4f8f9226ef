//! The ground: the plane beneath all cameras on which most of the pictures agree.
//!
//! A bare road shows nothing to match at a single pixel, and cameras near it see it too flat. But its markings, kerbs and shadows agree between the
//! views on one plane, and thousands of windows together tell where that plane is (docs/adr/0067-the-ground-is-a-plane.md).

use crate::stereo::StereoPoint;
use crate::views::{View, at_depth};
use crate::windows::{Grey, Patch, Pictures, Window, grid, pixel};
use ffgs_core::{Camera, up};
use glam::{DVec2, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Windows that are compared to find the plane, over all views, and to find points on it.
const SAMPLES: usize = 8_000;
const PIXELS: usize = 30_000;
/// Distance between the values of a window (px): a road shows little in few pixels.
const SPACING: f64 = 1.5;
/// Least correlation with a neighbour of a window that agrees.
const AGREES: f32 = 0.7;
/// It must be larger by this than on planes that are farther and nearer by a factor: what hardly moves between two views agrees on all of them.
const CLEARER: f32 = 0.05;
const BESIDE: f64 = 1.1;
/// Largest ratio of the areas in which two views show a pixel, where the plane is sought: what is stretched is smooth, and resembles anything smooth.
const STRETCH: f64 = 5.0;
/// Planes are tried from the first to the second of these shares of the rig's extent beneath the lowest camera, each deeper by a ratio than
/// the one before.
const BENEATH: [f64; 2] = [0.01, 2.0];
const DEEPER: f64 = 1.02;
/// Steps in which the best plane is tilted (radians), and lowered or raised (shares of its distance).
const STEPS: [f64; 4] = [0.04, 0.02, 0.01, 0.005];
/// Steps of one size at most.
const REPEATS: usize = 8;
/// Largest tilt of the ground (radians).
const STEEPEST: f64 = 0.12;
/// Planes that the ground is compared with: so many steps deeper, and as many less deep, by a fifth to four fifths of the depth.
const ASIDE: RangeInclusive<usize> = 10..=30;
/// How many times as much support it has as the median of those, by how many standard deviations (of a count) more, and least share of the
/// windows.
const DISTINCT: f64 = 2.2;
const DEVIATIONS: f64 = 10.0;
const LEAST_SHARE: f64 = 0.02;
/// It reaches as far from its points as this share of the distance from the camera.
const REACH: f64 = 0.25;
/// What is farther than the ground by this factor in all views lies beneath it.
const FARTHER: f64 = 1.1;

/// The ground, as far as points were found on it.
pub(crate) struct Ground {
    plane: Plane,
    points: Vec<StereoPoint>,
    tree: ImmutableKdTree<f64, 3>,
}

/// A plane.
#[derive(Clone, Copy, Debug)]
struct Plane {
    /// Of length 1, upwards.
    normal: DVec3,
    /// `normal . x` of its points (m).
    offset: f64,
}

/// A window of a view, outside of its mask.
struct Sample {
    view: usize,
    pixel: DVec2,
    window: Window,
}

/// How many pairs of a window and a neighbour agree on a plane.
type Support<'a> = &'a dyn Fn(&Plane) -> usize;

/// How clear the best plane is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Prominence {
    /// Windows that were compared.
    windows: usize,
    /// Its support.
    support: usize,
    /// The median support of planes that are a fifth to four fifths deeper, or less deep.
    aside: usize,
}

impl Prominence {
    /// Many windows agree on a road from afar, whatever its depth: only a plane that far more agree on than on those about it is one.
    fn stands_out(self) -> bool {
        let [windows, support, aside] = [self.windows, self.support, self.aside].map(|count| count as f64);
        support > DISTINCT * aside
            && support - aside > DEVIATIONS * (aside + 1.0).sqrt()
            && support > LEAST_SHARE * windows
    }
}

impl std::fmt::Display for Prominence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { windows, support, aside } = self;
        write!(f, "{windows} windows agree {support} times, {aside} times on planes aside")
    }
}

impl Ground {
    /// By all cameras that stand near each other, or else by those of them that look the same way, of whose windows fewer agree by chance.
    /// `None` where no plane stands out; and how clear the best one is.
    pub(crate) fn find(pictures: &Pictures) -> (Option<Self>, Prominence) {
        let mut last = Prominence::default();
        for neighbours in [&pictures.around, &pictures.alike] {
            let Some((plane, prominence)) = Plane::find(pictures, neighbours) else { break };
            last = prominence;
            if prominence.stands_out() {
                return (Self::new(plane, plane.points(pictures)), prominence);
            }
        }
        (None, last)
    }

    fn new(plane: Plane, points: Vec<StereoPoint>) -> Option<Self> {
        let places: Vec<[f64; 3]> = points.iter().map(|p| p.position.to_array()).collect();
        let tree = ImmutableKdTree::new_from_slice(&places).ok().filter(|_| !places.is_empty())?;
        Some(Self { plane, points, tree })
    }

    /// The points that views agree on.
    pub(crate) fn points(&self) -> &[StereoPoint] {
        &self.points
    }

    /// Depth (m) at which a pixel shows it; `None` at and above the horizon, and far from its points.
    pub(crate) fn depth(&self, camera: &Camera, pixel: DVec2) -> Option<f64> {
        let depth = self.plane.depth(camera, pixel)?;
        let place = at_depth(camera, pixel, depth).to_array();
        let reach = REACH * depth;
        let found = self.tree.query(&place).nearest_one::<SquaredEuclidean<f64>>().execute();
        (found.distance < reach * reach).then_some(depth)
    }

    /// Whether a point lies beneath it for all views that show the point.
    pub(crate) fn hides(&self, views: &[View], point: DVec3) -> bool {
        let mut seen = views.iter().filter_map(|View { camera, .. }| {
            Some((camera, camera.project(point).filter(|p| camera.shows(p.pixel))?))
        });
        seen.all(|(camera, p)| self.depth(camera, p.pixel).is_some_and(|depth| p.depth > FARTHER * depth))
    }
}

impl Plane {
    /// The plane with the largest support; `None` of cameras that are all at one place.
    fn find(pictures: &Pictures, neighbours: &[Vec<usize>]) -> Option<(Self, Prominence)> {
        let samples = samples(pictures, SAMPLES);
        let support = |plane: &Self| {
            samples.par_iter().map(|s| plane.witnesses(pictures, neighbours, s, STRETCH)).sum::<usize>()
        };
        let tried: Vec<(usize, Self)> =
            level_planes(&pictures.grey)?.map(|plane| (support(&plane), plane)).collect();
        let at = (0..tried.len()).max_by_key(|&at| tried[at].0)?;
        let (support, plane) = refine(tried[at], &pictures.grey, &support);
        let beside = (0..tried.len()).filter(|other| ASIDE.contains(&other.abs_diff(at)));
        let mut counts: Vec<usize> = beside.map(|other| tried[other].0).collect();
        counts.sort_unstable();
        let aside = counts[counts.len() / 2];
        Some((plane, Prominence { windows: samples.len(), support, aside }))
    }

    /// Depth (m) at which a pixel shows it; `None` at and above the horizon.
    fn depth(&self, camera: &Camera, pixel: DVec2) -> Option<f64> {
        let ray = camera.ray(pixel);
        let along = (self.offset - camera.center().dot(self.normal)) / ray.dot(self.normal);
        (along > 0.0 && along.is_finite()).then(|| along * ray.dot(camera.rotation().row(2)))
    }

    /// Its points at pixels outside of the masks at which the views agree.
    fn points(&self, pictures: &Pictures) -> Vec<StereoPoint> {
        let point = |sample: Sample| {
            let depth = self.depth(&pictures.grey[sample.view].camera, sample.pixel)?;
            (self.witnesses(pictures, &pictures.around, &sample, f64::INFINITY) > 0)
                .then(|| pictures.point(sample.view, sample.pixel, depth))
        };
        samples(pictures, PIXELS).into_par_iter().filter_map(point).collect()
    }

    /// How many of the `neighbours` of the sample's view show what its window shows on the plane, and less of it a little before and behind.
    /// Views in which the window's area differs by more than a factor do not count.
    fn witnesses(
        &self,
        pictures: &Pictures,
        neighbours: &[Vec<usize>],
        sample: &Sample,
        stretch: f64,
    ) -> usize {
        let camera = &pictures.grey[sample.view].camera;
        let Some(depth) = self.depth(camera, sample.pixel) else { return 0 };
        let patch = |depth: f64| Patch::new(camera, sample.pixel, depth, self.normal);
        let [Some(here), Some(before), Some(behind)] = [depth, depth / BESIDE, depth * BESIDE].map(patch)
        else {
            return 0;
        };
        let correlation = |other: &Grey, patch: &Patch| {
            let look = other.look(patch).filter(|look| (1.0 / stretch..stretch).contains(&look.area()))?;
            other.correlation(look, &sample.window)
        };
        let agrees = |other: &&Grey| {
            let less = |found: f32| {
                let beside = [&before, &behind].map(|patch| correlation(other, patch));
                beside.into_iter().flatten().all(|beside| beside < found - CLEARER)
            };
            correlation(other, &here).is_some_and(|found| found > AGREES && less(found))
        };
        pictures.of(&neighbours[sample.view]).filter(agrees).count()
    }

    /// Tilted by small angles about the point beneath `middle`, which moves down by a share of its distance.
    fn moved(&self, middle: DVec3, [a, b, lower]: [f64; 3]) -> Self {
        let (first, second) = self.normal.any_orthonormal_pair();
        let normal = (self.normal + first * a + second * b).normalize();
        let distance = middle.dot(self.normal) - self.offset;
        let foot = middle - self.normal * (distance * (1.0 + lower));
        Self { normal, offset: foot.dot(normal) }
    }

    fn is_allowed(&self, up: DVec3, grey: &[Grey]) -> bool {
        self.normal.angle_between(up) < STEEPEST
            && grey.iter().all(|view| view.camera.center().dot(self.normal) > self.offset)
    }
}

/// Level planes beneath the lowest camera; `None` of cameras that are all at one place.
fn level_planes(grey: &[Grey]) -> Option<impl Iterator<Item = Plane>> {
    let cameras: Vec<Camera> = grey.iter().map(|view| view.camera).collect();
    let normal = up(&cameras);
    let lowest = cameras.iter().map(|c| c.center().dot(normal)).min_by(f64::total_cmp)?;
    let farthest = |a: &Camera| cameras.iter().map(|b| a.center().distance(b.center())).fold(0.0, f64::max);
    let extent = cameras.iter().map(farthest).fold(0.0, f64::max);
    let count = ((BENEATH[1] / BENEATH[0]).ln() / DEEPER.ln()) as i32;
    let plane = move |i| Plane { normal, offset: lowest - BENEATH[0] * extent * DEEPER.powi(i) };
    (extent > 0.0).then(|| (0..count).map(plane))
}

/// Windows on a grid of all views.
fn samples(pictures: &Pictures, count: usize) -> Vec<Sample> {
    let stride = pictures.stride(count);
    let of_view = |view: usize| {
        let [columns, rows] = grid(pictures.grey[view].camera.size(), stride);
        let sample = move |place: usize| {
            let pixel = pixel(place, columns, stride);
            let window = pictures.grey[view].own_window(pixel, SPACING)?;
            (!pictures.is_foreground(view, pixel)).then_some(Sample { view, pixel, window })
        };
        (0..columns * rows).filter_map(sample)
    };
    (0..pictures.grey.len()).into_par_iter().flat_map_iter(of_view).collect()
}

/// The best plane about one, found in steps that become smaller, with its support.
fn refine(mut best: (usize, Plane), grey: &[Grey], support: Support) -> (usize, Plane) {
    let up = best.1.normal;
    let middle = grey.iter().map(|view| view.camera.center()).sum::<DVec3>() / grey.len() as f64;
    for step in STEPS {
        for _ in 0..REPEATS {
            let (count, plane) = best;
            let beside = (0..3).flat_map(|axis| [step, -step].map(|by| DVec3::AXES[axis] * by));
            let planes =
                beside.map(|by| plane.moved(middle, by.to_array())).filter(|p| p.is_allowed(up, grey));
            let found = planes.map(|plane| (support(&plane), plane)).max_by_key(|(count, _)| *count);
            match found {
                Some(better) if better.0 > count => best = better,
                _ => break,
            }
        }
    }
    best
}

/// A level ground so far beneath the origin (y points down), with points at some places.
#[cfg(test)]
pub(crate) fn level(beneath: f64, places: &[DVec3]) -> Ground {
    let points = places.iter().map(|&position| StereoPoint { position, colour: [0.5; 3] }).collect();
    Ground::new(Plane { normal: DVec3::NEG_Y, offset: -beneath }, points).expect("places")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::painted::{FLOOR, SIZE, noise, on_wall, painted, view};

    /// 0.02 rad = 0.12 m at the wall.
    #[test]
    fn a_painted_floor_is_the_ground_and_its_points_lie_on_it() {
        let views: Vec<_> = (0..5).map(|i| view(i, painted)).collect();
        let pictures = Pictures::new(&views);
        let ground = Ground::find(&pictures).0.unwrap();
        let Plane { normal, offset } = ground.plane;
        assert!(normal.angle_between(DVec3::NEG_Y) < 0.02, "{normal}");
        assert!((offset + FLOOR).abs() < 0.04 * FLOOR, "{offset}");
        let points = ground.points();
        assert!(points.len() > SIZE.pixels() / 10, "{} points", points.len());
        assert!(points.iter().all(|p| (p.position.y - FLOOR).abs() < 0.15 * FLOOR));
    }

    #[test]
    fn a_wall_alone_noise_and_too_few_views_have_no_ground() {
        let wall = |p: DVec3, i| if on_wall(p) { painted(p, i) } else { 0.5 };
        let wall: Vec<_> = (0..5).map(|i| view(i, wall)).collect();
        let noise: Vec<_> = (0..5).map(|i| view(i, |_, pixel| noise(i, pixel))).collect();
        for views in [&wall[..], &noise, &wall[..1], &[]] {
            let (found, prominence) = Ground::find(&Pictures::new(views));
            assert!(found.is_none(), "{prominence} in {} views", views.len());
        }
    }

    #[test]
    fn what_stands_out_has_far_more_support_than_planes_aside() {
        let stands_out = |windows, support, aside| Prominence { windows, support, aside }.stands_out();
        // A bend in rain, a straight by night; a filmed room from above, a filmed fox on a table, walls alone.
        assert!(stands_out(3849, 207, 68) && stands_out(3866, 97, 13));
        assert!(!stands_out(3791, 66, 35) && !stands_out(5254, 364, 244) && !stands_out(5175, 79, 1));
        assert!(!stands_out(0, 0, 0) && !stands_out(100, 9, 0), "by chance");
    }

    #[test]
    fn pixels_see_it_below_the_horizon_and_nothing_beneath_it() {
        let ground = level(FLOOR, &[DVec3::new(0.0, FLOOR, 5.0)]);
        let views = [view(0, painted), view(4, painted)];
        let depth = |x: f64, y: f64| ground.depth(&views[0].camera, DVec2::new(x, y));
        // 12 pixels below the middle at a focal length of 60: 1 m in 5.
        assert!((depth(36.0, 36.0).unwrap() - 5.0).abs() < 1e-9);
        assert_eq!([depth(36.0, 24.0), depth(36.0, 10.0)], [None, None]);
        assert_eq!(
            [depth(36.0, 48.0), depth(1.0, 36.0)],
            [None, None],
            "2.5 m before and 2.5 m beside the only point"
        );
        let hidden = [0.9, 1.05, 1.3].map(|y| ground.hides(&views, DVec3::new(0.0, y * FLOOR, 6.0)));
        assert_eq!(hidden, [false, false, true]);
        assert!(!ground.hides(&views, DVec3::new(0.0, -3.0, 20.0)), "above the horizon");
    }
}
