//! One frame of a capture in memory: cameras, photographs and masks of the training views.

use crate::job::provenance::{Checksum, load_with_checksum};
use anyhow::Result;
use ffgs_core::{Camera, TrainingView};
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_reconstruction::FirstViews;
use rayon::prelude::*;

/// Training views by index into the capture's training split: all of them, or those named.
///
/// # Errors
/// When a name does not exist.
pub fn select_views(capture: &dyn Capture, names: Option<&[String]>) -> Result<Vec<usize>> {
    let all = capture.views(Split::Train);
    let Some(names) = names else { return Ok((0..all.len()).collect()) };
    let find = |name: &String| {
        all.iter().position(|view| view == name).ok_or_else(|| {
            anyhow::anyhow!("--train-views: the capture has no camera {name}; it has {}", all.join(", "))
        })
    };
    if let Some((_, twice)) = names.iter().enumerate().find(|(i, name)| names[..*i].contains(name)) {
        anyhow::bail!("--train-views: {twice} is named twice");
    }
    names.iter().map(find).collect()
}

/// Loads one view.
///
/// # Errors
/// When its camera, image or mask cannot be read.
pub(crate) fn load_view(capture: &dyn Capture, at: ViewAt) -> Result<TrainingView> {
    load_with_checksum(capture, at).map(|(view, _)| view)
}

/// Loads views, in parallel, and the checksums of what they were read from.
///
/// # Errors
/// When one of them cannot be read.
pub(crate) fn load_views(
    capture: &dyn Capture,
    views: &[ViewAt],
) -> Result<(Vec<TrainingView>, Vec<Checksum>)> {
    let loaded: Vec<_> =
        views.par_iter().map(|&at| load_with_checksum(capture, at)).collect::<Result<_>>()?;
    Ok(loaded.into_iter().unzip())
}

/// Training views of a frame, by index into the training split.
pub(crate) fn training_views(views: &[usize], frame: usize) -> Vec<ViewAt> {
    views.iter().map(|&view| ViewAt { split: Split::Train, view, frame }).collect()
}

/// All test views of a frame.
pub(crate) fn test_views(capture: &dyn Capture, frame: usize) -> Vec<ViewAt> {
    all_of(capture, Split::Test, frame)
}

/// The views that only frame 0 has.
pub(crate) fn init_views(capture: &dyn Capture, frame: usize) -> Vec<ViewAt> {
    if frame == 0 { all_of(capture, Split::Init, frame) } else { Vec::new() }
}

fn all_of(capture: &dyn Capture, split: Split, frame: usize) -> Vec<ViewAt> {
    (0..capture.views(split).len()).map(|view| ViewAt { split, view, frame }).collect()
}

/// Cameras of the training views `views` (by index) of a frame, and of the views that only frame 0 has.
///
/// # Errors
/// When one of them cannot be read.
pub(crate) fn trained_cameras(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<Vec<Camera>> {
    let views = [training_views(views, frame), init_views(capture, 0)].concat();
    views.into_iter().map(|at| Ok(capture.camera(at)?)).collect()
}

/// Photographs of a first frame: those of the training views `views` (by index), and those that only frame 0 has.
///
/// # Errors
/// When one of them cannot be read.
pub fn first_views(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<FirstViews> {
    first_views_and_checksums(capture, views, frame).map(|(views, _)| views)
}

/// As [`first_views`], and the checksums of what they were read from.
pub(crate) fn first_views_and_checksums(
    capture: &dyn Capture,
    views: &[usize],
    frame: usize,
) -> Result<(FirstViews, Vec<Checksum>)> {
    let shots = [training_views(views, frame), init_views(capture, frame)].concat();
    let (views, sums) = load_views(capture, &shots)?;
    Ok((FirstViews { shots, views }, sums))
}
