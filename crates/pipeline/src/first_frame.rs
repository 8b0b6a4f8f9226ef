//! What surrounds the training of frame 0: the views that it sees, and its sky.

use crate::frame::{init_views, load_views, training_views};
use anyhow::Result;
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use ffgs_method::Capture;
use ffgs_trainer::shows_sky;

/// The training views `views` (by index) of a frame, and after them those that only frame 0 has.
///
/// # Errors
/// When one of them cannot be read.
pub fn all_views(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<Vec<TrainingView>> {
    load_views(capture, &[training_views(views, frame), init_views(capture, frame)].concat())
        .map(|(views, _)| views)
}

/// The sky, or one colour where no view shows any. Indoors no sky is seen; what frame 0 made of it would show as soon as something
/// before it moves.
pub fn sky_or_none(sky: SkyCube, layer: &Gaussians, views: &[TrainingView]) -> SkyCube {
    if shows_sky(layer, views) {
        return sky;
    }
    tracing::info!(
        "the views see no sky (indoors?): the background is one constant colour, and no sky is trained"
    );
    SkyCube::none(sky.mean())
}
