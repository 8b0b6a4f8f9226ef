//! Images and masks.

use crate::error::DatasetError;
use ffgs_core::{ImageRgb8, ImageSize, Mask, open_input};
use image::{DynamicImage, ImageReader, Limits};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Decoder memory per pixel: 16-bit RGBA, twice.
const BYTES_PER_PIXEL: u64 = 16;
/// Decoder memory besides: row buffers, a colour profile.
const BYTES_BESIDES: u64 = 16 << 20;

/// An 8-bit image of exactly `size`; alpha is ignored, grey is spread over the channels.
///
/// # Errors
/// When the file is missing, damaged or of another size.
pub fn read_image(file: &Path, size: ImageSize) -> Result<ImageRgb8, DatasetError> {
    let data = decode(file, size)?.into_rgb8().into_raw();
    Ok(ImageRgb8::new(size, data).expect("decode checked the size"))
}

/// A mask of exactly `size`: foreground where any channel is not zero, or, of a cut-out, where the alpha channel is
/// at least half.
///
/// # Errors
/// When the file is missing, damaged or of another size.
pub fn read_mask(file: &Path, size: ImageSize) -> Result<Mask, DatasetError> {
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
///
/// # Errors
/// When the file is missing, cut off or of another size.
pub fn probe_image(file: &Path, size: ImageSize) -> Result<(), DatasetError> {
    let mut opened = open_sized(file, size)?;
    let ends = ENDS.iter().any(|end| ends_with(&mut opened, end).unwrap_or(false));
    if ends { Ok(()) } else { decode(file, size).map(|_| ()) }
}

fn ends_with(opened: &mut BufReader<File>, end: &[u8]) -> std::io::Result<bool> {
    opened.seek(SeekFrom::End(-(end.len() as i64)))?;
    let mut last = Vec::new();
    opened.take(end.len() as u64).read_to_end(&mut last)?;
    Ok(last == end)
}

/// Opens an image whose header says that it has the size of its camera; nothing larger is unpacked.
fn open_sized(file: &Path, size: ImageSize) -> Result<BufReader<File>, DatasetError> {
    let mut opened = BufReader::new(open_input(file).map_err(|source| DatasetError::io(file, source))?);
    let (width, height) =
        reader(&mut opened, file, size)?.into_dimensions().map_err(|e| damaged(file, &e))?;
    let found = ImageSize { width: width as usize, height: height as usize };
    if found != size {
        return Err(DatasetError::ImageSize { file: file.to_owned(), expected: size, found });
    }
    opened.rewind().map_err(|source| DatasetError::io(file, source))?;
    Ok(opened)
}

fn damaged(file: &Path, error: &image::ImageError) -> DatasetError {
    DatasetError::Image { file: file.to_owned(), reason: error.to_string() }
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
    reader(&mut open_sized(file, size)?, file, size)?.decode().map_err(|e| damaged(file, &e))
}

fn reader<'a>(
    opened: &'a mut BufReader<File>,
    file: &Path,
    size: ImageSize,
) -> Result<ImageReader<&'a mut BufReader<File>>, DatasetError> {
    let guessed = ImageReader::new(opened).with_guessed_format();
    let mut reader = guessed.map_err(|source| DatasetError::io(file, source))?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(size.pixels() as u64 * BYTES_PER_PIXEL + BYTES_BESIDES);
    reader.limits(limits);
    Ok(reader)
}
