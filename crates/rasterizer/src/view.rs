//! What is rendered and how: a camera, its background, the tiles to compute, and the options.

use crate::dropout::Dropout;
use crate::tiles::TileMask;
use ffgs_core::{Camera, PlanarImage};

/// What shows where the Gaussians leave transmittance.
#[derive(Clone, Copy, Debug)]
pub enum Background<'a> {
    /// One colour.
    Colour([f32; 3]),
    /// A colour per pixel (the sky, or a layer behind), of the camera's size.
    Image(&'a PlanarImage),
}

impl Background<'_> {
    /// RGB behind pixel `index`.
    pub(crate) fn pixel(&self, index: usize) -> [f32; 3] {
        match self {
            Self::Colour(rgb) => *rgb,
            Self::Image(image) => image.pixel(index),
        }
    }
}

/// One view to render.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Camera; its size is the image's.
    pub camera: &'a Camera,
    /// What shows behind the Gaussians.
    pub background: Background<'a>,
    /// Tiles to compute; `None` = all. Pixels of other tiles are black with transmittance 1.
    pub tiles: Option<&'a TileMask>,
}

/// How to render.
#[derive(Clone, Copy, Debug, Default)]
pub struct RenderOptions {
    /// SH degree to evaluate; `None` = the Gaussians' own. Lower while colours are still coarse.
    pub sh_degree: Option<usize>,
    /// Gaussians that are left out by chance; `None` = none.
    pub dropout: Option<Dropout>,
    /// Whether the projection is linear around the centres of all Gaussians, as in EWA splatting, also of those that lie outside
    /// the frustum: what stands beside the camera then veils the image (docs/adr/0064-projections-are-linear-where-they-are-seen.md).
    pub at_centres: bool,
}
