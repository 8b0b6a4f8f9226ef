//! Picture files of footage: read whatever their size, with errors that name the file.

use crate::PrepareError;
use ffgs_core::{ImageRgb8, ImageSize, Mask, open_input};
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageReader};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Reads a photograph of any size; grey is spread over the channels.
pub(crate) fn read_rgb(file: &Path) -> Result<ImageRgb8, PrepareError> {
    let image = decode(file)?.into_rgb8();
    let size = ImageSize { width: image.width() as usize, height: image.height() as usize };
    Ok(ImageRgb8::new(size, image.into_raw()).expect("an RGB image has three bytes per pixel"))
}

/// What the first picture of a camera tells of all.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    pub size: ImageSize,
    /// Whether it is transparent anywhere.
    pub transparent: bool,
    /// Whether its EXIF data say that it is to be turned or mirrored.
    pub turned: bool,
}

/// Looks at a photograph.
pub(crate) fn look_at(file: &Path) -> Result<Look, PrepareError> {
    let mut decoder = reader(file)?.into_decoder().map_err(|e| damaged(file, &e))?;
    // What the program does not need may be damaged.
    let turned = decoder.orientation().is_ok_and(|orientation| orientation != Orientation::NoTransforms);
    let image = DynamicImage::from_decoder(decoder).map_err(|e| damaged(file, &e))?;
    let size = ImageSize { width: image.width() as usize, height: image.height() as usize };
    let transparent = image.color().has_alpha() && image.into_rgba8().pixels().any(|p| p.0[3] < u8::MAX);
    Ok(Look { size, transparent, turned })
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

fn decode(file: &Path) -> Result<DynamicImage, PrepareError> {
    reader(file)?.decode().map_err(|e| damaged(file, &e))
}

fn reader(file: &Path) -> Result<ImageReader<BufReader<File>>, PrepareError> {
    let opened = open_input(file).map(BufReader::new);
    let reader = opened.and_then(|opened| ImageReader::new(opened).with_guessed_format());
    reader.map_err(|e| PrepareError::io(file, e))
}

fn damaged(file: &Path, error: &image::ImageError) -> PrepareError {
    PrepareError::picture(file, format!("not a readable image (damaged or truncated): {error}"))
}
