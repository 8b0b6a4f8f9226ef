use ffgs_core::{Gaussians, Mask, PlanarImage, SkyCube, TrainingView};
use ffgs_rasterizer::{
    Background, CpuRasterizer, Gradients, PixelGradients, RenderOptions, RenderTape, TileMask, View,
};
use ffgs_trainer::{
    Adam, Epochs, LearningRates, LossRegion, PhotometricLoss, SkyView, TILE_DILATION, Update, decay,
};
use std::ops::Range;

/// How exports are finetuned. Positions and rotations stay: they hold the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinetuneConfig {
    /// Steps, one view each.
    pub iterations: usize,
    /// Rate of log scales at the first step; all rates fall to a tenth.
    pub scale_rate: f32,
    /// Rate of opacity logits at the first step.
    pub opacity_rate: f32,
    /// Rate of SH coefficient 0 at the first step.
    pub sh0_rate: f32,
    /// Rate of the other SH coefficients at the first step.
    pub sh_rest_rate: f32,
}

impl Default for FinetuneConfig {
    /// The rates of frame 0's training.
    fn default() -> Self {
        Self {
            iterations: 600,
            scale_rate: 1.5e-2,
            opacity_rate: 3e-2,
            sh0_rate: 2.5e-3,
            sh_rest_rate: 1.25e-4,
        }
    }
}

impl FinetuneConfig {
    fn rates(&self, iteration: usize) -> LearningRates {
        let fall = decay(1.0, 0.1, iteration, self.iterations);
        LearningRates {
            means: 0.0,
            quats: 0.0,
            scales: fall * self.scale_rate,
            opacities: fall * self.opacity_rate,
            sh0: fall * self.sh0_rate,
            sh_rest: fall * self.sh_rest_rate,
        }
    }
}

/// Pixels by which masks are grown for the loss, so that outlines are learnt from both sides.
const LOSS_DILATION: usize = 2;

/// Fits the Gaussians in `range` to the photographs, without compensation, in front of `sky`. Where the range is not all
/// of them only the neighbourhood of the foreground counts. Equal inputs and seeds give equal bytes.
pub fn finetune(
    gaussians: &mut Gaussians,
    range: Range<usize>,
    views: &[TrainingView],
    sky: &SkyCube,
    config: &FinetuneConfig,
    seed: u64,
) {
    let whole = range.len() == gaussians.len();
    let targets: Vec<Target> = views.iter().filter_map(|view| Target::new(view, whole)).collect();
    let mut epochs = Epochs::new((0..targets.len()).collect(), seed);
    let mut steps = Steps::new(gaussians, range, sky);
    for iteration in 0..config.iterations {
        if let Some(target) = epochs.draw() {
            steps.step(gaussians, &targets[target], &config.rates(iteration));
        }
    }
}

/// A photograph and which of it counts: everything, or what is near the foreground.
struct Target<'a> {
    view: &'a TrainingView,
    region: Option<(Mask, TileMask)>,
}

impl<'a> Target<'a> {
    fn new(view: &'a TrainingView, whole: bool) -> Option<Self> {
        let near =
            || (view.mask.dilated(LOSS_DILATION), TileMask::covering(&view.mask.dilated(TILE_DILATION)));
        match (whole, view.mask.count()) {
            (true, _) => Some(Self { view, region: None }),
            (false, 0) => None,
            (false, _) => Some(Self { view, region: Some(near()) }),
        }
    }
}

struct Steps<'a> {
    range: Range<usize>,
    sky: &'a SkyCube,
    rasterizer: CpuRasterizer,
    adam: Adam,
    tape: RenderTape,
    loss: PhotometricLoss,
    gradients: Gradients,
    behind: PlanarImage,
    pixel_gradient: PlanarImage,
}

impl<'a> Steps<'a> {
    fn new(gaussians: &Gaussians, range: Range<usize>, sky: &'a SkyCube) -> Self {
        let nothing = PlanarImage::zeros(ffgs_core::ImageSize { width: 1, height: 1 });
        Self {
            range,
            sky,
            rasterizer: CpuRasterizer::new(RenderOptions { antialiased: false, sh_degree: None }),
            adam: Adam::new(gaussians.len(), gaussians.sh_degree()),
            tape: RenderTape::default(),
            loss: PhotometricLoss::new(),
            gradients: Gradients::default(),
            behind: nothing.clone(),
            pixel_gradient: nothing,
        }
    }

    fn step(&mut self, gaussians: &mut Gaussians, target: &Target, rates: &LearningRates) {
        let camera = &target.view.camera;
        SkyView::new(camera, self.sky.face_size()).render(self.sky, &mut self.behind);
        let tiles = target.region.as_ref().map(|(_, tiles)| tiles);
        let view = View { camera, background: Background::Image(&self.behind), tiles };
        self.rasterizer.render(gaussians, &view, &mut self.tape);
        let region = target.region.as_ref().map_or(LossRegion::Full, |(mask, _)| LossRegion::Mask(mask));
        self.loss.evaluate(self.tape.image(), &target.view.image, region, &mut self.pixel_gradient);
        self.gradients.reset(gaussians.len(), gaussians.sh_degree());
        let upstream = PixelGradients { image: &self.pixel_gradient, transmittance: None };
        self.rasterizer.backward(gaussians, &view, &mut self.tape, &upstream, &mut self.gradients);
        let touched = &mut self.gradients.touched;
        touched[..self.range.start].fill(false);
        touched[self.range.end..].fill(false);
        self.adam.step(gaussians, &self.gradients.gaussians, rates, Update::Touched(touched));
    }
}
