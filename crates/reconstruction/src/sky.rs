//! The sky of a scene: whether there is one, and what a camera sees of it.

use ffgs_core::{Camera, Gaussians, PlanarImage, SkyCube, TrainingView};
use ffgs_trainer::{SkyView, shows_sky};

/// What a camera sees of the sky of a run: sRGB, 0..=1.
pub fn sky_picture(sky: &SkyCube, camera: &Camera) -> PlanarImage {
    let mut picture = PlanarImage::zeros(camera.size());
    SkyView::new(camera, sky.face_size()).render(sky, &mut picture);
    picture
}

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
