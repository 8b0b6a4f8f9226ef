//! A photograph in the memory of the device, with its view and the pixels that count.
//!
//! Where the device's memory is short, photographs and finished layers stay on the host: one buffer of each serves all views
//! in turn, and [`Target::bring`] fills it before a view is used.

use crate::layout::LossUniform;
use ffgs_core::{Camera, ImageRgb8, Mask, TrainingView};
use ffgs_gpu::{Buffer, Gpu, GpuError};
use ffgs_rasterizer::constants::AREA;
use ffgs_rasterizer::{TILE, TileMask};
use ffgs_rasterizer_gpu::{GpuView, Place};
use ffgs_trainer::{SSIM_WEIGHT, TaskView};

/// A photograph on the device (8 bits per channel) with the view it was taken from and the pixels that count.
pub(crate) struct Target<'a> {
    pub view: GpuView,
    pub photograph: Buffer,
    /// One bit per pixel, row by row.
    pub region: Buffer,
    pub loss: Buffer,
    image: &'a ImageRgb8,
    /// Where the photograph is between uses.
    place: Place,
    /// Whether other views draw into the same layers.
    shares_layers: bool,
    /// The view's finished layers, where they are not its own on the device.
    layers: Vec<[f32; 4]>,
}

/// Buffers that views use in turn, each large enough for all of them.
#[derive(Default)]
pub(crate) struct Shared {
    layers: Option<Buffer>,
    photograph: Option<Buffer>,
}

impl Shared {
    /// For the photographs where they are on the host, for the layers there and where every step draws them anew.
    pub(crate) fn new(
        gpu: &Gpu,
        views: &[TaskView],
        place: Place,
        draws_anew: bool,
    ) -> Result<Self, GpuError> {
        let on_host = place == Place::Host;
        let bytes = views.iter().map(|v| v.view.image.data().len()).max().unwrap_or(1) as u64;
        let slots = views.iter().map(computed_tiles).max().unwrap_or(1);
        Ok(Self {
            layers: (on_host || draws_anew)
                .then(|| gpu.buffer("layers", GpuView::layer_bytes(slots)))
                .transpose()?,
            photograph: on_host.then(|| gpu.buffer("photograph", bytes)).transpose()?,
        })
    }
}

fn computed_tiles(task: &TaskView) -> usize {
    let size = task.view.camera.size();
    let all = size.width.div_ceil(TILE) * size.height.div_ceil(TILE);
    task.tiles.as_ref().map_or(all, TileMask::count)
}

impl<'a> Target<'a> {
    /// A view of which the pixels of `region` count and `tiles`, which hold these, are computed; `None` = all.
    pub(crate) fn new(
        gpu: &Gpu,
        view: &'a TrainingView,
        (region, tiles): (Option<&Mask>, Option<&TileMask>),
        shared: &Shared,
    ) -> Result<Self, GpuError> {
        let (camera, image) = (&view.camera, &view.image);
        let counted = region.map_or(camera.size().pixels(), Mask::count);
        let photograph = match &shared.photograph {
            Some(photograph) => photograph.clone(),
            None => gpu.upload("photograph", image.data())?,
        };
        let view = GpuView::layered(gpu, camera, tiles, shared.layers.as_ref())?;
        Ok(Self {
            photograph,
            region: gpu.upload("loss region", &bits_of(camera, region))?,
            loss: gpu.uniform("loss", &uniform(camera, view.slots(), counted))?,
            view,
            image,
            place: if shared.photograph.is_some() { Place::Host } else { Place::Device },
            shares_layers: shared.layers.is_some(),
            layers: Vec::new(),
        })
    }

    /// Targets of some views.
    pub(crate) fn all(gpu: &Gpu, views: &[TaskView<'a>], shared: &Shared) -> Result<Vec<Self>, GpuError> {
        let target = |task: &TaskView<'a>| {
            Self::new(gpu, task.view, (task.region.as_ref(), task.tiles.as_ref()), shared)
        };
        views.iter().map(target).collect()
    }

    /// Puts what is on the host into the shared buffers, for the next submission.
    pub(crate) fn bring(&self, gpu: &Gpu) {
        if self.place == Place::Host {
            gpu.write(&self.photograph, self.image.data());
            gpu.write(&self.view.layers, &self.layers);
        }
    }

    /// Takes the finished layers to the host, where other views are about to draw into the same buffer. Waits for the device.
    pub(crate) fn keep_layers(&mut self, gpu: &Gpu) -> Result<(), GpuError> {
        if self.shares_layers {
            self.layers = gpu.download(&self.view.layers, self.view.slots() * AREA * 2)?;
        }
        Ok(())
    }
}

/// Takes photographs, and layers that are a view's own, to the host; says whether any were on the device. Nothing is
/// allocated: the buffers of the largest view serve all of them. Waits for the device.
pub(crate) fn leave_device(targets: &mut [Target], gpu: &Gpu) -> Result<bool, GpuError> {
    let photograph =
        targets.iter().map(|target| &target.photograph).max_by_key(|buffer| buffer.bytes()).cloned();
    let layers =
        targets.iter().map(|target| &target.view.layers).max_by_key(|buffer| buffer.bytes()).cloned();
    let (Some(photograph), Some(layers)) = (photograph, layers) else { return Ok(false) };
    let mut left = false;
    for target in targets.iter_mut().filter(|target| target.place == Place::Device) {
        left = true;
        if !target.shares_layers {
            target.shares_layers = true;
            target.keep_layers(gpu)?;
            target.view.layers = layers.clone();
        }
        target.place = Place::Host;
        target.photograph = photograph.clone();
    }
    gpu.release_unused();
    Ok(left)
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
