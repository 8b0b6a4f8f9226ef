//! A view in the memory of the device: camera, tiles, and the layers behind and in front of the Gaussians.

use crate::layout::ViewUniform;
use ffgs_core::{Camera, ImageSize, PlanarImage};
use ffgs_gpu::{Buffer, Gpu, GpuError};
use ffgs_rasterizer::constants::{AREA, FRUSTUM_MARGIN, TILE};
use ffgs_rasterizer::{Background, TileMask, pixel_filter};

/// `NO_SLOT` of the shaders.
pub(crate) const NO_SLOT: u32 = u32::MAX;

/// Parts of the lists of all tiles together, unless there are more tiles: enough for every processor of a large device to have
/// several, as the backward pass of a part waits for itself most of the time.
pub(crate) const STATES: usize = 4096;
/// Parts of a list at most. A part has at least a batch of 64 splats.
const MOST_PARTS: usize = 64;

/// A view on the device: camera, the tiles to compute, and what lies behind and in front of the Gaussians.
#[derive(Clone, Debug)]
pub struct GpuView {
    pub(crate) uniform: Buffer,
    pub(crate) constants: ViewUniform,
    pub(crate) tile_slots: Buffer,
    pub(crate) slots: Buffer,
    /// Two vec4 per pixel, tile by tile of the computed ones: RGB behind and transmittance in front; RGB in front and the
    /// derivative of the loss by this layer's transmittance. A placeholder for a background of one colour.
    pub layers: Buffer,
    tiles: Vec<u32>,
}

impl GpuView {
    /// Copies a view to the device. An image as background is stored for the computed tiles only.
    ///
    /// # Errors
    /// When the device has too little memory.
    pub fn new(
        gpu: &Gpu,
        camera: &Camera,
        background: Background,
        mask: Option<&TileMask>,
    ) -> Result<Self, GpuError> {
        let mut view = Self::without_layers(gpu, camera, mask)?;
        match background {
            Background::Colour(rgb) => view.constants.background = rgb,
            Background::Image(image) => {
                view.constants.layered = 1;
                view.layers = gpu.upload("background", &view.behind(image))?;
            }
        }
        Ok(view)
    }

    /// A view whose layers are filled on the device; `shared` ones serve several views in turn.
    ///
    /// # Errors
    /// When the device has too little memory.
    pub fn layered(
        gpu: &Gpu,
        camera: &Camera,
        mask: Option<&TileMask>,
        shared: Option<&Buffer>,
    ) -> Result<Self, GpuError> {
        let mut view = Self::without_layers(gpu, camera, mask)?;
        view.constants.layered = 1;
        view.layers = match shared {
            Some(layers) => layers.clone(),
            None => gpu.buffer("layers", Self::layer_bytes(view.tiles.len()))?,
        };
        Ok(view)
    }

    /// Bytes of the layers of `slots` tiles.
    pub fn layer_bytes(slots: usize) -> u64 {
        (slots * AREA * 32) as u64
    }

    fn without_layers(gpu: &Gpu, camera: &Camera, mask: Option<&TileMask>) -> Result<Self, GpuError> {
        let constants = camera_constants(camera);
        let count = constants.tiles[0] * constants.tiles[1];
        let tiles: Vec<u32> = (0..count).filter(|&t| mask.is_none_or(|m| m.is_active(t as usize))).collect();
        let mut tile_slots = vec![NO_SLOT; count as usize];
        tiles.iter().enumerate().for_each(|(slot, &tile)| tile_slots[tile as usize] = slot as u32);
        let slots: Vec<[u32; 4]> = tiles.iter().map(|&tile| [tile, 0, 0, 0]).collect();
        let parts = (STATES / tiles.len().max(1)).clamp(1, MOST_PARTS) as u32;
        let constants = ViewUniform { slots: tiles.len() as u32, parts, ..constants };
        Ok(Self {
            uniform: gpu.uniform("view", &constants)?,
            constants,
            tile_slots: gpu.upload("tile slots", &tile_slots)?,
            slots: gpu.upload("tiles", &slots)?,
            layers: gpu.buffer("layers", 32)?,
            tiles,
        })
    }

