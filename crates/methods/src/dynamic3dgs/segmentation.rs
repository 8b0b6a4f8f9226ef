//! The segmentation loss of Dynamic 3D Gaussians: Gaussians in the colours of foreground and background, compared with the masks.

use crate::photographs::Comparison;
use anyhow::Result;
use ffgs_core::{Gaussians, ImageRgb8, Mask, SH_C0, TrainingView};
use ffgs_rasterizer::{Background, Gradients};

/// Colours of what moves and what does not, of which nothing is trained.
const FOREGROUND: [f32; 3] = [1.0, 0.0, 0.0];
const BACKGROUND: [f32; 3] = [0.0, 0.0, 1.0];

/// Masks as images, and the Gaussians in the colours of the layer that they were marked as.
pub(super) struct Segmentation<'a> {
    views: &'a [TrainingView],
    masks: Vec<ImageRgb8>,
    coloured: Gaussians,
    comparison: Comparison,
    gradients: Gradients,
}

impl<'a> Segmentation<'a> {
    /// The first `foreground` of `gaussians` are those that move.
    pub(crate) fn new(views: &'a [TrainingView], gaussians: &Gaussians, foreground: usize) -> Self {
        let mut coloured = Gaussians::zeros(gaussians.len(), 0);
        coloured.log_scales.clone_from(&gaussians.log_scales);
        coloured.opacity_logits.clone_from(&gaussians.opacity_logits);
        for (i, sh) in coloured.sh.iter_mut().enumerate() {
            *sh = if i < foreground { FOREGROUND } else { BACKGROUND }.map(|rgb| (rgb - 0.5) / SH_C0);
        }
        let masks = views.iter().map(|view| image(&view.mask)).collect();
        let (comparison, gradients) = (Comparison::new(), Gradients::default());
        Self { views, masks, coloured, comparison, gradients }
    }

    /// Adds `weight` times the derivatives of a view's loss by places and rotations to `out`.
    ///
    /// # Errors
    /// When the loss is not finite.
    pub(crate) fn add(
        &mut self,
        weight: f32,
        view: usize,
        gaussians: &Gaussians,
        out: &mut Gaussians,
    ) -> Result<f64> {
        self.coloured.means.clone_from(&gaussians.means);
        self.coloured.quats.clone_from(&gaussians.quats);
        let camera = &self.views[view].camera;
        let behind = Background::Colour(BACKGROUND);
        let (coloured, gradients) = (&self.coloured, &mut self.gradients);
        let value = self.comparison.forward(coloured, camera, behind, &self.masks[view])?;
        self.comparison.backward(coloured, camera, behind, gradients);
        let add =
            |sum: &mut [f32], more: &[f32]| sum.iter_mut().zip(more).for_each(|(s, m)| *s += weight * m);
        add(out.means.as_flattened_mut(), gradients.gaussians.means.as_flattened());
        add(out.quats.as_flattened_mut(), gradients.gaussians.quats.as_flattened());
        Ok(f64::from(weight) * value)
    }
}

fn image(mask: &Mask) -> ImageRgb8 {
    let colour = |inside: &u8| if *inside == 0 { BACKGROUND } else { FOREGROUND };
    let values = mask.data().iter().flat_map(colour).map(|rgb| (255.0 * rgb) as u8).collect();
    ImageRgb8::new(mask.size(), values).expect("three values per pixel")
}
