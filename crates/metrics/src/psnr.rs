//! PSNR over the whole image and over the foreground.

use crate::{SizeMismatch, same_size};
use ffgs_core::{ImageRgb8, Mask, PlanarImage};
use rayon::prelude::*;

/// PSNR reported for images that agree better than this (dB). Identical images have an infinite PSNR, which JSON
/// cannot hold and which would swallow every mean; 100 dB is a mean squared error of 1e-10, far below the 56 dB or
/// so that rounding to 8 bits alone allows.
pub(crate) const MAX_PSNR: f64 = 100.0;

/// Peak signal-to-noise ratio (dB, at most 100) of a render, clamped to [0, 1], against an 8-bit target.
///
/// # Errors
/// When the images differ in size.
pub fn psnr(rendered: &PlanarImage, target: &ImageRgb8) -> Result<f64, SizeMismatch> {
    same_size(rendered.size(), target.size())?;
    let pixels = rendered.size().pixels();
    Ok(decibel(squared_error(rendered, target, |_| true) / (3 * pixels) as f64))
}

/// [`psnr`] over the pixels of `mask`: squared error over masked pixels / (3 * masked count).
/// `None` for an empty mask, or one in which the error is not a number.
///
/// # Errors
/// When images and mask differ in size.
pub fn mpsnr(rendered: &PlanarImage, target: &ImageRgb8, mask: &Mask) -> Result<Option<f64>, SizeMismatch> {
    same_size(rendered.size(), target.size())?;
    same_size(rendered.size(), mask.size())?;
    let masked = mask.count();
    if masked == 0 {
        return Ok(None);
    }
    let error = squared_error(rendered, target, |pixel| mask.data()[pixel] != 0);
    Ok(Some(decibel(error / (3 * masked) as f64)))
}

/// A NaN in the render counts as the largest error, so that a broken render is seen as a bad value.
fn squared_error(rendered: &PlanarImage, target: &ImageRgb8, counts: impl Fn(usize) -> bool + Sync) -> f64 {
    let width = rendered.size().width;
    let row_error = |row: usize| -> f64 {
        let pixels = row * width..(row + 1) * width;
        pixels.filter(|&p| counts(p)).map(|p| pixel_error(rendered.pixel(p), target.pixel(p))).sum()
    };
    let rows: Vec<f64> = (0..rendered.size().height).into_par_iter().map(row_error).collect();
    rows.iter().sum()
}

fn pixel_error(rendered: [f32; 3], target: [f32; 3]) -> f64 {
    let squared = |channel: usize| {
        let difference = f64::from(rendered[channel].clamp(0.0, 1.0)) - f64::from(target[channel]);
        if difference.is_nan() { 1.0 } else { difference * difference }
    };
    (0..3).map(squared).sum()
}

fn decibel(mean_squared_error: f64) -> f64 {
    (-10.0 * mean_squared_error.log10()).min(MAX_PSNR)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    const SIZE: ImageSize = ImageSize { width: 4, height: 3 };

    fn grey(value: u8) -> ImageRgb8 {
        ImageRgb8::new(SIZE, vec![value; 36]).unwrap()
    }

    #[test]
    fn a_known_offset_gives_its_decibels() {
        let mut rendered = PlanarImage::from(&grey(51));
        rendered.data_mut().iter_mut().for_each(|v| *v += 0.1);
        assert!((psnr(&rendered, &grey(51)).unwrap() - 20.0).abs() < 1e-5);
    }

    #[test]
    fn identical_images_are_capped_and_clamping_comes_first() {
        assert_eq!(psnr(&PlanarImage::from(&grey(7)), &grey(7)).unwrap(), MAX_PSNR);
        let mut bright = PlanarImage::zeros(SIZE);
        bright.data_mut().fill(3.0);
        assert_eq!(psnr(&bright, &grey(255)).unwrap(), MAX_PSNR);
        bright.data_mut().fill(f32::NAN);
        assert_eq!(psnr(&bright, &grey(255)).unwrap(), 0.0);
    }

    #[test]
    fn the_masked_value_counts_masked_pixels_only() {
        let mut rendered = PlanarImage::from(&grey(0));
        rendered.set_pixel(5, [0.1; 3]);
        let mut bytes = vec![0; 12];
        bytes[5] = 1;
        bytes[6] = 1;
        let mask = Mask::new(SIZE, bytes).unwrap();
        let expected = -10.0 * 0.005f64.log10();
        assert!((mpsnr(&rendered, &grey(0), &mask).unwrap().unwrap() - expected).abs() < 1e-5);
        assert_eq!(mpsnr(&rendered, &grey(0), &Mask::filled(SIZE, false)), Ok(None));
    }

    #[test]
    fn another_size_is_an_error() {
        let other = PlanarImage::zeros(ImageSize { width: 3, height: 4 });
        assert!(psnr(&other, &grey(0)).is_err());
    }
}