    /// Image size.
    pub fn size(&self) -> ImageSize {
        let [width, height] = self.constants.size;
        ImageSize { width: width as usize, height: height as usize }
    }

    /// Number of computed tiles.
    pub fn slots(&self) -> usize {
        self.tiles.len()
    }

    /// Parts of the lists of all computed tiles.
    pub(crate) fn parts(&self) -> usize {
        self.tiles.len() * self.constants.parts as usize
    }

    /// The uniform with camera and sizes, for kernels of other crates.
    pub fn uniform(&self) -> &Buffer {
        &self.uniform
    }

    /// Per computed tile (number, …), for kernels of other crates.
    pub fn slot_list(&self) -> &Buffer {
        &self.slots
    }

    /// Slot of each tile, for kernels of other crates.
    pub fn tile_slots(&self) -> &Buffer {
        &self.tile_slots
    }

    /// Calls `visit` with every pixel of the computed tiles: its place in the layers and in the row-major image.
    fn for_each_pixel(&self, mut visit: impl FnMut(usize, usize)) {
        let size = self.size();
        let columns = self.constants.tiles[0] as usize;
        for (slot, &tile) in self.tiles.iter().enumerate() {
            let (x0, y0) = (tile as usize % columns * TILE, tile as usize / columns * TILE);
            for y in 0..TILE.min(size.height - y0) {
                for x in 0..TILE.min(size.width - x0) {
                    visit(slot * AREA + y * TILE + x, (y0 + y) * size.width + x0 + x);
                }
            }
        }
    }

    fn behind(&self, image: &PlanarImage) -> Vec<[[f32; 4]; 2]> {
        let mut layers = vec![[[0.0; 4]; 2]; self.tiles.len() * AREA];
        self.for_each_pixel(|layer, pixel| {
            let [r, g, b] = image.pixel(pixel);
            layers[layer][0] = [r, g, b, 1.0];
        });
        layers
    }

    /// Splits downloaded pixels into image and transmittance; outside the computed tiles black and 1.
    pub(crate) fn unpack(&self, pixels: &[[f32; 4]]) -> (PlanarImage, Vec<f32>) {
        let mut image = PlanarImage::zeros(self.size());
        let mut transmittance = vec![1.0; self.size().pixels()];
        self.for_each_pixel(|_, pixel| {
            let [r, g, b, t] = pixels[pixel];
            image.set_pixel(pixel, [r, g, b]);
            transmittance[pixel] = t;
        });
        (image, transmittance)
    }
}

fn camera_constants(camera: &Camera) -> ViewUniform {
    let (k, size, center) = (camera.intrinsics(), camera.size(), camera.center());
    let (focal, principal) = ([k.fx as f32, k.fy as f32], [k.cx as f32, k.cy as f32]);
    let extent = [size.width as f32, size.height as f32];
    let margin = [0, 1].map(|a| 0.5 * FRUSTUM_MARGIN * extent[a] / focal[a]);
    let row = |r: usize| camera.rotation().row(r).as_vec3().extend(0.0).to_array();
    let high = center.as_vec3();
    ViewUniform {
        rotation: [row(0), row(1), row(2)],
        center_high: high.to_array(),
        center_low: (center - high.as_dvec3()).as_vec3().to_array(),
        focal,
        principal,
        slope_low: [0, 1].map(|a| -principal[a] / focal[a] - margin[a]),
        slope_high: [0, 1].map(|a| (extent[a] - principal[a]) / focal[a] + margin[a]),
        size: [size.width as u32, size.height as u32],
        tiles: [size.width.div_ceil(TILE) as u32, size.height.div_ceil(TILE) as u32],
        pixel_filter: pixel_filter(camera),
        ..ViewUniform::default()
    }
}
