//! A layer under training on the CPU: render, loss, backward pass and Adam, in place.

use super::around::{Surrounding, TrainedSky};
use super::cut::Cut;
use crate::backend::{Around, LayerTask, LayerTraining, Revision, TaskView, Training, mean_pixels};
use crate::background::SkyBehind;
use crate::density_control::GradientSums;
use crate::natural::expected_gain;
use crate::prior::Penalty;
use crate::view::{Progress, Running};
use crate::{Adam, LearningRates, LossRegion, PhotometricLoss, Update};
use ffgs_core::{Gaussians, ImageSize, PlanarImage, SkyCube};
use ffgs_rasterizer::{Background, CpuRasterizer, Gradients, RenderOptions, RenderTape, View};
use std::convert::Infallible;
use std::sync::Arc;

/// Gaussians under training on the CPU, changed in place.
pub struct CpuLayer<'a> {
    layer: &'a mut Gaussians,
    views: Vec<TaskView<'a>>,
    /// Mean over them of the pixels that count.
    mean_pixels: usize,
    around: Surrounding<'a>,
    penalty: Option<Penalty<'a>>,
    adam: Adam,
    /// Gaussians at the front that stay.
    fixed: usize,
    /// Whether Gaussians that a step does not draw go on by their momentum.
    coasts: bool,
    sums: Option<GradientSums>,
    running: Running,
    /// The view at hand, and how it was drawn.
    at: usize,
    rasterizer: CpuRasterizer,
    tape: RenderTape,
    loss: PhotometricLoss,
    pixel_gradient: PlanarImage,
    gradients: Gradients,
}

impl<'a> CpuLayer<'a> {
    pub(super) fn new(task: LayerTask<'a>) -> Self {
        let layer = Arc::make_mut(task.layer);
        let mut seen = vec![0; layer.len()];
        let rasterizer = CpuRasterizer::default();
        let around = match task.around {
            Around::Sky(sky) => Surrounding::Sky(sky, SkyBehind::new()),
            Around::TrainedSky(sky, rate) => Surrounding::Trained(Box::new(TrainedSky::new(sky, rate))),
            Around::Cut(layers) => {
                Surrounding::Cut(Box::new(Cut::new(layers, layer, &task.views, rasterizer, &mut seen)))
            }
        };
        Self {
            around,
            penalty: task.prior.map(|prior| Penalty::new(prior, layer, seen)),
            adam: Adam::of_columns(layer.len(), layer.sh_degree(), task.columns),
            fixed: task.fixed,
            coasts: task.coasts,
            sums: task.sums_gradients.then(|| GradientSums::new(layer.len())),
            layer,
            mean_pixels: mean_pixels(&task.views),
            views: task.views,
            running: Running::default(),
            at: 0,
            rasterizer,
            tape: RenderTape::default(),
            loss: PhotometricLoss::new(),
            pixel_gradient: PlanarImage::zeros(ImageSize { width: 1, height: 1 }),
            gradients: Gradients::default(),
        }
    }

    /// One step of everything that is trained, by Adam or, with a prior, by a share of the natural step.
    fn descend(&mut self, natural: Option<f32>, rates: &LearningRates) {
        let touched = &mut self.gradients.touched;
        touched[..self.fixed].fill(false);
        let gradient = &self.gradients.gaussians;
        if let (Some(share), Some(penalty)) = (natural, &self.penalty) {
            let curvature = penalty.curvature(self.mean_pixels);
            self.adam.step_naturally(self.layer, gradient, (share, rates), curvature, touched);
        } else {
            let update = if self.coasts { Update::Coasting(touched) } else { Update::Touched(touched) };
            self.adam.step(self.layer, gradient, rates, update);
        }
        self.around.step(&self.pixel_gradient, self.tape.transmittance());
        if let Some(sums) = &mut self.sums {
            sums.add(&self.gradients.mean2d_norm, touched);
        }
    }
}

impl Training for CpuLayer<'_> {
    type Error = Infallible;

    fn forward(&mut self, index: usize, options: RenderOptions) -> Result<(), Infallible> {
        self.at = index;
        self.rasterizer = CpuRasterizer::new(options);
        let TaskView { view, region, tiles } = &self.views[index];
        self.around.aim(index, &self.views[index]);
        let background = Background::Image(self.around.behind());
        let frame = View { camera: &view.camera, background, tiles: tiles.as_ref() };
        self.rasterizer.render(self.layer, &frame, &mut self.tape);
        let image = self.around.compose(index, self.tape.image());
        let region = region.as_ref().map_or(LossRegion::Full, LossRegion::Mask);
        let value = self.loss.evaluate(image, &view.image, region, &mut self.pixel_gradient);
        self.running.add(value.total, value.mse);
        Ok(())
    }

    fn backward(&mut self) -> Result<(), Infallible> {
        let TaskView { view, tiles, .. } = &self.views[self.at];
        self.gradients.reset(self.layer.len(), self.layer.sh_degree());
        let upstream = self.around.upstream(self.at, &mut self.pixel_gradient);
        let background = Background::Image(self.around.behind());
        let frame = View { camera: &view.camera, background, tiles: tiles.as_ref() };
        self.rasterizer.backward(self.layer, &frame, &mut self.tape, &upstream, &mut self.gradients);
        if let Some(penalty) = &self.penalty {
            penalty.add(self.layer, self.views[self.at].pixels(), &mut self.gradients);
        }
        Ok(())
    }

    fn step(&mut self, rates: &LearningRates) -> Result<(), Infallible> {
        self.descend(None, rates);
        Ok(())
    }

    fn step_naturally(&mut self, share: f32, rates: &LearningRates) -> Result<(), Infallible> {
        self.descend(Some(share), rates);
        Ok(())
    }

    fn expected_gain(&mut self) -> Result<Option<f64>, Infallible> {
        let curvature = self.penalty.as_ref().map(|penalty| penalty.curvature(self.mean_pixels));
        let (first, steps) = (&self.adam.first_moments().means, self.adam.steps());
        Ok(curvature.and_then(|curvature| expected_gain(first, steps, curvature)))
    }

    fn progress(&mut self, done: usize, all: usize) -> Result<Option<Progress>, Infallible> {
        Ok(Some(self.running.progress(done, all, self.layer.len())))
    }
}

impl LayerTraining for CpuLayer<'_> {
    fn revise(
        &mut self,
        decide: &mut dyn FnMut(&mut Gaussians, &GradientSums) -> Revision,
    ) -> Result<(), Infallible> {
        let none = GradientSums::new(0);
        let revision = decide(self.layer, self.sums.as_ref().unwrap_or(&none));
        if revision.opacities_reset {
            self.adam.reset_opacity();
        }
        if let Some(map) = revision.map {
            self.adam.remap(&map);
            self.sums = self.sums.as_ref().map(|_| GradientSums::new(map.len()));
        }
        Ok(())
    }

    fn revise_sky(&mut self, decide: &mut dyn FnMut(&Gaussians, &mut SkyCube)) -> Result<(), Infallible> {
        if let Surrounding::Trained(sky) = &mut self.around {
            decide(self.layer, sky.texels());
        }
        Ok(())
    }

    fn download(self) -> Result<(), Infallible> {
        Ok(())
    }
}
