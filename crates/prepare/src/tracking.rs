//! All trackers, one after another.

use crate::networks::{Networks, made_folders};
use crate::removal::remove;
use crate::tracks::{make, names};
use crate::{PrepareError, Progress, tracker_list};
use ffgs_dataset::Capture;
use std::path::Path;

/// Tracks every training view of a capture of this project's format, in its own folder, by the trackers of this project
/// and by networks (descriptions, or `NAME=MODEL.onnx`); with `again`, also what was tracked before. Returns what was
/// done. Tracks of other programs stay.
///
/// # Errors
/// When the capture cannot be read or written, or a network cannot be used.
pub fn track(
    capture: &Path,
    networks: &[String],
    again: bool,
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    let capture = Capture::open(capture)?;
    let mut networks = Networks::load(networks)?;
    if again {
        discard(capture.root())?;
    }
    networks.announce(capture.root())?;
    make_all(&capture, &mut networks, progress)
}

/// Removes the tracks of this project's trackers and of networks; those of other programs stay.
pub(crate) fn discard(capture: &Path) -> Result<(), PrepareError> {
    let own: Vec<String> = names().into_iter().map(str::to_owned).chain(made_folders(capture)).collect();
    tracker_list::take_out(capture, &own)?;
    own.iter().map(|name| capture.join("tracks").join(name)).try_for_each(|folder| remove(&folder))
}

/// Tracks by all trackers; what is there is kept.
pub(crate) fn make_all(
    capture: &Capture,
    networks: &mut Networks,
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    Ok(make(capture, progress)? + &networks.make(capture, progress)?)
}
