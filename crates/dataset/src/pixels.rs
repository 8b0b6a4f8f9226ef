use crate::DatasetError;
use crate::meta::io_error;
use ffgs_core::{ImageRgb8, ImageSize, Mask};
use image::{DynamicImage, ImageReader, Limits};
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;

/// Decoder memory; an 8K image of 16-bit RGBA takes a quarter of it.
const MAX_DECODED_BYTES: u64 = 1 << 30;

/// An 8-bit image of exactly `size`; alpha is ignored, grey is spread over the channels.
pub(crate) fn read_rgb(file: &Path, size: ImageSize) -> Result<ImageRgb8, DatasetError> {
    let data = decode(file, size)?.into_rgb8().into_raw();
    Ok(ImageRgb8::new(size, data).expect("decode checked the size"))
}

/// A mask of exactly `size`: foreground where any channel is not zero, or, of a cut-out, where the alpha channel is
/// at least half.
pub(crate) fn read_mask(file: &Path, size: ImageSize) -> Result<Mask, DatasetError> {
    let data = match decode(file, size)? {
        DynamicImage::ImageLuma8(grey) => grey.into_raw(),
        // Scaled to 8 bit, 1 would round to 0.
        DynamicImage::ImageLuma16(grey) => grey.into_raw().iter().map(|v| u8::from(*v != 0)).collect(),
        other if is_cut_out(&other) => other.into_rgba8().pixels().map(|p| u8::from(p.0[3] >= 128)).collect(),
        other => other.into_rgb8().pixels().map(|p| u8::from(p.0 != [0; 3])).collect(),
    };
    Ok(Mask::new(size, data).expect("decode checked the size"))
}

/// Last bytes of a whole PNG (the empty IEND chunk with its checksum) and of a whole JPEG (end of image).
const ENDS: [&[u8]; 2] = [b"\0\0\0\0IEND\xaeB`\x82", b"\xff\xd9"];

/// Checks that an image of `size` begins and ends as it should, without decoding it; where the end tells nothing, it is
/// decoded.
pub(crate) fn probe(file: &Path, size: ImageSize) -> Result<(), DatasetError> {
    let bytes = std::fs::read(file).map_err(|source| io_error(file, source))?;
    if !ENDS.iter().any(|end| bytes.ends_with(end)) {
        return decode(file, size).map(|_| ());
    }
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let reader = reader.map_err(|source| io_error(file, source))?;
    let damaged = |e: image::ImageError| DatasetError::Image { file: file.to_owned(), reason: e.to_string() };
    let (width, height) = reader.into_dimensions().map_err(damaged)?;
    require_size(file, size, width, height)
}

fn require_size(file: &Path, expected: ImageSize, width: u32, height: u32) -> Result<(), DatasetError> {
    let found = ImageSize { width: width as usize, height: height as usize };
    if found == expected {
        Ok(())
    } else {
        Err(DatasetError::ImageSize { file: file.to_owned(), expected, found })
    }
}

/// Whether an alpha channel tells pixels apart.
fn is_cut_out(image: &DynamicImage) -> bool {
    let alpha = |p: &image::Rgba<u8>| p.0[3] >= 128;
    image.color().has_alpha() && {
        let rgba = image.to_rgba8();
        let first = rgba.pixels().next().is_some_and(alpha);
        rgba.pixels().any(|p| alpha(p) != first)
    }
}

fn decode(file: &Path, size: ImageSize) -> Result<DynamicImage, DatasetError> {
    let opened = File::open(file).map_err(|source| io_error(file, source))?;
    let reader = ImageReader::new(BufReader::new(opened)).with_guessed_format();
    let mut reader = reader.map_err(|source| io_error(file, source))?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    reader.limits(limits);
    let damaged = |e: image::ImageError| DatasetError::Image { file: file.to_owned(), reason: e.to_string() };
    let image = reader.decode().map_err(damaged)?;
    require_size(file, size, image.width(), image.height())?;
    Ok(image)
}
