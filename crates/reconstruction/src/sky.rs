//! Whether a scene has a sky.

use ffgs_core::{Gaussians, SkyCube, TrainingView};
use ffgs_trainer::shows_sky;

/// The sky, or one colour where no view shows any. Indoors no sky is seen; what frame 0 made of it would show as soon as something
/// before it moves.
pub(crate) fn sky_or_none(sky: SkyCube, layer: &Gaussians, views: &[TrainingView]) -> SkyCube {
    if shows_sky(layer, views) {
        return sky;
    }
    tracing::info!(
        "the views see no sky (indoors?): the background is one constant colour, and no sky is trained"
    );
    SkyCube::none(sky.mean())
}
