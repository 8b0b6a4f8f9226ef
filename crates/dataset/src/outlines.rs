//! Outlines of masks, and what they tell of the cameras' clocks.
//!
//! Seen from the other camera, an object fills a range of epipolar planes (planes through both centres). Both cameras see its
//! first and its last plane at the same moment, whatever its shape: the frontier points of Rieger ("Three-dimensional
//! motion from fixed points of a deforming profile curve", Optics Letters 1986). If the two ranges agree best when one
//! camera's frames are exchanged for later or earlier ones, the cameras are not synchronised.

use ffgs_core::{Camera, Mask};
use glam::{DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// Offsets that are tried, in frames to both sides.
const REACH: isize = 5;
const OFFSETS: usize = 2 * REACH as usize + 1;
/// Frames that are compared.
const FRAMES: usize = 60;
/// Each camera is compared with the so many after it in the list.
const PARTNERS: usize = 12;
/// Moments that a pair must have in common at every offset.
const LEAST_MOMENTS: usize = 4;
/// Pairs that a camera must have.
const LEAST_PAIRS: usize = 2;
/// Distances count no more than this: what is farther is another object or a part that is hidden. Distances are in pixels of an image whose longer side has
/// 320 ([`ffgs_core::ImageSize::enlargement`]), as outlines err by a share of the image.
const FAR: f64 = 10.0;
/// An offset is told when it divides the mean distance by this,
const BETTER: f64 = 2.0;
/// and lowers it by so much. Synchronised captures have at most a third of it.
const GAIN: f64 = 1.0;

/// The convex hull of a mask: no other point can be the first or last that an epipolar line meets.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outline {
    /// Corners (px), each with whether it touches the image's border.
    corners: Vec<([f64; 2], bool)>,
}

impl Outline {
    pub(crate) fn of(mask: &Mask) -> Self {
        let size = mask.size();
        let (right, bottom) = ((size.width - 1) as f64, (size.height - 1) as f64);
        let mut ends = Vec::new();
        for (y, row) in mask.data().chunks_exact(size.width).enumerate() {
            let first = row.iter().position(|v| *v != 0);
            let last = row.iter().rposition(|v| *v != 0);
            ends.extend(first.into_iter().chain(last).map(|x| [x as f64, y as f64]));
        }
        ends.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let mut corners = half_hull(ends.iter());
        corners.extend(half_hull(ends.iter().rev()));
        let touches = |p: [f64; 2]| p[0] < 1.0 || p[1] < 1.0 || p[0] >= right || p[1] >= bottom;
        Self { corners: corners.into_iter().map(|p| ([p[0] + 0.5, p[1] + 0.5], touches(p))).collect() }
    }
}

/// One chain of Andrew's monotone chains, without its last point.
fn half_hull<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Vec<[f64; 2]> {
    let mut chain: Vec<[f64; 2]> = Vec::new();
    for p in points {
        while let [.., a, b] = chain[..]
            && (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) <= 0.0
        {
            chain.pop();
        }
        chain.push(*p);
    }
    chain.pop();
    chain
}

/// A fixed camera and the outlines of its masks over the frames.
pub(crate) struct Watched {
    pub camera: Camera,
    pub outlines: Vec<Outline>,
}

/// For every camera the frames by which it is ahead of the others: its frame t shows what they show at t + offset. 0 where
/// it is synchronised, or where that cannot be told.
pub(crate) fn offsets(cameras: &[Watched]) -> Vec<isize> {
    let mut costs: Vec<Vec<Cost>> = cameras.iter().map(|_| Vec::new()).collect();
    for (i, a) in cameras.iter().enumerate() {
        for (j, b) in cameras.iter().enumerate().skip(i + 1).take(PARTNERS) {
            if let Some(cost) = pair_cost(a, b) {
                let mut turned = cost;
                turned.reverse();
                costs[i].push(cost);
                costs[j].push(turned);
            }
        }
    }
    costs.iter().map(|pairs| best_offset(pairs)).collect()
}

/// Distances at every offset from -REACH to REACH.
type Cost = [f64; OFFSETS];

fn best_offset(pairs: &[Cost]) -> isize {
    if pairs.len() < LEAST_PAIRS {
        return 0;
    }
    let mean = |k: usize| pairs.iter().map(|c| c[k]).sum::<f64>() / pairs.len() as f64;
    let now = mean(REACH as usize);
    let all = (0..OFFSETS).map(|k| (mean(k), k as isize - REACH));
    let (best, offset) = all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((now, 0));
    if now > BETTER * best && now - best > GAIN { offset } else { 0 }
}

