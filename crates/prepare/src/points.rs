//! Initial points: matched features, the visual hull for what moves, and samples spread in depth for the rest.

use crate::hull::{Hull, Silhouette, common_region, hull};
use crate::rows::{Row, row};
use crate::stereo::{self, StereoPoint};
use crate::views::{View, load};
use crate::{PrepareError, Progress};
use crate::{spread, sweep};
use ffgs_arrays::NpzWriter;
use ffgs_core::Camera;
use ffgs_dataset::Capture;
use glam::DVec3;

/// Points of the hull at most.
const HULL_POINTS: usize = 2_500;

/// Writes `init_pt_cld.npz`. `known` are points of the calibration's own program. Returns what was done.
pub(crate) fn make(
    capture: &Capture,
    known: &[StereoPoint],
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    progress.advance("points", 0, 4);
    let views = load(capture)?;
    let pairs: Vec<_> = views.iter().map(|v| (v.camera, v.image.clone())).collect();
    let (mut matched, from) = if known.is_empty() {
        (stereo::points(&pairs), "matched between cameras")
    } else {
        (known.to_vec(), "of the calibration")
    };
    let counted = matched.len();
    progress.advance("points", 1, 4);
    matched.extend(sweep::points(&pairs, &matched));
    let swept = matched.len() - counted;
    progress.advance("points", 2, 4);
    let mut rows = rows_of(&views, &matched);
    let hull = hull_rows(&views);
    progress.advance("points", 3, 4);
    let depth = spread::rows(&views, &matched);
    let text = format!(
        "{counted} {from}, {swept} by plane sweeps, {} in the visual hull, {} spread in depth",
        hull.len(),
        depth.len()
    );
    rows.extend(hull);
    rows.extend(depth);
    NpzWriter::new().f32("data", &[rows.len(), 7], rows.as_flattened()).write(&capture.points_path())?;
    progress.advance("points", 4, 4);
    Ok(text)
}

/// Writes points that need no others.
pub(crate) fn keep(capture: &Capture, points: &[StereoPoint]) -> Result<String, PrepareError> {
    let views = load(capture)?;
    let rows = rows_of(&views, points);
    NpzWriter::new().f32("data", &[rows.len(), 7], rows.as_flattened()).write(&capture.points_path())?;
    Ok(format!("{} of the footage", rows.len()))
}

fn rows_of(views: &[View], points: &[StereoPoint]) -> Vec<Row> {
    points.iter().map(|p| row(p.position, p.colour, on_foreground(views, p.position))).collect()
}

/// Whether more than half of the views that see a point have it in their mask.
fn on_foreground(views: &[View], p: DVec3) -> bool {
    let (mut seen, mut inside) = (0, 0);
    for view in views {
        let (Some(mask), Some((x, y))) = (&view.mask, view.camera.pixel_of(p)) else { continue };
        seen += 1;
        inside += usize::from(mask.contains(x, y));
    }
    2 * inside > seen
}

fn hull_rows(views: &[View]) -> Vec<Row> {
    let silhouettes: Vec<Silhouette> =
        views.iter().filter_map(|v| Some(Silhouette { camera: v.camera, mask: v.mask.clone()? })).collect();
    if silhouettes.len() < 2 || silhouettes.iter().all(|s| s.mask.count() == 0) {
        return Vec::new();
    }
    let cameras: Vec<Camera> = silhouettes.iter().map(|s| s.camera).collect();
    let least = if silhouettes.len() > 2 { 3 } else { 2 };
    let hull = hull(&silhouettes, common_region(&cameras), least);
    let surface = surface(&hull);
    let step = surface.len().div_ceil(HULL_POINTS).max(1);
    surface.into_iter().step_by(step).filter_map(|p| Some(row(p, colour(views, p)?, true))).collect()
}

/// Voxels with a free neighbour.
fn surface(hull: &Hull) -> Vec<DVec3> {
    let Some(low) = hull.centres.iter().copied().reduce(DVec3::min) else { return Vec::new() };
    let key = |p: DVec3| ((p - low) / hull.side).round().as_ivec3();
    let occupied: std::collections::HashSet<_> = hull.centres.iter().map(|p| key(*p)).collect();
    let sides = [glam::IVec3::X, glam::IVec3::Y, glam::IVec3::Z];
    let free =
        |p: &DVec3| sides.iter().any(|s| [key(*p) + *s, key(*p) - *s].iter().any(|k| !occupied.contains(k)));
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
