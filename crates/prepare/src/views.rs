//! The training views of the first frame, from which points are made.

use crate::PrepareError;
use ffgs_core::{Camera, ImageRgb8, Mask};
use ffgs_dataset::{Capture, Split};
use rayon::prelude::*;

/// One training view of the first frame.
pub(crate) struct View {
    pub camera: Camera,
    pub image: ImageRgb8,
    pub mask: Option<Mask>,
}

/// Reads them.
///
/// # Errors
/// When one of them cannot be read.
pub(crate) fn load(capture: &Capture) -> Result<Vec<View>, PrepareError> {
    let view = |v: usize| -> Result<View, PrepareError> {
        Ok(View {
            camera: capture.camera(Split::Train, v, 0)?,
            image: capture.load_image(Split::Train, v, 0)?,
            mask: capture.load_mask(Split::Train, v, 0)?,
        })
    };
    (0..capture.views(Split::Train).len()).into_par_iter().map(view).collect()
}
