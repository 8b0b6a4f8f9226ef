//! Points from descriptors that are matched between neighbouring cameras along epipolar lines.

use crate::views::View;
use ffgs_core::Camera;
use ffgs_trackers::{Frame, TrackerConfig, nearest_two};
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

/// Cameras that each camera is matched with.
pub(crate) const NEIGHBOURS: usize = 4;
/// Largest angle between the axes of two cameras that are matched: upright descriptors see little beyond it.
pub(crate) const WIDEST_ANGLE: f64 = 0.9;
/// Distance from an epipolar line in parts of the image's width, at least a pixel and a half.
const LINE: f64 = 0.002;
const LEAST_LINE_PX: f64 = 1.5;
/// Lowe's ratio along a line, where few others compete.
pub(crate) const RATIO: f32 = 0.8;
/// Least angle between two rays: below it the depth is not known.
const LEAST_ANGLE: f64 = 0.02;
/// Keypoints of a picture.
const KEYPOINTS: usize = 4000;

/// A triangulated point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StereoPoint {
    pub position: DVec3,
    /// sRGB (0 to 1).
    pub colour: [f32; 3],
}

/// The pictures of views with their keypoints, the strongest first.
pub(crate) fn described(views: &[View]) -> Vec<Frame> {
    let config = TrackerConfig { corners: 2 * KEYPOINTS, described: KEYPOINTS, ..TrackerConfig::default() };
    views.par_iter().map(|view| Frame::new(&view.image, None, &config)).collect()
}

/// All points that pairs of neighbouring cameras agree on. `frames` are the pictures of the views.
pub(crate) fn points(views: &[View], frames: &[Frame]) -> Vec<StereoPoint> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let found: Vec<Vec<StereoPoint>> =
        neighbours(&cameras).into_par_iter().map(|(a, b)| pair_points(views, frames, a, b)).collect();
    found.concat()
}

/// The pairs of cameras that are matched.
pub(crate) fn neighbours(cameras: &[Camera]) -> Vec<(usize, usize)> {
    pairs(cameras, NEIGHBOURS, WIDEST_ANGLE)
}

/// Each camera with the `count` nearest whose axes are within an angle, every pair once.
pub(crate) fn pairs(cameras: &[Camera], count: usize, widest: f64) -> Vec<(usize, usize)> {
    let axis = |c: &Camera| c.rotation().transpose() * DVec3::Z;
    let mut out = Vec::new();
    for (i, a) in cameras.iter().enumerate() {
        let fits = |j: &usize| *j != i && axis(a).angle_between(axis(&cameras[*j])) < widest;
        let mut others: Vec<usize> = (0..cameras.len()).filter(fits).collect();
        others.sort_by(|&j, &k| {
            a.center().distance(cameras[j].center()).total_cmp(&a.center().distance(cameras[k].center()))
        });
        out.extend(others.into_iter().take(count).map(|j| (i.min(j), i.max(j))));
    }
    out.sort_unstable();
    out.dedup();
    out
}

fn pair_points(views: &[View], frames: &[Frame], a: usize, b: usize) -> Vec<StereoPoint> {
    let (first, second) = (&views[a].camera, &views[b].camera);
    let there = along_lines(first, second, &frames[a], &frames[b]);
    let back = along_lines(second, first, &frames[b], &frames[a]);
    let point = |(i, found): (usize, &Option<usize>)| {
        let j = (*found)?;
        (back[j] == Some(i)).then_some(())?;
        let (p, q) = (pixel(frames[a].keypoints()[i]), pixel(frames[b].keypoints()[j]));
        let position = between(first, p, second, q)?;
        Some(StereoPoint { position, colour: views[a].colour(p) })
    };
    there.iter().enumerate().filter_map(point).collect()
}

pub(crate) fn pixel(p: [f32; 2]) -> DVec2 {
    DVec2::new(p[0].into(), p[1].into())
}

/// For every keypoint of `from` the distinct nearest one near its epipolar line in `to`.
fn along_lines(from: &Camera, to: &Camera, a: &Frame, b: &Frame) -> Vec<Option<usize>> {
    let (fundamental, reach) = (fundamental(from, to), reach(to));
    let ends: Vec<DVec2> = b.keypoints().iter().map(|q| pixel(*q)).collect();
    let find = |(p, d): (&[f32; 2], &ffgs_trackers::Descriptor)| {
        let line = fundamental * pixel(*p).extend(1.0);
        let norm = line.truncate().length();
        let near = |j: &usize| (line.dot(ends[*j].extend(1.0))).abs() <= reach * norm;
        let found = nearest_two(d, b.descriptors(), (0..ends.len()).filter(near))?;
        found.is_distinct(RATIO).then_some(found.index)
    };
    a.keypoints().iter().zip(a.descriptors()).map(find).collect()
}

/// Distance (px) from an epipolar line at which a place still lies on it.
pub(crate) fn reach(camera: &Camera) -> f64 {
    (LINE * camera.size().width as f64).max(LEAST_LINE_PX)
}

/// The matrix that takes a pixel of `from` to its line in `to` (Hartley and Zisserman, 9.2).
pub(crate) fn fundamental(from: &Camera, to: &Camera) -> DMat3 {
    let rotation = to.rotation() * from.rotation().transpose();
    let t = to.translation() - rotation * from.translation();
    let cross =
        DMat3::from_cols(DVec3::new(0.0, t.z, -t.y), DVec3::new(-t.z, 0.0, t.x), DVec3::new(t.y, -t.x, 0.0));
    let inverse = |c: &Camera| {
        let k = c.intrinsics();
        DMat3::from_cols(DVec3::new(k.fx, 0.0, 0.0), DVec3::new(0.0, k.fy, 0.0), DVec3::new(k.cx, k.cy, 1.0))
            .inverse()
    };
    inverse(to).transpose() * cross * rotation * inverse(from)
}

/// The middle of the shortest line between two rays; `None` when they are nearly parallel or meet behind a camera.
pub(crate) fn between(first: &Camera, p: DVec2, second: &Camera, q: DVec2) -> Option<DVec3> {
    let (u, v) = (first.ray(p), second.ray(q));
    let w = second.center() - first.center();
    let cosine = u.dot(v);
    let sine_squared = 1.0 - cosine * cosine;
    if !(sine_squared > LEAST_ANGLE * LEAST_ANGLE) {
        return None;
    }
    let s = (w.dot(u) - cosine * w.dot(v)) / sine_squared;
    let t = (cosine * w.dot(u) - w.dot(v)) / sine_squared;
    (s > 0.0 && t > 0.0).then(|| (first.center() + u * s + second.center() + v * t) / 2.0)
}
