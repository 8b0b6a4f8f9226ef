//! Points of what moves, beside those that were matched: pixels at depths that continue those, and the visual hull where no such
//! pixel shows the surface.
//!
//! A visual hull is larger than what it holds: it reaches along the rays where few directions look, and has phantoms where the cones of
//! different things meet. So it only fills what nothing more certain explains.

use crate::free_space::FreeSpace;
use crate::hull::{Hull, hulls};
use crate::region::common_region;
use crate::rows::{Row, row};
use crate::silhouettes::Silhouette;
use crate::spread;
use crate::stereo::StereoPoint;
use crate::unexplained::Unexplained;
use crate::views::View;
use ffgs_core::Camera;
use glam::{DVec3, IVec3};
use std::collections::HashSet;

/// Points of the hull at most.
const HULL_POINTS: usize = 2_500;

/// Points of what moves.
#[derive(Default)]
pub(crate) struct Foreground {
    pub spread: Vec<Row>,
    pub hull: Vec<Row>,
}

/// Points that complete those that were `matched`; none without masks of at least two views. Left out are those that views look through.
pub(crate) fn complete(views: &[View], matched: &[StereoPoint], space: &FreeSpace) -> Foreground {
    let silhouettes: Vec<Silhouette> =
        views.iter().filter_map(|v| Some(Silhouette { camera: v.camera, mask: v.mask.clone()? })).collect();
    if silhouettes.len() < 2 || silhouettes.iter().all(|s| s.mask.count() == 0) {
        return Foreground::default();
    }
    let cameras: Vec<Camera> = silhouettes.iter().map(|s| s.camera).collect();
    let least = if silhouettes.len() > 2 { 3 } else { 2 };
    let [hull] = hulls(&silhouettes, common_region(&cameras), [least]);
    let occupied: HashSet<IVec3> = hull.centres.iter().map(|c| hull.voxel(*c)).collect();
    let near = |p: DVec3| around(hull.voxel(p)).any(|voxel| occupied.contains(&voxel));
    let matched: Vec<StereoPoint> = matched.iter().filter(|p| near(p.position)).copied().collect();
    let explain = |view: &View| {
        let mut unexplained = Unexplained::new(view)?;
        let mut points = spread::foreground(view, views.len(), &matched);
        points.retain(|p| near(p.position));
        let points = space.keep_alike(points);
        unexplained.explain(&points);
        Some((unexplained, points))
    };
    let (unexplained, points): (Vec<Unexplained>, Vec<Vec<StereoPoint>>) =
        views.iter().filter_map(explain).unzip();
    let spread = points.concat().iter().map(|p| row(p.position, p.colour, true)).collect();
    Foreground { spread, hull: hull_rows(views, &hull, &unexplained) }
}

/// Voxels of the hull's surface that something is missing without.
fn hull_rows(views: &[View], hull: &Hull, unexplained: &[Unexplained]) -> Vec<Row> {
    let missing: Vec<DVec3> =
        surface(hull).into_iter().filter(|p| Unexplained::lacks(unexplained, *p)).collect();
    let step = missing.len().div_ceil(HULL_POINTS).max(1);
    missing.into_iter().step_by(step).filter_map(|p| Some(row(p, colour(views, p)?, true))).collect()
}

/// A voxel and those at its six sides.
fn around(voxel: IVec3) -> impl Iterator<Item = IVec3> {
    let sides = IVec3::AXES.into_iter().flat_map(|side| [side, -side]);
    std::iter::once(IVec3::ZERO).chain(sides).map(move |side| voxel.saturating_add(side))
}

/// Voxels with a free neighbour.
fn surface(hull: &Hull) -> Vec<DVec3> {
    let occupied: HashSet<IVec3> = hull.centres.iter().map(|c| hull.voxel(*c)).collect();
    let free = |p: &DVec3| around(hull.voxel(*p)).any(|voxel| !occupied.contains(&voxel));
    hull.centres.iter().copied().filter(free).collect()
}

/// The median colour, channel by channel, of the views that see a point.
fn colour(views: &[View], p: DVec3) -> Option<[f32; 3]> {
    let seen = views.iter().filter_map(|v| {
        let (x, y) = v.camera.pixel_of(p)?;
        Some(v.image.pixel(y * v.image.size().width + x))
    });
    let seen: Vec<[f32; 3]> = seen.collect();
    let median = |c: usize| {
        let mut values: Vec<f32> = seen.iter().map(|v| v[c]).collect();
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    };
    (!seen.is_empty()).then(|| std::array::from_fn(median))
}
