//! Images: 8-bit sRGB as they are on disk, and planes of f32 as the rasterizer and the losses compute.

use crate::ImageSize;

/// An 8-bit sRGB image, interleaved; images are kept in this form and converted tile by tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageRgb8 {
    size: ImageSize,
    data: Vec<u8>,
}

impl ImageRgb8 {
    /// `data` holds `height * width * 3` bytes; `None` for any other length.
    pub fn new(size: ImageSize, data: Vec<u8>) -> Option<Self> {
        (data.len() == size.pixels() * 3).then_some(Self { size, data })
    }

    /// Image size.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Interleaved bytes, row by row.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// The three channels of a pixel in 0..=1.
    pub fn pixel(&self, index: usize) -> [f32; 3] {
        let p = &self.data[index * 3..index * 3 + 3];
        [f32::from(p[0]) / 255.0, f32::from(p[1]) / 255.0, f32::from(p[2]) / 255.0]
    }
}

/// A floating-point RGB image in three planes: `data[channel * pixels + row * width + column]`.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarImage {
    size: ImageSize,
    data: Vec<f32>,
}

impl PlanarImage {
    /// A black image.
    pub fn zeros(size: ImageSize) -> Self {
        Self { size, data: vec![0.0; size.pixels() * 3] }
    }

    /// Resizes and clears, keeping the allocation.
    pub fn reset(&mut self, size: ImageSize) {
        self.size = size;
        self.data.clear();
        self.data.resize(size.pixels() * 3, 0.0);
    }

    /// Image size.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// All three planes.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// All three planes.
    pub fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }

    /// One plane.
    pub fn plane(&self, channel: usize) -> &[f32] {
        let n = self.size.pixels();
        &self.data[channel * n..(channel + 1) * n]
    }

    /// RGB of a pixel.
    pub fn pixel(&self, index: usize) -> [f32; 3] {
        let n = self.size.pixels();
        [self.data[index], self.data[n + index], self.data[2 * n + index]]
    }

    /// Sets the RGB of a pixel.
    pub fn set_pixel(&mut self, index: usize, rgb: [f32; 3]) {
        let n = self.size.pixels();
        self.data[index] = rgb[0];
        self.data[n + index] = rgb[1];
        self.data[2 * n + index] = rgb[2];
    }
}

impl From<&ImageRgb8> for PlanarImage {
    fn from(image: &ImageRgb8) -> Self {
        let mut out = Self::zeros(image.size());
        for i in 0..image.size().pixels() {
            out.set_pixel(i, image.pixel(i));
        }
        out
    }
}

impl From<&PlanarImage> for ImageRgb8 {
    /// Clamps to [0, 1] and rounds.
    fn from(image: &PlanarImage) -> Self {
        let quantise = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let data = (0..image.size.pixels()).flat_map(|i| image.pixel(i).map(quantise)).collect();
        Self { size: image.size, data }
    }
}
