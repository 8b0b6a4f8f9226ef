//! Picture files of footage: read whatever their size, with errors that name the file.

use crate::PrepareError;
use ffgs_core::{ImageRgb8, ImageSize, Mask, open_input};
use image::ImageReader;
use std::io::BufReader;
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
