//! Training of all Gaussians by whole photographs, before a sky that stays.

use anyhow::{Result, ensure};
use ffgs_core::{Camera, Gaussians, ImageRgb8, ImageSize, PlanarImage, SkyCube, TrainingView};
use ffgs_method::Step;
use ffgs_rasterizer::{
    Background, CpuRasterizer, Gradients, PixelGradients, RenderOptions, RenderTape, View,
};
use ffgs_trainer::{Epochs, LossRegion, PhotometricLoss, SkyView};

/// The photographs of a frame, drawn one after another in random epochs.
pub(crate) struct Photographs<'a> {
    views: &'a [TrainingView],
    sky: &'a SkyCube,
    order: Epochs,
    /// The view that was drawn last.
    pub at: usize,
    behind: PlanarImage,
    comparison: Comparison,
}

impl<'a> Photographs<'a> {
    /// Those of `step`; their order is fixed by seed and frame.
    pub(crate) fn new(step: &Step<'a>, sky: &'a SkyCube) -> Self {
        Self {
            views: step.now,
            sky,
            order: Epochs::new((0..step.now.len()).collect(), frame_seed(step)),
            at: 0,
            behind: no_image(),
            comparison: Comparison::new(),
        }
    }

    /// The loss of the next view, and its derivatives in place of the content of `out`; zero where nothing was drawn.
    ///
    /// # Errors
    /// When the loss is not finite: the training has diverged.
    pub(crate) fn differentiate(&mut self, gaussians: &Gaussians, out: &mut Gradients) -> Result<f64> {
        let Some(view) = self.order.draw() else {
            out.reset(gaussians.len(), gaussians.sh_degree());
            out.fill_untouched();
            return Ok(0.0);
        };
        self.at = view;
        let TrainingView { camera, image, .. } = &self.views[view];
        SkyView::new(camera, self.sky.face_size()).render(self.sky, &mut self.behind);
        self.comparison.differentiate(gaussians, camera, Background::Image(&self.behind), image, out)
    }
}

/// A render against an image: `0.8 L1 + 0.2 (1 - SSIM)` over all pixels.
pub(crate) struct Comparison {
    rasterizer: CpuRasterizer,
    tape: RenderTape,
    loss: PhotometricLoss,
    by_pixels: PlanarImage,
}

impl Comparison {
    pub(crate) fn new() -> Self {
        Self {
            rasterizer: CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None }),
            tape: RenderTape::default(),
            loss: PhotometricLoss::new(),
            by_pixels: no_image(),
        }
    }

    /// The loss, and its derivatives in place of the content of `out`; zero where nothing was drawn.
    ///
    /// # Errors
    /// When the loss is not finite: the training has diverged.
    pub(crate) fn differentiate(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        background: Background,
        target: &ImageRgb8,
        out: &mut Gradients,
    ) -> Result<f64> {
        out.reset(gaussians.len(), gaussians.sh_degree());
        let frame = View { camera, background, tiles: None };
        self.rasterizer.render(gaussians, &frame, &mut self.tape);
        let (image, pixels) = (self.tape.image(), &mut self.by_pixels);
        let value = self.loss.evaluate(image, target, LossRegion::Full, pixels).total;
        ensure!(
            value.is_finite(),
            "the training diverged: its loss is {value}; lower the rates of the method's table in --config"
        );
        let upstream = PixelGradients { image: &self.by_pixels, transmittance: None };
        self.rasterizer.backward(gaussians, &frame, &mut self.tape, &upstream, out);
        out.fill_untouched();
        Ok(value)
    }
}

fn no_image() -> PlanarImage {
    PlanarImage::zeros(ImageSize { width: 1, height: 1 })
}

/// A seed for what is random in a frame.
pub(crate) fn frame_seed(step: &Step) -> u64 {
    step.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ step.frame as u64
}
