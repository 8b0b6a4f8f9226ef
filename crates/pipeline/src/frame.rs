//! One frame of a capture in memory: cameras, photographs and masks of the training views.

use anyhow::Result;
use ffgs_core::{Camera, Mask, TrainingView};
use ffgs_dataset::{Capture, Split};
use rayon::prelude::*;

/// Which training views a run uses, by index and name.
#[derive(Clone, Debug)]
pub struct TrainViews {
    /// Index in the capture's training split, and the camera's name.
    pub selected: Vec<(usize, String)>,
}

impl TrainViews {
    /// All training views, or those named; a name that does not exist is an error.
    pub fn select(capture: &Capture, names: Option<&[String]>) -> Result<Self> {
        let all = capture.views(Split::Train);
        let Some(names) = names else {
            return Ok(Self { selected: all.iter().enumerate().map(|(i, v)| (i, v.name.clone())).collect() });
        };
        let find = |name: &String| {
            let index = all.iter().position(|v| v.name == *name);
            let known = || all.iter().map(|v| v.name.as_str()).collect::<Vec<_>>().join(", ");
            index.map(|i| (i, name.clone())).ok_or_else(|| {
                anyhow::anyhow!("--train-views: the capture has no camera {name}; it has {}", known())
            })
        };
        Ok(Self { selected: names.iter().map(find).collect::<Result<_>>()? })
    }
}

/// Loads one view.
pub fn load_view(capture: &Capture, split: Split, view: usize, frame: usize) -> Result<TrainingView> {
    let camera = capture.camera(split, view, frame)?;
    let image = capture.load_image(split, view, frame)?;
    let mask = capture.load_mask(split, view, frame)?.unwrap_or_else(|| Mask::filled(camera.size(), false));
    Ok(TrainingView { camera, image, mask })
}

/// Loads the training views of a frame, in parallel.
pub fn load_training(capture: &Capture, views: &TrainViews, frame: usize) -> Result<Vec<TrainingView>> {
    views.selected.par_iter().map(|(v, _)| load_view(capture, Split::Train, *v, frame)).collect()
}

/// Cameras of the views, and their masks.
pub fn cameras_and_masks(views: &[TrainingView]) -> (Vec<Camera>, Vec<Mask>) {
    views.iter().map(|v| (v.camera, v.mask.clone())).unzip()
}
