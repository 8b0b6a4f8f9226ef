//! A camera in the rasterizer's precision.

use crate::constants::{FRUSTUM_MARGIN, PIXEL_FILTER};
use crate::view::RenderOptions;
use ffgs_core::Camera;
use glam::{DVec3, Mat3};

/// A camera in the rasterizer's precision; positions are taken relative to the centre in f64 first, so that
/// city-scale coordinates lose nothing.
pub(crate) struct PinholeF32 {
    pub(crate) rotation: Mat3,
    pub(crate) center: DVec3,
    pub(crate) focal: [f32; 2],
    pub(crate) principal: [f32; 2],
    /// Slopes x/z, y/z of the widened frustum's sides.
    pub(crate) low: [f32; 2],
    pub(crate) high: [f32; 2],
    /// Variance of the pixel filter (px^2).
    pub(crate) filter: f32,
    /// Factor of distances from the frustum: 0 where every projection is linear around the centre, else 1.
    pub(crate) beyond: f32,
}

/// Variance of the pixel filter (px^2). A pixel of a reduced photograph is the mean over a block of pixels, each of which has
/// the filter of 3D Gaussian Splatting: so a reduced render is what the whole one would be, reduced.
pub fn pixel_filter(camera: &Camera) -> f32 {
    let side = camera.reduction() as f32;
    (PIXEL_FILTER + (side * side - 1.0) / 12.0) / (side * side)
}

impl From<&Camera> for PinholeF32 {
    fn from(camera: &Camera) -> Self {
        let (k, size) = (camera.intrinsics(), camera.size());
        let (w, h) = (size.width as f32, size.height as f32);
        let (focal, principal) = ([k.fx as f32, k.fy as f32], [k.cx as f32, k.cy as f32]);
        let margin = [0.5 * FRUSTUM_MARGIN * w / focal[0], 0.5 * FRUSTUM_MARGIN * h / focal[1]];
        Self {
            rotation: camera.rotation().as_mat3(),
            center: camera.center(),
            focal,
            principal,
            low: [-principal[0] / focal[0] - margin[0], -principal[1] / focal[1] - margin[1]],
            high: [(w - principal[0]) / focal[0] + margin[0], (h - principal[1]) / focal[1] + margin[1]],
            filter: pixel_filter(camera),
            beyond: 1.0,
        }
    }
}

impl PinholeF32 {
    /// The camera of a view that is rendered with `options`.
    pub(crate) fn new(camera: &Camera, options: RenderOptions) -> Self {
        Self { beyond: if options.at_centres { 0.0 } else { 1.0 }, ..Self::from(camera) }
    }
}
