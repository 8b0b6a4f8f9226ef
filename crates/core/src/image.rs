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
        let value: [f32; 256] = std::array::from_fn(|byte| byte as f32 / 255.0);
        let mut out = Self::zeros(image.size());
        let (red, others) = out.data.split_at_mut(image.size().pixels());
        let (green, blue) = others.split_at_mut(image.size().pixels());
        let planes = red.iter_mut().zip(green).zip(blue);
        for (((red, green), blue), rgb) in planes.zip(image.data().as_chunks::<3>().0) {
            [*red, *green, *blue] = rgb.map(|byte| value[usize::from(byte)]);
        }
        out
    }
}

impl From<&PlanarImage> for ImageRgb8 {
    /// Clamps to [0, 1] and rounds.
    fn from(image: &PlanarImage) -> Self {
        // Half a level added in f64, which is exact, and the cast rounds down.
        let quantise = |v: f32| (f64::from(v.clamp(0.0, 1.0) * 255.0) + 0.5) as u8;
        let mut data = vec![0; 3 * image.size.pixels()];
        let planes = image.plane(0).iter().zip(image.plane(1)).zip(image.plane(2));
        for (rgb, ((&red, &green), &blue)) in data.as_chunks_mut::<3>().0.iter_mut().zip(planes) {
            *rgb = [red, green, blue].map(quantise);
        }
        Self { size: image.size, data }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_become_shares_and_shares_the_nearest_bytes() {
        let size = ImageSize { width: 256, height: 1 };
        let bytes = ImageRgb8::new(size, (0..=255).flat_map(|v| [v, 255 - v, 7]).collect()).unwrap();
        let planes = PlanarImage::from(&bytes);
        assert!((0..256).all(|p| planes.pixel(p) == bytes.pixel(p)));
        assert_eq!(ImageRgb8::from(&planes), bytes);
        let mut odd = PlanarImage::zeros(ImageSize { width: 4, height: 1 });
        // The largest number below one half rounds down, though with one half added in f32 it would be one.
        let below_half = 0.499_999_97_f32;
        odd.set_pixel(0, [-3.0, 2.0, f32::NAN]);
        odd.set_pixel(1, [0.5 / 255.0, 1.5 / 255.0, below_half / 255.0]);
        odd.set_pixel(2, [254.4 / 255.0, 254.6 / 255.0, f32::INFINITY]);
        let expected = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let found = ImageRgb8::from(&odd);
        for pixel in 0..4 {
            let values = odd.pixel(pixel);
            assert_eq!(found.data()[3 * pixel..3 * pixel + 3], values.map(expected), "{values:?}");
        }
    }
}
