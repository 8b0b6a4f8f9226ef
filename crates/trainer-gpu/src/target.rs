//! A photograph in the memory of the device, with its view and the pixels that count.

use crate::layout::LossUniform;
use ffgs_core::{Camera, ImageRgb8, Mask};
use ffgs_gpu::{Buffer, Gpu, GpuError};
use ffgs_rasterizer::{TILE, TileMask};
use ffgs_rasterizer_gpu::GpuView;
use ffgs_trainer::SSIM_WEIGHT;

/// A photograph on the device (8 bits per channel) with the view it was taken from and the pixels that count.
pub(crate) struct Target {
    pub view: GpuView,
    pub photograph: Buffer,
    /// One bit per pixel, row by row.
    pub region: Buffer,
    pub loss: Buffer,
}

/// What of a view to train on.
pub(crate) struct Selection<'a> {
    /// Pixels that count; `None` = all.
    pub region: Option<&'a Mask>,
    /// Tiles to compute; they must hold the region.
    pub tiles: Option<&'a TileMask>,
    /// Layers that serve several views in turn.
    pub layers: Option<&'a Buffer>,
}

impl Target {
    pub(crate) fn new(
        gpu: &Gpu,
        camera: &Camera,
        image: &ImageRgb8,
        selection: &Selection,
    ) -> Result<Self, GpuError> {
        let view = GpuView::layered(gpu, camera, selection.tiles, selection.layers)?;
        let counted = selection.region.map_or(camera.size().pixels(), Mask::count);
        Ok(Self {
            photograph: gpu.upload("photograph", image.data())?,
            region: gpu.upload("loss region", &bits_of(camera, selection.region))?,
            loss: gpu.uniform("loss", &uniform(camera, view.slots(), counted))?,
            view,
        })
    }
}

fn uniform(camera: &Camera, slots: usize, counted: usize) -> LossUniform {
    let size = camera.size();
    let per_sample = if counted == 0 { 0.0 } else { 1.0 / (3.0 * counted as f64) };
    LossUniform {
        size: [size.width as u32, size.height as u32],
        tiles: [size.width.div_ceil(TILE) as u32, size.height.div_ceil(TILE) as u32],
        slots: slots as u32,
        l1_factor: ((1.0 - SSIM_WEIGHT) * per_sample) as f32,
        ssim_factor: (-SSIM_WEIGHT * per_sample) as f32,
        per_sample: per_sample as f32,
    }
}

fn bits_of(camera: &Camera, region: Option<&Mask>) -> Vec<u32> {
    let pixels = camera.size().pixels();
    let mut bits = vec![0; pixels.div_ceil(32)];
    for pixel in (0..pixels).filter(|&p| region.is_none_or(|m| m.data()[p] != 0)) {
        bits[pixel / 32] |= 1 << (pixel % 32);
    }
    bits
}
