//! Training of all Gaussians by whole photographs, before a sky that stays.

use anyhow::{Result, ensure};
use ffgs_core::{Camera, Gaussians, ImageRgb8, ImageSize, Mask, PlanarImage, SkyCube, TrainingView};
use ffgs_method::Step;
use ffgs_rasterizer::{Background, CpuRasterizer, Gradients, PixelGradients, RenderTape, View};
use ffgs_trainer::{Epochs, LossRegion, PhotometricLoss, SkyView};

/// The photographs of a frame, and how Gaussians look from their cameras.
pub(crate) struct Photographs<'a> {
    views: &'a [TrainingView],
    sky: &'a SkyCube,
    /// The view at hand.
    pub at: usize,
    /// Per view, the pixels that count, the others being black in photograph and render; none = all pixels of all views.
    pub masks: Vec<Mask>,
    behind: PlanarImage,
    comparison: Comparison,
}

impl<'a> Photographs<'a> {
    /// Those of `step`.
    pub(crate) fn new(step: &Step<'a>, sky: &'a SkyCube) -> Self {
        let (behind, comparison) = (no_image(), Comparison::new());
        Self { views: step.now, sky, at: 0, masks: Vec::new(), behind, comparison }
    }

    /// Renders a view; its loss.
    ///
    /// # Errors
    /// When the loss is not finite: the training has diverged.
    pub(crate) fn forward(&mut self, view: usize, gaussians: &Gaussians) -> Result<f64> {
        self.at = view;
        let TrainingView { camera, image, .. } = &self.views[view];
        SkyView::new(camera, self.sky.face_size()).render(self.sky, &mut self.behind);
        let background = Background::Image(&self.behind);
        match self.masks.get(view) {
            None => self.comparison.forward(gaussians, camera, background, image),
            Some(mask) => self.comparison.forward_within(mask, gaussians, camera, background, image),
        }
    }

    /// The derivatives of that loss in place of the content of `out`; zero where nothing was drawn.
    pub(crate) fn backward(&mut self, gaussians: &Gaussians, out: &mut Gradients) {
        let camera = &self.views[self.at].camera;
        self.comparison.backward(gaussians, camera, Background::Image(&self.behind), out);
    }
}

/// The order in which a frame's views are drawn: random epochs, fixed by seed and frame.
pub(crate) fn view_order(step: &Step) -> Epochs {
    Epochs::new(step.now.len(), frame_seed(step))
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
            rasterizer: CpuRasterizer::default(),
            tape: RenderTape::default(),
            loss: PhotometricLoss::new(),
            by_pixels: no_image(),
        }
    }

    /// The loss of a render against `target`.
    ///
    /// # Errors
    /// When the loss is not finite: the training has diverged.
    pub(crate) fn forward(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        background: Background,
        target: &ImageRgb8,
    ) -> Result<f64> {
        let (mut value, mut loss) = (0.0, std::mem::take(&mut self.loss));
        self.forward_by(gaussians, camera, background, |image, by| {
            value = loss.evaluate(image, target, LossRegion::Full, by).total;
        });
        self.loss = loss;
        finite(value)
    }

    /// The same with what lies outside `mask` black in render and target; means are over all pixels.
    ///
    /// # Errors
    /// As [`forward`](Self::forward).
    pub(crate) fn forward_within(
        &mut self,
        mask: &Mask,
        gaussians: &Gaussians,
        camera: &Camera,
        background: Background,
        target: &ImageRgb8,
    ) -> Result<f64> {
        let inside = target.data().chunks(3).zip(mask.data());
        let inside = inside.flat_map(|(pixel, inside)| [0, 1, 2].map(|c| pixel[c] * inside)).collect();
        let target = ImageRgb8::new(target.size(), inside).expect("a value per channel");
        let cut = |image: &mut PlanarImage| {
            let planes = image.data_mut().chunks_mut(mask.data().len());
            planes.for_each(|plane| plane.iter_mut().zip(mask.data()).for_each(|(v, m)| *v *= f32::from(*m)));
        };
        let (mut value, mut loss) = (0.0, std::mem::take(&mut self.loss));
        self.forward_by(gaussians, camera, background, |image, by| {
            let mut image = image.clone();
            cut(&mut image);
            value = loss.evaluate(&image, &target, LossRegion::Full, by).total;
            cut(by);
        });
        self.loss = loss;
        finite(value)
    }

    /// Renders; `by_pixels` writes the derivatives of any function of the render by its pixels.
    pub(crate) fn forward_by(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        background: Background,
        by_pixels: impl FnOnce(&PlanarImage, &mut PlanarImage),
    ) {
        self.rasterizer.render(gaussians, &View { camera, background, tiles: None }, &mut self.tape);
        by_pixels(self.tape.image(), &mut self.by_pixels);
    }

    /// The derivatives of that loss in place of the content of `out`; zero where nothing was drawn.
    pub(crate) fn backward(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        background: Background,
        out: &mut Gradients,
    ) {
        out.reset(gaussians.len(), gaussians.sh_degree());
        let upstream = PixelGradients { image: &self.by_pixels, transmittance: None };
        let frame = View { camera, background, tiles: None };
        self.rasterizer.backward(gaussians, &frame, &mut self.tape, &upstream, out);
        out.fill_untouched();
    }
}

fn finite(value: f64) -> Result<f64> {
    ensure!(
        value.is_finite(),
        "the training diverged: its loss is {value}; lower the rates of the method's table in --config"
    );
    Ok(value)
}

fn no_image() -> PlanarImage {
    PlanarImage::zeros(ImageSize { width: 1, height: 1 })
}

/// A seed for what is random in a frame.
pub(crate) fn frame_seed(step: &Step) -> u64 {
    step.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ step.frame as u64
}
