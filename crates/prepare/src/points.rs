//! Initial points: matched features and surfaces, the ground, the visual hull for what moves, and samples spread in depth for the rest.

use crate::depth_maps::DepthMaps;
use crate::free_space::FreeSpace;
use crate::ground::{Ground, Prominence};
use crate::rows::{COLOUR, Row, row};
use crate::silhouettes::Silhouettes;
use crate::stereo::{self, StereoPoint};
use crate::views::{View, load};
use crate::windows::Pictures;
use crate::{PrepareError, Progress};
use crate::{agreement, foreground, free_space, spread};
use ffgs_arrays::NpzWriter;
use ffgs_dataset::{Capture, Split};
use glam::DVec3;
use std::cell::Cell;

/// Parts of the work, for the progress, beside the depth maps of every view: of all it shows, and of what moves.
const PARTS: usize = 5;
const MAPS: usize = 2;

/// Said where no camera's picture shows anything again that another's shows.
const DISAGREE: &str = "no two cameras agree on a single point: is the calibration that of these pictures, and world-to-camera with x right, \
     y down, z forward?";

/// Tells how far the work is.
struct Parts<'a> {
    progress: &'a dyn Progress,
    done: Cell<usize>,
    total: usize,
}

impl Parts<'_> {
    fn finish(&self, parts: usize) {
        self.done.set(self.done.get() + parts);
        self.progress.advance("points", self.done.get(), self.total);
    }
}

/// Points that several views agree on.
struct Matched<'a> {
    points: Vec<StereoPoint>,
    /// The depths that follow from them.
    space: FreeSpace<'a>,
    /// The plane beneath which nothing is seen.
    ground: Option<Ground>,
    /// Where they come from, in words.
    account: String,
    /// What is to be told of single cameras.
    doubt: Option<String>,
}

/// Writes `init_pt_cld.npz`. `known` are points of the calibration's own program. Returns what was done.
pub(crate) fn make(
    capture: &Capture,
    known: &[StereoPoint],
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    let (views, gain) = load(capture)?;
    let in_views = |p: &StereoPoint| StereoPoint { colour: p.colour.map(|c| (c * gain).min(1.0)), ..*p };
    let known = &known.iter().map(in_views).collect::<Vec<_>>();
    let parts = Parts { progress, done: Cell::new(0), total: PARTS + MAPS * views.len() };
    parts.finish(0);
    let names: Vec<String> = capture.views(Split::Train).iter().map(|view| view.name.clone()).collect();
    let matched = matched(&views, &names, known, &parts)?;
    let mut rows = rows_of(&views, &matched.points);
    let moving = foreground::complete(&views, &matched.points, &matched.space);
    parts.finish(1);
    let still = spread::background(&views, &matched.points, &matched.space, matched.ground.as_ref());
    let mut text = format!(
        "{}, {} in the visual hull, {} spread in depth ({} of them behind what other views look through)",
        matched.account,
        moving.hull.len(),
        moving.spread.len() + still.points.len(),
        still.moved
    );
    if matched.points.is_empty() && moving.hull.is_empty() {
        tracing::warn!("{DISAGREE}");
        text = format!("{text}; {DISAGREE}");
    }
    if let Some(doubt) = &matched.doubt {
        tracing::warn!("{doubt}");
        text = format!("{text}; {doubt}");
    }
    rows.extend([moving.hull, moving.spread].concat());
    rows.extend(still.points.iter().map(|p| row(p.position, p.colour, false)));
    rows.iter_mut().flat_map(|row| &mut row[COLOUR]).for_each(|channel| *channel /= gain);
    if gain > 1.0 {
        text = format!("{text}; the pictures are dark, so these were made of {gain:.1} times as bright ones");
    }
    NpzWriter::new().f32("data", &[rows.len(), 7], rows.as_flattened()).write(&capture.points_path())?;
    parts.finish(1);
    Ok(text)
}

/// Points of the calibration, or matched features, those of depth maps and those of the ground. Those of the calibration are kept as they are. Left out are
/// features that depth maps do not confirm, where these find anything, mirror images beneath the ground, and what views look through.
fn matched<'a>(
    views: &'a [View],
    names: &[String],
    known: &[StereoPoint],
    parts: &Parts,
) -> Result<Matched<'a>, PrepareError> {
    let (features, doubt) = if known.is_empty() { features(views, names)? } else { Default::default() };
    parts.finish(1);
    let pictures = Pictures::new(views);
    let near = if known.is_empty() { &features } else { known };
    let tick = || parts.finish(1);
    let maps = DepthMaps::new(&pictures, near, &tick);
    let mut mapped = maps.points();
    if let Some(silhouettes) = Silhouettes::new(views) {
        mapped.retain(|p| !on_foreground(views, p.position));
        mapped.extend(DepthMaps::moving(&pictures, &silhouettes, near, &tick).points());
    } else {
        parts.finish(views.len());
    }
    let (ground, prominence) = Ground::find(&pictures);
    let on_ground = ground.as_ref().map_or(&[][..], Ground::points);
    parts.finish(1);
    let (of_features, of_maps) = (features.len(), mapped.len());
    let of_ground = (ground.as_ref().map(|_| on_ground.len()), prominence);
    let confirmed = |p: &StereoPoint| mapped.is_empty() || maps.confirm(p.position);
    let mut found: Vec<StereoPoint> = features.into_iter().filter(confirmed).collect();
    found.extend(&mapped);
    found.retain(|p| ground.as_ref().is_none_or(|ground| !ground.hides(views, p.position)));
    found.extend(on_ground);
    let (points, space) = free_space::consistent(views, known, found, ground.as_ref());
    parts.finish(1);
    let account = account(known.len(), of_features, of_maps, of_ground, points.len());
    Ok(Matched { points, space, ground, account, doubt })
}

/// Points from descriptors that pairs of neighbouring cameras agree on, and what makes single cameras doubtful.
fn features(views: &[View], names: &[String]) -> Result<(Vec<StereoPoint>, Option<String>), PrepareError> {
    let frames = stereo::described(views);
    let doubt = agreement::check(views, names, &frames)?;
    Ok((stereo::points(views, &frames), doubt))
}

/// In words: how many points there are of the calibration, of features, of depth maps and of the ground, where one was found, and how many of these are `left`.
fn account(
    known: usize,
    features: usize,
    mapped: usize,
    (ground, prominence): (Option<usize>, Prominence),
    left: usize,
) -> String {
    let first = if known > 0 {
        format!("{known} of the calibration")
    } else {
        format!("{features} matched between cameras")
    };
    let (of_ground, where_wrong) = match ground {
        Some(count) => {
            (format!("{count} on the ground, where {prominence}"), "in mid-air or beneath the ground")
        }
        None => (format!("none on the ground, as no plane stands out: {prominence}"), "in mid-air"),
    };
    let left_out = known + features + mapped + ground.unwrap_or(0) - left;
    format!("{first}, {mapped} of depth maps and {of_ground} ({left_out} {where_wrong} left out)")
}

/// Writes points that need no others.
pub(crate) fn keep(capture: &Capture, points: &[StereoPoint]) -> Result<String, PrepareError> {
    let (views, _) = load(capture)?;
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
