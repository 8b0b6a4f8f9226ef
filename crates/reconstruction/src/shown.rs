//! What the views show of what moves.

use ffgs_core::{Gaussians, Mask, TrainingView};
use ffgs_motion::MarkingConfig;
use ffgs_rasterizer::{
    Background, CpuRasterizer, RenderOptions, RenderTape, TileMask, TopContributors, View,
};
use rayon::prelude::*;

/// What a view shows of what moves.
pub(crate) struct Shown {
    /// Its foreground where the layer, which moves, has enough alpha. Masks alone would do where they are right; one that errs has nothing in it that
    /// moves.
    pub mask: Mask,
    /// (H, W) the moving Gaussian that a pixel of `mask` shows most of; -1 elsewhere.
    pub gaussians: Vec<i32>,
}

/// What each view shows of `moving`.
pub(crate) fn shown(marking: &MarkingConfig, moving: &Gaussians, views: &[TrainingView]) -> Vec<Shown> {
    let of_view = |tape: &mut RenderTape, view| Shown::new(moving, view, marking.covering_alpha, tape);
    views.par_iter().map_init(RenderTape::default, of_view).collect()
}

impl Shown {
    /// Of `layer`, where it has at least this alpha.
    fn new(layer: &Gaussians, view: &TrainingView, alpha: f32, tape: &mut RenderTape) -> Self {
        let (size, tiles) = (view.mask.size(), TileMask::covering(&view.mask));
        let background = Background::Colour([0.0; 3]);
        let frame = View { camera: &view.camera, background, tiles: Some(&tiles) };
        let options = RenderOptions { sh_degree: Some(0), ..RenderOptions::default() };
        CpuRasterizer::new(options).render(layer, &frame, tape);
        let pixels = tape.transmittance().iter().zip(view.mask.data());
        let shown = pixels.map(|(&t, &inside)| u8::from(inside != 0 && 1.0 - t >= alpha)).collect();
        let mask = Mask::new(size, shown).expect("one value per pixel");
        let gaussians = TopContributors::of(tape, size, 1, |pixel| mask.data()[pixel] != 0).indices;
        Self { mask, gaussians }
    }
}
