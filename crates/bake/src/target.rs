//! What a baked export shall look like: renders of what was trained.

use ffgs_core::{Camera, Gaussians, ImageRgb8, Mask, PlanarImage, Scene, TrainingView};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use ffgs_trainer::SkyView;

/// Opacity of what is fitted from which a pixel counts as its.
const SHOWS: f32 = 0.1;

/// The trained scene as `camera` sees it, with a mask of where `fitted` would show if nothing stood before it; of everything without.
pub(crate) fn target(scene: &Scene, fitted: Option<&Gaussians>, camera: &Camera) -> TrainingView {
    let mut sky = PlanarImage::zeros(camera.size());
    SkyView::new(camera, scene.sky.face_size()).render(&scene.sky, &mut sky);
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
