//! The static lane as the paper has it: steps of Adam on the SH coefficients, one view each.

use crate::background::{BackgroundConfig, SkyBehind, outside};
use crate::schedule::Epochs;
use crate::view::{Progress, Running};
use crate::{Adam, LossRegion, PhotometricLoss, Update};
use ffgs_core::{Gaussians, ImageSize, Mask, PlanarImage, SkyCube, TrainingView};
use ffgs_rasterizer::{
    Background, CpuRasterizer, DifferentiableRasterizer, Gradients, PixelGradients, Rasterizer,
    RenderOptions, RenderTape, View,
};

/// Finetunes the SH colours of the static layer; geometry and opacity do not change.
pub(super) fn train(
    config: &BackgroundConfig,
    views: &[TrainingView],
    sky: &SkyCube,
    layer: &mut Gaussians,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) {
    let rasterizer = CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None });
    let regions: Vec<Mask> = views.iter().map(|v| outside(v, config.mask_dilation)).collect();
    let rates = config.static_rates();
    let (mut tape, mut loss, mut gradients) =
        (RenderTape::default(), PhotometricLoss::new(), Gradients::default());
    let mut pixel_gradient = PlanarImage::zeros(ImageSize { width: 1, height: 1 });
    let mut behind = SkyBehind::new();
    let mut adam = Adam::new(layer.len(), layer.sh_degree());
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    let mut running = Running::default();
    for iteration in 0..config.static_iterations {
        let Some(index) = epochs.draw() else { return };
        let view = &views[index];
        let background = Background::Image(behind.render(sky, &view.camera));
        let frame = View { camera: &view.camera, background, tiles: None };
        rasterizer.render(layer, &frame, &mut tape);
        let region = LossRegion::Mask(&regions[index]);
        let value = loss.evaluate(tape.image(), &view.image, region, &mut pixel_gradient);
        running.add(value.total, value.mse);
        gradients.reset(layer.len(), layer.sh_degree());
        let upstream = PixelGradients { image: &pixel_gradient, transmittance: None };
        rasterizer.backward(layer, &frame, &mut tape, &upstream, &mut gradients);
        adam.step(layer, &gradients.gaussians, &rates, Update::Touched(&gradients.touched));
        report(running.progress(iteration + 1, config.static_iterations, layer.len()));
    }
}
