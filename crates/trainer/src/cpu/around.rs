//! The fixed surroundings of a layer under training, rendered for a view.

use super::cut::Cut;
use crate::backend::TaskView;
use crate::background::SkyBehind;
use crate::sky::sky_share;
use crate::{AdamVec, SKY_DOUBT, TexelGradients, Update};
use ffgs_core::{PlanarImage, SkyCube};
use ffgs_rasterizer::PixelGradients;
use glam::Vec3;

/// [`crate::Around`] with the view at hand.
pub(super) enum Surrounding<'a> {
    Sky(&'a SkyCube, SkyBehind),
    Trained(Box<TrainedSky<'a>>),
    Cut(Box<Cut<'a>>),
}

impl Surrounding<'_> {
    /// Turns to a view.
    pub(crate) fn aim(&mut self, index: usize, task: &TaskView) {
        let camera = &task.view.camera;
        match self {
            Self::Sky(sky, behind) => behind.aim(sky, camera),
            Self::Trained(sky) => sky.behind.aim(sky.sky, camera),
            Self::Cut(cut) => cut.aim(index, task),
        }
    }

    /// What is behind the layer in the view at hand.
    pub(crate) fn behind(&self) -> &PlanarImage {
        match self {
            Self::Sky(_, behind) => behind.image(),
            Self::Trained(sky) => sky.behind.image(),
            Self::Cut(cut) => cut.behind(),
        }
    }

    /// The whole image, given the layer over what is behind it.
    pub(crate) fn compose<'i>(&'i mut self, index: usize, drawn: &'i PlanarImage) -> &'i PlanarImage {
        match self {
            Self::Sky(..) | Self::Trained(_) => drawn,
            Self::Cut(cut) => cut.compose(index, drawn),
        }
    }

    /// From the derivative by the whole image to that by the layer's own.
    pub(crate) fn upstream<'g>(&'g self, index: usize, image: &'g mut PlanarImage) -> PixelGradients<'g> {
        match self {
            Self::Sky(..) | Self::Trained(_) => PixelGradients { image, transmittance: None },
            Self::Cut(cut) => {
                cut.through_front(index, image);
                PixelGradients { image, transmittance: Some(cut.penalty()) }
            }
        }
    }

    /// One step of the sky, if it is trained. `gradient` = derivative by the image; `through` = transmittance of the layer.
    pub(crate) fn step(&mut self, gradient: &PlanarImage, through: &[f32]) {
        if let Self::Trained(sky) = self {
            sky.step(gradient, through);
        }
    }
}

/// A sky that is trained along.
pub(super) struct TrainedSky<'a> {
    sky: &'a mut SkyCube,
    rate: f32,
    behind: SkyBehind,
    adam: AdamVec,
    gradients: TexelGradients,
}

impl<'a> TrainedSky<'a> {
    pub(crate) fn new(sky: &'a mut SkyCube, rate: f32) -> Self {
        let texels = sky.texels.len();
        let (adam, gradients) = (AdamVec::new(texels, 3), TexelGradients::new(texels));
        Self { sky, rate, behind: SkyBehind::new(), adam, gradients }
    }

    /// The sky at hand.
    pub(crate) fn texels(&mut self) -> &mut SkyCube {
        self.sky
    }

    /// Sparse in the texels that the view sees. The transmittance enters twice: the derivative holds it once, and the error
    /// of a hidden pixel is not the sky's.
    fn step(&mut self, gradient: &PlanarImage, through: &[f32]) {
        let share = |pixel: usize| through[pixel] * sky_share(through[pixel]);
        let derivative = |pixel: usize| share(pixel) * Vec3::from(gradient.pixel(pixel));
        let doubt = SKY_DOUBT / (3 * through.len()) as f32;
        self.gradients.clear();
        self.behind.backward(derivative, &mut self.gradients);
        let TexelGradients { sums, touched, .. } = &self.gradients;
        let texels = self.sky.texels.as_flattened_mut();
        self.adam.step(texels, sums.as_flattened(), (self.rate, doubt), Update::Touched(touched));
    }
}
