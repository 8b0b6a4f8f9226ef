//! One frame of a capture in memory: cameras, photographs and masks of the training views.

use anyhow::Result;
use ffgs_core::{Camera, Mask, TrainingView};
use ffgs_method::{Capture, Split, ViewAt};
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
    let (camera, image) = (capture.camera(at)?, capture.image(at)?);
    let mask = capture.mask(at)?.unwrap_or_else(|| Mask::filled(camera.size(), false));
    Ok(TrainingView { camera, image, mask })
}

/// Loads training views of a frame, in parallel.
///
/// # Errors
/// When one of them cannot be read.
pub fn load_training(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<Vec<TrainingView>> {
    views.par_iter().map(|&view| load_view(capture, ViewAt { split: Split::Train, view, frame })).collect()
}

/// Cameras of the views, and their masks.
pub(crate) fn cameras_and_masks(views: &[TrainingView]) -> (Vec<Camera>, Vec<Mask>) {
    views.iter().map(|v| (v.camera, v.mask.clone())).unzip()
}
