//! The sky lane: texels of the cube map, seen through the transmittance of the static layer.

use crate::backend::{SkyTask, SkyTraining, TaskView, TrainBackend};
use crate::background::{BackgroundConfig, outside};
use crate::schedule::Epochs;
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use std::sync::Arc;

/// Pixels that let more than this through show the sky.
const OPEN: f32 = 0.5;
/// Share of such pixels below which a capture is taken to be indoors: what is left are leaks between Gaussians.
const MIN_OPEN_SHARE: f64 = 0.01;

/// Whether the views see past the trained `layer`, that is, whether there is a sky to model. Indoors there is none.
pub fn shows_sky(layer: &Gaussians, views: &[TrainingView]) -> bool {
    let mut tape = RenderTape::default();
    let mut open = |view: &TrainingView| {
        render_alone(layer, view, &mut tape);
        tape.transmittance().iter().filter(|t| **t > OPEN).count()
    };
    let seen: usize = views.iter().map(&mut open).sum();
    let all: usize = views.iter().map(|v| v.camera.size().pixels()).sum();
    seen as f64 >= MIN_OPEN_SHARE * all as f64
}

/// Renders a layer before black.
pub(crate) fn render_alone(layer: &Gaussians, view: &TrainingView, tape: &mut RenderTape) {
    let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: None };
    CpuRasterizer::default().render(layer, &frame, tape);
}

/// Finetunes the sky through the transmittance that `layer` leaves.
///
/// # Errors
/// When the device fails or has too little memory; `sky` is then as it was.
pub fn train_sky<B: TrainBackend>(
    backend: &B,
    config: &BackgroundConfig,
    views: &[TrainingView],
    layer: &Arc<Gaussians>,
    sky: &mut SkyCube,
    seed: u64,
) -> Result<(), B::Error> {
    if views.is_empty() || config.sky_iterations == 0 || sky.is_none() {
        return Ok(());
    }
    let tasks =
        views.iter().map(|view| TaskView::of_region(view, outside(view, config.mask_dilation))).collect();
    let mut training = backend.upload_sky(SkyTask { sky, rate: config.sky_rate, layer, views: tasks })?;
    let mut epochs = Epochs::new(views.len(), seed);
    for _ in 0..config.sky_iterations {
        let Some(view) = epochs.draw() else { break };
        training.step(view)?;
    }
    training.download()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CpuBackend, SkyView};
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage};

    const SIZE: ImageSize = ImageSize { width: 32, height: 24 };

    /// A camera at the origin that photographs one colour.
    fn view(colour: u8) -> TrainingView {
        let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 16.0, cy: 12.0 };
        let camera = Camera::new(intrinsics, glam::DMat4::IDENTITY, SIZE).unwrap();
        let image = ImageRgb8::new(SIZE, vec![colour; 3 * SIZE.pixels()]).unwrap();
        TrainingView { camera, image, mask: Mask::filled(SIZE, false) }
    }

    /// A dense wall of opaque discs before the left half of the view, or before all of it.
    fn wall(right: f32) -> Gaussians {
        let points: Vec<[f32; 3]> =
            (0..40 * 40).map(|i| [(i % 40) as f32 * 0.1 - 2.0, (i / 40) as f32 * 0.1 - 2.0, 2.0]).collect();
        let kept: Vec<[f32; 3]> = points.into_iter().filter(|p| p[0] < right).collect();
        crate::from_points(&kept, &vec![[0.2; 3]; kept.len()], 0, 0.98)
    }

    #[test]
    fn a_texel_in_the_open_learns_and_one_behind_a_wall_stays() {
        let (view, start) = (view(200), SkyCube::filled(16, [0.5; 3]));
        let mut sky = start.clone();
        let config = BackgroundConfig { sky_iterations: 300, sky_rate: 5e-3, ..BackgroundConfig::default() };
        train_sky(&CpuBackend, &config, std::slice::from_ref(&view), &Arc::new(wall(-0.3)), &mut sky, 1)
            .unwrap();
        let mut picture = PlanarImage::zeros(SIZE);
        SkyView::new(&view.camera, 16).render(&sky, &mut picture);
        let at = |column: usize| picture.pixel(12 * SIZE.width + column)[0];
        assert!((at(28) - 200.0 / 255.0).abs() < 0.02, "open: {}", at(28));
        assert!((at(2) - 0.5).abs() < 0.02, "hidden: {}", at(2));
        assert!((0..start.texels.len()).any(|t| sky.texels[t] == start.texels[t]), "unseen texels stay");
    }

    #[test]
    fn a_closed_room_shows_no_sky() {
        let views = [view(50)];
        assert!(!shows_sky(&wall(3.0), &views));
        assert!(shows_sky(&wall(-0.3), &views));
        let mut none = SkyCube::none([0.3; 3]);
        train_sky(&CpuBackend, &BackgroundConfig::default(), &views, &Arc::new(wall(-0.3)), &mut none, 1)
            .unwrap();
        assert_eq!(none, SkyCube::none([0.3; 3]));
    }
}
