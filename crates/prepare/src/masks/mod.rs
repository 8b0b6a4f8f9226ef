//! Foreground masks by difference from each fixed camera's background, made consistent between the views.

mod background;
mod change;
mod colours;
mod contact_sheet;
mod continuation;
mod cut;
mod difference;
mod enclosed;
mod frame;
mod learnt;
mod regions;
mod rounds;

use crate::beside::Beside;
use crate::extraction::file_name;
use crate::pictures::read_mask;
use crate::{PrepareError, Progress};
use ffgs_core::{counted, is_fixed};
use ffgs_dataset::{Capture, Split};
use rounds::Rounds;
use std::fs;
use std::path::{Path, PathBuf};

/// Fewer frames do not tell what stands still.
const LEAST_FRAMES: usize = 4;
/// Name of the contact sheet in the capture.
const SHEET: &str = "masks.png";

/// A camera of the capture, for which masks are wanted.
#[derive(Clone, Debug)]
struct View {
    split: Split,
    index: usize,
    name: String,
    fixed: bool,
}

/// Makes the masks of all views; they appear together when all are done. `beside` has more pictures of the cameras than
/// the capture. Returns what was done, or why nothing was.
pub(crate) fn make(
    capture: &Capture,
    beside: &Beside,
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    let views = views(capture)?;
    let fixed = views.iter().filter(|v| v.fixed).count();
    let plates = views.iter().filter(|v| v.fixed && beside.has_clean_plate(&v.name)).count();
    let learnable = if capture.frames() < LEAST_FRAMES { 0 } else { fixed - plates };
    if fixed < 2 {
        return Ok(format!(
            "none: {fixed} of {} cameras stand still, so there is no background to learn",
            views.len()
        ));
    }
    if plates + learnable < 2 {
        let frames = counted(capture.frames(), "frame");
        return Ok(format!(
            "none: {frames} cannot tell what moves, {LEAST_FRAMES} can; a run takes the scene for static"
        ));
    }
    let part = capture.root().join("seg.part");
    let rounds = Rounds { capture, views: &views, beside, folder: &part };
    rounds.make(plates == fixed, &|done, all| progress.advance("masks", done, all))?;
    let seg = capture.root().join("seg");
    fs::rename(&part, &seg).map_err(|e| PrepareError::io(&seg, e))?;
    contact_sheet::write(capture, &seg)?;
    let source = made_from(plates, learnable, views.len());
    let found = if are_empty(&seg, &views, capture.frames())? {
        ", and ALL EMPTY: nothing moves by enough to be told from what stands still, so that a run takes the scene for static"
    } else {
        ""
    };
    Ok(format!("{source}{found}; look at {SHEET}"))
}

/// Whether no mask of any view holds anything.
fn are_empty(seg: &Path, views: &[View], frames: usize) -> Result<bool, PrepareError> {
    for (view, frame) in views.iter().flat_map(|view| (0..frames).map(move |frame| (view, frame))) {
        if read_mask(&seg.join(file_name(&view.name, frame)))?.count() > 0 {
            return Ok(false);
        }
    }
    Ok(true)
}

/// What the masks of `all` cameras were made from: of so many from clean plates, of so many from a background that was learnt.
fn made_from(plates: usize, learnt: usize, all: usize) -> String {
    let parts = [
        (plates, "clean plates of", "fixed camera"),
        (learnt, "the background of", "fixed camera"),
        (all - plates - learnt, "the visual hull alone for", "other"),
    ];
    let parts: Vec<String> = parts
        .iter()
        .filter(|(cameras, ..)| *cameras > 0)
        .map(|(cameras, of, what)| format!("{of} {}", counted(*cameras, what)))
        .collect();
    format!("made from {}", parts.join(", "))
}

fn views(capture: &Capture) -> Result<Vec<View>, PrepareError> {
    let mut out = Vec::new();
    for split in [Split::Train, Split::Test] {
        for (index, view) in capture.views(split).iter().enumerate() {
            let fixed = is_fixed((0..capture.frames()).map(|frame| capture.camera(split, index, frame)))?;
            out.push(View { split, index, name: view.name.clone(), fixed });
        }
    }
    Ok(out)
}

/// Where the contact sheet lies.
pub(crate) fn sheet_path(root: &Path) -> PathBuf {
    root.join(SHEET)
}
