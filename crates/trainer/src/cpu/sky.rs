//! The training of the sky on the CPU.

use crate::backend::{SkyTask, SkyTraining, TaskView};
use crate::background::SkyBehind;
use crate::sky::sky_share;
use crate::sky_lane::render_alone;
use crate::{AdamVec, SKY_LANE_DOUBT, TexelGradients, Update};
use ffgs_core::{Camera, Gaussians, PlanarImage, SkyCube};
use ffgs_rasterizer::RenderTape;
use glam::Vec3;
use rayon::prelude::*;
use std::convert::Infallible;

/// A sky under training on the CPU. The layer before it is rendered once per view.
pub struct CpuSky<'a> {
    sky: &'a mut SkyCube,
    rate: f32,
    targets: Vec<Target<'a>>,
    behind: SkyBehind,
    adam: AdamVec,
    gradient: TexelGradients,
}

impl<'a> CpuSky<'a> {
    pub(super) fn new(task: SkyTask<'a>) -> Self {
        let SkyTask { sky, rate, layer, views } = task;
        let mut tape = RenderTape::default();
        let targets = views.iter().map(|view| Target::new(view, layer, &mut tape)).collect();
        let texels = sky.texels.len();
        let (adam, gradient) = (AdamVec::new(texels, 3), TexelGradients::new(texels));
        Self { sky, rate, targets, behind: SkyBehind::new(), adam, gradient }
    }
}

impl SkyTraining for CpuSky<'_> {
    type Error = Infallible;

    fn step(&mut self, view: usize) -> Result<(), Infallible> {
        let target = &self.targets[view];
        self.behind.aim(self.sky, target.camera);
        let derivative = |pixel| target.derivative(self.behind.image(), pixel);
        self.gradient.clear();
        self.behind.backward(derivative, &mut self.gradient);
        let (texels, sums) = (self.sky.texels.as_flattened_mut(), self.gradient.sums.as_flattened());
        let rate = (self.rate, SKY_LANE_DOUBT);
        self.adam.step(texels, sums, rate, Update::Touched(&self.gradient.touched));
        Ok(())
    }

    fn download(self) -> Result<(), Infallible> {
        Ok(())
    }
}

struct Target<'a> {
    camera: &'a Camera,
    /// Photograph minus the layer's own colour.
    remainder: PlanarImage,
    /// Transmittance; 0 outside the region.
    transmittance: Vec<f32>,
}

impl<'a> Target<'a> {
    fn new(task: &TaskView<'a>, layer: &Gaussians, tape: &mut RenderTape) -> Self {
        render_alone(layer, task.view, tape);
        let mut remainder = PlanarImage::from(&task.view.image);
        remainder.data_mut().par_iter_mut().zip(tape.image().data()).for_each(|(r, c)| *r -= c);
        let counts = |pixel: usize| task.region.as_ref().is_none_or(|region| region.data()[pixel] != 0);
        let counted = tape.transmittance().par_iter().enumerate();
        let transmittance = counted.map(|(pixel, &t)| if counts(pixel) { t } else { 0.0 }).collect();
        Self { camera: &task.view.camera, remainder, transmittance }
    }

    /// The derivative of half the squared error by a pixel of a rendered sky, weighted by the transmittance once more: the error
    /// of a hidden pixel is not the sky's.
    fn derivative(&self, sky: &PlanarImage, pixel: usize) -> Vec3 {
        let (t, remainder) = (self.transmittance[pixel], Vec3::from(self.remainder.pixel(pixel)));
        t * sky_share(t) * (t * Vec3::from(sky.pixel(pixel)) - remainder)
    }
}
