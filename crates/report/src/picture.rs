//! Pictures on their way into the page.

use crate::ReportError;
use crate::colour::inferno;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::{Rgb, RgbImage};
use std::path::Path;

/// Quality of embedded JPEGs: artefacts are invisible at the size shown, a tenth of the PNG's bytes.
const QUALITY: u8 = 85;
/// Wider pictures are scaled down: a third of a laptop's width, twice over for sharp screens.
const MAX_WIDTH: u32 = 960;
/// Absolute difference shown as the brightest colour (of 255).
pub const ERROR_RANGE: f64 = 64.0;

/// Reads an image file as 8-bit RGB.
pub fn read(path: &Path) -> Result<RgbImage, ReportError> {
    let error = |source| ReportError::Picture { path: path.to_owned(), source };
    let reader = image::ImageReader::open(path).and_then(image::ImageReader::with_guessed_format);
    let decoded = reader.map_err(image::ImageError::IoError).and_then(image::ImageReader::decode);
    Ok(decoded.map_err(error)?.into_rgb8())
}

/// Colour-mapped mean absolute difference over the channels: black = equal, bright = a quarter of the range or more.
/// `None` when the sizes differ.
pub fn error_map(a: &RgbImage, b: &RgbImage) -> Option<RgbImage> {
    let mut out = RgbImage::new(a.width(), a.height());
    for ((out, a), b) in out.pixels_mut().zip(a.pixels()).zip(b.pixels()) {
        let sum: u32 = (0..3).map(|c| u32::from(a[c].abs_diff(b[c]))).sum();
        *out = Rgb(inferno(f64::from(sum) / (3.0 * ERROR_RANGE)));
    }
    (a.dimensions() == b.dimensions()).then_some(out)
}

/// The picture as a `data:` URI (JPEG), scaled down to what the page shows.
pub fn data_uri(picture: &RgbImage) -> Result<String, ReportError> {
    let scaled = (picture.width() > MAX_WIDTH).then(|| {
        let height = u64::from(picture.height()) * u64::from(MAX_WIDTH) / u64::from(picture.width());
        image::imageops::resize(picture, MAX_WIDTH, (height as u32).max(1), FilterType::Triangle)
    });
    let mut bytes = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut bytes, QUALITY);
    scaled.as_ref().unwrap_or(picture).write_with_encoder(encoder).map_err(ReportError::Encode)?;
    Ok(format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_pictures_have_a_black_error() {
        let a = RgbImage::from_pixel(3, 2, Rgb([9, 80, 200]));
        assert!(error_map(&a, &a).unwrap().pixels().all(|p| p.0 == [0, 0, 4]));
        assert!(error_map(&a, &RgbImage::new(2, 3)).is_none());
    }
}
