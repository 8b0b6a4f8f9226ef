//! What a baked export shall look like: renders of what was trained.

use ffgs_core::{Camera, Gaussians, ImageRgb8, Mask, Scene, TrainingView};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use ffgs_trainer::sky_picture;

/// Opacity from which a pixel belongs to the mask of what is fitted.
const SHOWS: f32 = 0.1;

/// The trained scene as `camera` sees it. The mask is where `fitted` would show if nothing stood before it; without `fitted` it is the whole image.
pub(crate) fn target(scene: &Scene, fitted: Option<&Gaussians>, camera: &Camera) -> TrainingView {
    let sky = sky_picture(&scene.sky, camera);
    let view = View { camera, background: Background::Image(&sky), tiles: None };
    let (rasterizer, mut tape) = (CpuRasterizer::default(), RenderTape::default());
    rasterizer.render_layers(&scene.layers(), &view, &mut tape);
    let image = ImageRgb8::from(tape.image());
    let shows = fitted.and_then(|fitted| {
        rasterizer.render_layers(&[fitted], &view, &mut tape);
        Mask::new(camera.size(), tape.transmittance().iter().map(|&t| u8::from(t <= 1.0 - SHOWS)).collect())
    });
    let mask = shows.unwrap_or_else(|| Mask::filled(camera.size(), true));
    TrainingView { camera: *camera, image, mask }
}
