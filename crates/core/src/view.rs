//! A photograph with its camera and mask, and its reduction by whole blocks of pixels.

use crate::kernel::{self, Kernel};
use crate::{Camera, ImageRgb8, ImageSize, Mask};
use rayon::prelude::*;
use std::borrow::Cow;

/// One view of a frame: its camera, photograph and foreground.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// Camera of this frame.
    pub camera: Camera,
    /// The photograph, of the camera's size.
    pub image: ImageRgb8,
    /// Foreground mask; all background where the capture has none.
    pub mask: Mask,
}

impl TrainingView {
    /// The view with square blocks of `factor` pixels as its pixels ([`Camera::reduced`]): means of the photograph, and
    /// foreground where any pixel of a block is.
    #[must_use]
    pub fn reduced(&self, factor: usize) -> Self {
        let camera = self.camera.reduced(factor);
        if camera.size() == self.camera.size() {
            return self.clone();
        }
        let image = self.image.reduced(factor);
        Self { camera, image, mask: self.mask.reduced(factor) }
    }

    /// All of `views` reduced by `factor`; the views themselves with a factor of 1.
    pub fn all_reduced(views: &[Self], factor: usize) -> Cow<'_, [Self]> {
        if factor <= 1 {
            return Cow::Borrowed(views);
        }
        Cow::Owned(views.par_iter().map(|view| view.reduced(factor)).collect())
    }
}

impl ImageRgb8 {
    /// Means over square blocks of `factor` pixels, of the size [`ImageSize::reduced`].
    #[must_use]
    pub fn reduced(&self, factor: usize) -> Self {
        let (from, size) = (self.size(), self.size().reduced(factor));
        if size == from {
            return self.clone();
        }
        let mut data = vec![0; 3 * size.pixels()];
        kernel::dispatch(BlockMeans { rows: self.data(), width: from.width, factor, out: &mut data });
        Self::new(size, data).expect("three bytes per block")
    }
}

/// Means over square blocks of pixels of three bytes.
struct BlockMeans<'a> {
    rows: &'a [u8],
    /// Pixels of a row.
    width: usize,
    factor: usize,
    out: &'a mut [u8],
}

impl Kernel for BlockMeans<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { rows, width, factor, out } = self;
        let (stride, count) = (3 * width, (factor * factor) as u32);
        let mut columns = vec![0u32; stride];
        let bands = rows.chunks_exact(stride * factor);
        for (rows, out) in bands.zip(out.chunks_exact_mut(3 * (width / factor))) {
            columns.fill(0);
            for row in rows.chunks_exact(stride) {
                for i in 0..stride {
                    columns[i] += u32::from(row[i]);
                }
            }
            for (block, mean) in columns.chunks_exact(3 * factor).zip(out.chunks_exact_mut(3)) {
                let mut sums = [count / 2; 3];
                for pixel in block.chunks_exact(3) {
                    for c in 0..3 {
                        sums[c] += pixel[c];
                    }
                }
                for c in 0..3 {
                    mean[c] = (sums[c] / count) as u8;
                }
            }
        }
    }
}

impl Mask {
    /// Foreground where any pixel of a square block of `factor` pixels is, of the size [`ImageSize::reduced`].
    #[must_use]
    pub fn reduced(&self, factor: usize) -> Self {
        let (from, size): (ImageSize, ImageSize) = (self.size(), self.size().reduced(factor));
        if size == from {
            return self.clone();
        }
        let mut data = vec![0; size.pixels()];
        let bands = self.data().chunks_exact(from.width * factor);
        for (out, rows) in data.chunks_exact_mut(size.width).zip(bands) {
            for row in rows.chunks_exact(from.width) {
                let blocks = row.chunks_exact(factor);
                out.iter_mut()
                    .zip(blocks)
                    .for_each(|(out, block)| *out |= block.iter().fold(0, |a, v| a | v));
            }
        }
        Self::new(size, data).expect("one byte per block")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;
    use glam::{DMat4, DVec3};

    const SIZE: ImageSize = ImageSize { width: 7, height: 4 };

    fn view() -> TrainingView {
        let intrinsics = Intrinsics { fx: 6.0, fy: 5.0, cx: 3.0, cy: 2.5 };
        let image = (0..3 * SIZE.pixels()).map(|i| (i * 37 % 251) as u8).collect();
        let mut mask = vec![0; SIZE.pixels()];
        mask[7 + 3] = 1;
        mask[6] = 1;
        TrainingView {
            camera: Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap(),
            image: ImageRgb8::new(SIZE, image).unwrap(),
            mask: Mask::new(SIZE, mask).unwrap(),
        }
    }

    #[test]
    fn a_reduced_view_shows_points_in_their_block() {
        let (full, half) = (view(), view().reduced(2));
        assert_eq!(half.camera.size(), ImageSize { width: 3, height: 2 });
        assert_eq!([&full, &half].map(|view| view.camera.reduction()), [1, 2]);
        assert_eq!((half.image.size(), half.mask.size()), (half.camera.size(), half.camera.size()));
        let point = DVec3::new(0.3, -0.2, 2.0);
        let [a, b] = [&full, &half].map(|view| view.camera.project(point).unwrap().pixel);
        assert!((a - 2.0 * b).length() < 1e-12);
        let pixel = |x: usize, y: usize| u32::from(full.image.data()[3 * (7 * y + x) + 1]);
        let mean = (pixel(2, 2) + pixel(3, 2) + pixel(2, 3) + pixel(3, 3) + 2) / 4;
        assert_eq!(u32::from(half.image.data()[3 * (3 + 1) + 1]), mean);
        // The pixel of the last column is in no whole block.
        assert_eq!(half.mask.data(), [0, 1, 0, 0, 0, 0]);
    }

    #[test]
    fn an_image_smaller_than_a_block_stays() {
        for factor in [0, 1, 5] {
            let same = view().reduced(factor);
            assert_eq!((same.camera, same.image, same.mask), (view().camera, view().image, view().mask));
        }
    }
}
