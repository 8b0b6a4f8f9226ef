//! What the static lane and the sky lane share. Both look only at pixels outside the dilated foreground mask, so that
//! they need nothing from the dynamic lane of the same frame.

use crate::{LearningRates, SkyView, TexelGradients};
use ffgs_core::{Camera, ImageSize, Mask, PlanarImage, SkyCube, TrainingView};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// How the static lane finds its colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StaticMethod {
    /// One linear least-squares problem per frame: with frozen geometry the image is linear in the SH coefficients.
    Solve,
    /// Steps of Adam, as in the paper.
    Steps,
}

/// How the static layer's colours and the sky follow the light each frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BackgroundConfig {
    /// How the static layer's colours are found.
    pub static_method: StaticMethod,
    /// Frames from one training of the static layer and the sky to the next.
    pub every: usize,
    /// Iterations of conjugate gradients per frame, each over all views; method `solve`.
    pub solve_iterations: usize,
    /// SH degree up to which the solve changes colours.
    pub solve_degree: usize,
    /// Expected error of a pixel (0..1), against which a change of colour must pay off.
    pub solve_noise: f32,
    /// Expected change of SH coefficient 0 of a Gaussian of whose colour no frame after the first told anything.
    pub solve_sh0_change: f32,
    /// Expected change of the other SH coefficients likewise.
    pub solve_sh_rest_change: f32,
    /// Change of SH coefficient 0 from one frame to the next, once it is known.
    pub solve_sh0_drift: f32,
    /// Change of the other SH coefficients likewise.
    pub solve_sh_rest_drift: f32,
    /// A Gaussian with less than this share of what it colours outside the masks keeps its colours of the frame before for the next one; 0 = all keep what
    /// they get.
    pub solve_in_view: f32,
    /// Pixels of all views per static Gaussian that are enough: where there are more, those of a lattice are traced; 0 = all are.
    pub solve_pixels: usize,
    /// Most memory (MiB) for the traced contributors of all views; beyond it fewer are kept, then those of a lattice of pixels.
    pub solve_memory_mib: usize,
    /// Steps per frame, one view each; method `steps`.
    pub static_iterations: usize,
    /// Rate of SH coefficient 0 in these steps.
    pub sh0_rate: f32,
    /// Rate of the other SH coefficients.
    pub sh_rest_rate: f32,
    /// Steps per frame of the sky lane.
    pub sky_iterations: usize,
    /// Rate of the sky's texels.
    pub sky_rate: f32,
    /// Least change of a camera's exposure, or of the light that all cameras see, that is followed (log odds of the values); 0 = none is.
    pub exposure_change: f32,
    /// Pixels by which the mask is widened before it is left out ([`Mask::widened`]).
    pub mask_dilation: usize,
}

impl Default for BackgroundConfig {
    fn default() -> Self {
        Self {
            static_method: StaticMethod::Solve,
            every: 1,
            solve_iterations: 4,
            solve_degree: 3,
            solve_noise: 0.05,
            solve_sh0_change: 0.3,
            solve_sh_rest_change: 0.05,
            solve_sh0_drift: 0.03,
            solve_sh_rest_drift: 0.005,
            solve_in_view: 0.7,
            solve_pixels: 30,
            solve_memory_mib: 4096,
            static_iterations: 500,
            sh0_rate: 1e-3,
            sh_rest_rate: 5e-5,
            sky_iterations: 50,
            sky_rate: 1e-3,
            exposure_change: 0.05,
            mask_dilation: 1,
        }
    }
}

impl BackgroundConfig {
    /// Step sizes of the method `steps`: colours only.
    pub(crate) fn static_rates(&self) -> LearningRates {
        LearningRates {
            means: 0.0,
            quats: 0.0,
            scales: 0.0,
            opacities: 0.0,
            sh0: self.sh0_rate,
            sh_rest: self.sh_rest_rate,
        }
    }

    /// Iterations of the chosen method.
    pub fn static_passes(&self) -> usize {
        match self.static_method {
            StaticMethod::Solve => self.solve_iterations,
            StaticMethod::Steps => self.static_iterations,
        }
    }
}

/// Pixels of a view outside the foreground, widened by `dilation` ([`Mask::widened`]).
pub(crate) fn outside(view: &TrainingView, dilation: usize) -> Mask {
    let grown = view.mask.widened(dilation);
    let inverse = grown.data().iter().map(|&v| u8::from(v == 0)).collect();
    Mask::new(grown.size(), inverse).unwrap_or_else(|| Mask::filled(grown.size(), true))
}

/// The sky behind one view after another, in the same memory.
pub(crate) struct SkyBehind {
    view: Option<SkyView>,
    image: PlanarImage,
}

impl SkyBehind {
    pub(crate) fn new() -> Self {
        Self { view: None, image: PlanarImage::zeros(ImageSize { width: 1, height: 1 }) }
    }

    /// Draws what `camera` sees.
    pub(crate) fn aim(&mut self, sky: &SkyCube, camera: &Camera) {
        let view = self.view.get_or_insert_with(|| SkyView::new(camera, sky.face_size()));
        view.aim(camera);
        view.render(sky, &mut self.image);
    }

    /// What was drawn last.
    pub(crate) fn image(&self) -> &PlanarImage {
        &self.image
    }

    /// Draws what `camera` sees, and shows it.
    pub(crate) fn render(&mut self, sky: &SkyCube, camera: &Camera) -> &PlanarImage {
        self.aim(sky, camera);
        &self.image
    }

    /// Adds the derivative by the texels, given that by each pixel of the last camera.
    pub(crate) fn backward(&self, gradient: impl Fn(usize) -> Vec3 + Sync, out: &mut TexelGradients) {
        if let Some(view) = &self.view {
            view.backward(gradient, out);
        }
    }
}
