//! Picture files of footage and captures: read and written, with errors that name the file.

use crate::PrepareError;
use ffgs_core::{ImageRgb8, ImageSize, Mask, open_input, write_atomically};
use image::{ExtendedColorType, ImageEncoder, ImageReader, codecs::png::PngEncoder};
use std::io::{self, BufReader};
use std::path::Path;

/// Reads a photograph of any size; grey is spread over the channels.
pub(crate) fn read_rgb(file: &Path) -> Result<ImageRgb8, PrepareError> {
    let image = decode(file)?.into_rgb8();
    let size = ImageSize { width: image.width() as usize, height: image.height() as usize };
    Ok(ImageRgb8::new(size, image.into_raw()).expect("an RGB image has three bytes per pixel"))
}

/// The size of a photograph, and whether it is transparent anywhere.
pub(crate) fn look_at(file: &Path) -> Result<(ImageSize, bool), PrepareError> {
    let image = decode(file)?;
    let size = ImageSize { width: image.width() as usize, height: image.height() as usize };
    let transparent = image.color().has_alpha() && image.into_rgba8().pixels().any(|p| p.0[3] < u8::MAX);
    Ok((size, transparent))
}

/// Reads a mask of any size: foreground where the grey value (or, with an alpha channel, the alpha) is not zero.
pub(crate) fn read_mask(file: &Path) -> Result<Mask, PrepareError> {
    let image = decode(file)?;
    let size = ImageSize { width: image.width() as usize, height: image.height() as usize };
    let data = if image.color().has_alpha() {
        image.into_rgba8().pixels().map(|p| u8::from(p.0[3] >= 128)).collect()
    } else {
        image.into_rgb8().pixels().map(|p| u8::from(p.0 != [0; 3])).collect()
    };
    Ok(Mask::new(size, data).expect("one value per pixel"))
}

fn decode(file: &Path) -> Result<image::DynamicImage, PrepareError> {
    let opened = open_input(file).map(BufReader::new);
    let reader = opened.and_then(|opened| ImageReader::new(opened).with_guessed_format());
    let image = reader.map_err(|e| PrepareError::io(file, e))?.decode();
    image
        .map_err(|e| PrepareError::picture(file, format!("not a readable image (damaged or truncated): {e}")))
}

/// Writes an 8-bit RGB PNG, whole or not at all.
pub(crate) fn write_rgb(file: &Path, image: &ImageRgb8) -> Result<(), PrepareError> {
    write_png(file, image.data(), image.size(), ExtendedColorType::Rgb8)
}

/// Writes a mask as 0 and 255, whole or not at all.
pub(crate) fn write_mask(file: &Path, mask: &Mask) -> Result<(), PrepareError> {
    let bytes: Vec<u8> = mask.data().iter().map(|v| v * 255).collect();
    write_png(file, &bytes, mask.size(), ExtendedColorType::L8)
}

fn write_png(
    file: &Path,
    bytes: &[u8],
    size: ImageSize,
    colour: ExtendedColorType,
) -> Result<(), PrepareError> {
    let write = |w: &mut io::BufWriter<std::fs::File>| {
        let encoder = PngEncoder::new(w);
        encoder.write_image(bytes, size.width as u32, size.height as u32, colour).map_err(io::Error::other)
    };
    write_atomically(file, write).map_err(|e: io::Error| PrepareError::io(file, e))
}
