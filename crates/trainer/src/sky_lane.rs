//! The sky lane: texels of the cube map, through what the static layer lets through.

use crate::background::{BackgroundConfig, outside};
use crate::schedule::Epochs;
use crate::{AdamVec, SkyView, TexelGradients, Update};
use ffgs_core::{Gaussians, ImageSize, PlanarImage, SkyCube, TrainingView};
use ffgs_rasterizer::{Background, CpuRasterizer, Rasterizer, RenderOptions, RenderTape, View};

/// Finetunes the sky through the transmittance that `layer` leaves; the layer is rendered once a view.
pub fn train_sky(
    config: &BackgroundConfig,
    views: &[TrainingView],
    layer: &Gaussians,
    sky: &mut SkyCube,
    seed: u64,
) {
    if config.sky_iterations == 0 {
        return;
    }
    let Some(first) = views.first() else { return };
    let mut tape = RenderTape::default();
    let mut target = |view| SkyTarget::new(view, layer, config.mask_dilation, &mut tape);
    let cached: Vec<SkyTarget> = views.iter().map(&mut target).collect();
    let mut aimed = SkyView::new(&first.camera, sky.face_size());
    let mut adam = AdamVec::new(sky.texels.len(), 3);
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    let mut rendered = PlanarImage::zeros(ImageSize { width: 1, height: 1 });
    let mut gradient = TexelGradients::new(sky.texels.len());
    for _ in 0..config.sky_iterations {
        let Some(index) = epochs.draw() else { return };
        let target = &cached[index];
        aimed.aim(&views[index].camera);
        aimed.render(sky, &mut rendered);
        target.residual(&mut rendered);
        gradient.clear();
        aimed.backward(&rendered, &mut gradient);
        let (texels, sums) = (sky.texels.as_flattened_mut(), gradient.sums.as_flattened());
        adam.step(texels, sums, config.sky_rate, Update::Touched(&gradient.touched));
    }
}

struct SkyTarget {
    /// Photograph minus the layer's own colour.
    remainder: PlanarImage,
    /// Transmittance; 0 where the foreground may be.
    transmittance: Vec<f32>,
}

impl SkyTarget {
    fn new(view: &TrainingView, layer: &Gaussians, dilation: usize, tape: &mut RenderTape) -> Self {
        let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: None };
        CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None }).render(layer, &frame, tape);
        let mut remainder = PlanarImage::from(&view.image);
        remainder.data_mut().iter_mut().zip(tape.image().data()).for_each(|(r, c)| *r -= c);
        let region = outside(view, dilation);
        let counted = tape.transmittance().iter().zip(region.data());
        let transmittance = counted.map(|(&t, &inside)| if inside == 0 { 0.0 } else { t }).collect();
        Self { remainder, transmittance }
    }

    /// Replaces a rendered sky by the derivative of half the squared error.
    fn residual(&self, sky: &mut PlanarImage) {
        let pixels = self.transmittance.len();
        for (i, v) in sky.data_mut().iter_mut().enumerate() {
            let t = self.transmittance[i % pixels];
            *v = t * (t * *v - self.remainder.data()[i]);
        }
    }
}
