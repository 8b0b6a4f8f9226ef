//! Initial points: matched features, the visual hull for what moves, and samples spread in depth for the rest.

use crate::free_space::FreeSpace;
use crate::rows::{Row, row};
use crate::stereo::{self, StereoPoint};
use crate::sweep::Sweeps;
use crate::views::{View, load};
use crate::{PrepareError, Progress};
use crate::{foreground, free_space, spread};
use ffgs_arrays::NpzWriter;
use ffgs_dataset::Capture;
use glam::DVec3;

/// Parts of the work, for the progress.
const PARTS: usize = 5;

/// Points that several views agree on.
struct Matched<'a> {
    points: Vec<StereoPoint>,
    /// The depths that follow from them.
    space: FreeSpace<'a>,
    /// Where they come from, in words.
    account: String,
}

/// Writes `init_pt_cld.npz`. `known` are points of the calibration's own program. Returns what was done.
pub(crate) fn make(
    capture: &Capture,
    known: &[StereoPoint],
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    progress.advance("points", 0, PARTS);
    let views = load(capture)?;
    let matched = matched(&views, known, progress);
    let mut rows = rows_of(&views, &matched.points);
    let moving = foreground::complete(&views, &matched.points);
    progress.advance("points", 4, PARTS);
    let still = matched.space.keep_alike(spread::background(&views, &matched.points));
    let text = format!(
        "{}, {} in the visual hull, {} spread in depth",
        matched.account,
        moving.hull.len(),
        moving.spread.len() + still.len()
    );
    rows.extend([moving.hull, moving.spread].concat());
    rows.extend(still.iter().map(|p| row(p.position, p.colour, false)));
    NpzWriter::new().f32("data", &[rows.len(), 7], rows.as_flattened()).write(&capture.points_path())?;
    progress.advance("points", PARTS, PARTS);
    Ok(text)
}

/// Points of the calibration, or matched features, and those of plane sweeps. Those of the calibration are kept as they are. Left out are features that
/// sweeps do not confirm, where these find anything, and what views look through.
fn matched<'a>(views: &'a [View], known: &[StereoPoint], progress: &dyn Progress) -> Matched<'a> {
    let pairs: Vec<_> = views.iter().map(|v| (v.camera, v.image.clone())).collect();
    let features = if known.is_empty() { stereo::points(&pairs) } else { Vec::new() };
    progress.advance("points", 1, PARTS);
    let sweeps = Sweeps::new(&pairs, if known.is_empty() { &features } else { known });
    let swept = sweeps.points();
    progress.advance("points", 2, PARTS);
    let (of_features, of_sweeps) = (features.len(), swept.len());
    let confirmed = |p: &StereoPoint| swept.is_empty() || sweeps.confirm(p.position);
    let mut found: Vec<StereoPoint> = features.into_iter().filter(confirmed).collect();
    found.extend(swept);
    let (points, space) = free_space::consistent(views, known, found);
    progress.advance("points", 3, PARTS);
    let first = match known.len() {
        0 => format!("{of_features} matched between cameras"),
        count => format!("{count} of the calibration"),
    };
    let left_out = known.len() + of_features + of_sweeps - points.len();
    let account = format!("{first} and {of_sweeps} by plane sweeps ({left_out} in mid-air left out)");
    Matched { points, space, account }
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
