//! Initial points: matched features, the visual hull for what moves, and samples spread in depth for the rest.

use crate::rows::{Row, row};
use crate::stereo::{self, StereoPoint};
use crate::views::{View, load};
use crate::{PrepareError, Progress};
use crate::{foreground, spread, sweep};
use ffgs_arrays::NpzWriter;
use ffgs_dataset::Capture;
use glam::DVec3;

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
    let moving = foreground::complete(&views, &matched);
    progress.advance("points", 3, 4);
    let still = spread::background(&views, &matched);
    let text = format!(
        "{counted} {from}, {swept} by plane sweeps, {} in the visual hull, {} spread in depth",
        moving.hull.len(),
        moving.spread.len() + still.len()
    );
    rows.extend([moving.hull, moving.spread, still].concat());
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