/// Median distance between the ends of both ranges; `None` when some offset has too few common moments.
fn pair_cost(a: &Watched, b: &Watched) -> Option<Cost> {
    let axis = (b.camera.center() - a.camera.center()).try_normalize()?;
    let first = axis.any_orthonormal_vector();
    let planes = [first, axis.cross(first)];
    let [of_a, of_b] = [a, b].map(|w| -> Vec<Range> {
        w.outlines.iter().take(FRAMES).map(|o| range(&w.camera, o, planes)).collect()
    });
    let pixels = |w: &Watched| w.camera.intrinsics().focal() / w.camera.size().enlargement();
    let focal = pixels(a).min(pixels(b));
    let mut cost = [0.0; OFFSETS];
    for (k, cost) in cost.iter_mut().enumerate() {
        let offset = k as isize - REACH;
        let mut distances = Vec::new();
        for (t, ends) in of_a.iter().enumerate() {
            let Some(others) = t.checked_add_signed(offset).and_then(|t| of_b.get(t)) else { continue };
            let both = ends.iter().zip(others).filter_map(|(x, y)| Some((*x)? - (*y)?));
            distances.extend(both.map(|d| wrapped(d).abs() * focal));
        }
        // A short capture has no moments in common at large offsets.
        if distances.len() < LEAST_MOMENTS {
            *cost = FAR;
            if offset == 0 {
                return None;
            }
            continue;
        }
        let middle = distances.len() / 2;
        *cost = distances.select_nth_unstable_by(middle, f64::total_cmp).1.min(FAR);
    }
    Some(cost)
}

/// Angles of the first and last epipolar plane that meets an outline; `None` where the image ends first.
type Range = [Option<f64>; 2];

fn range(camera: &Camera, outline: &Outline, planes: [DVec3; 2]) -> Range {
    let rays: Vec<(DVec3, bool)> =
        outline.corners.iter().map(|(p, touches)| (camera.ray(DVec2::from(*p)), *touches)).collect();
    let middle: DVec3 = rays.iter().map(|r| r.0).sum();
    let angle = |ray: DVec3| ray.dot(planes[1]).atan2(ray.dot(planes[0]));
    let zero = angle(middle);
    let mut angles: Vec<(f64, bool)> =
        rays.iter().map(|(ray, touches)| (wrapped(angle(*ray) - zero), *touches)).collect();
    angles.sort_by(|a, b| a.0.total_cmp(&b.0));
    match (angles.first(), angles.last()) {
        // An object around the epipole has no ends.
        (Some(first), Some(last)) if last.0 - first.0 < PI / 2.0 => {
            [first, last].map(|(angle, touches)| (!touches).then_some(angle + zero))
        }
        _ => [None; 2],
    }
}

/// To -pi..pi.
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::{DMat3, DMat4};

    const SIZE: ImageSize = ImageSize { width: 160, height: 120 };

    /// Of images so many times as large.
    fn camera(i: usize, times: usize) -> Camera {
        let angle = TAU * i as f64 / 5.0;
        let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.5);
        let forward = -eye.normalize();
        let right = forward.cross(DVec3::Z).normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let pose = DMat4::from_translation(-(rotation * eye)) * DMat4::from_mat3(rotation);
        let [f, cx, cy] = [140, 80, 60].map(|v| (v * times) as f64);
        let size = ImageSize { width: SIZE.width * times, height: SIZE.height * times };
        Camera::new(Intrinsics { fx: f, fy: f, cx, cy }, pose, size).unwrap()
    }

    /// A ball that moves in a curve, seen at a time.
    fn outline(camera: &Camera, time: f64) -> Outline {
        let centre = DVec3::new(0.12 * time - 0.7, 0.3 * (0.5 * time).sin(), 0.2 * (0.4 * time).cos());
        let size = camera.size();
        let inside = |i: usize| {
            let pixel = DVec2::new((i % size.width) as f64 + 0.5, (i / size.width) as f64 + 0.5);
            let (ray, to) = (camera.ray(pixel), centre - camera.center());
            u8::from((to - ray * to.dot(ray) / ray.length_squared()).length() < 0.35)
        };
        Outline::of(&Mask::new(size, (0..size.pixels()).map(inside).collect()).unwrap())
    }

    fn rig(late: usize, by: f64) -> Vec<Watched> {
        slow_rig(late, by, 1.0, 1)
    }

    /// Of images so many times as large, before which the ball moves at so much of its speed.
    fn slow_rig(late: usize, by: f64, speed: f64, times: usize) -> Vec<Watched> {
        let watched = |i| {
            let camera = camera(i, times);
            let time = |t: i32| speed * (f64::from(t) + if i == late { by } else { 0.0 });
            Watched { outlines: (0..12).map(|t| outline(&camera, time(t))).collect(), camera }
        };
        (0..5).map(watched).collect()
    }

    #[test]
    fn larger_images_of_the_same_are_judged_alike() {
        for (speed, found) in [(0.017, [0; 5]), (0.3, [0, 0, 3, 0, 0])] {
            assert_eq!([2, 4].map(|times| offsets(&slow_rig(2, 3.0, speed, times))), [found; 2], "{speed}");
        }
    }

    #[test]
    fn the_camera_that_is_ahead_is_found_with_its_frames() {
        assert_eq!(offsets(&rig(0, 0.0)), [0; 5]);
        assert_eq!(offsets(&rig(2, 3.0)), [0, 0, 3, 0, 0]);
        assert_eq!(offsets(&rig(4, -2.0)), [0, 0, 0, 0, -2]);
    }

    #[test]
    fn what_stands_still_tells_nothing() {
        let mut still = rig(1, 0.0);
        for watched in &mut still {
            let first = watched.outlines[0].clone();
            watched.outlines.fill(first);
        }
        assert_eq!(offsets(&still), [0; 5]);
    }
}
