//! Images and masks as files.

use crate::error::DatasetError;
use ffgs_core::{ImageRgb8, ImageSize, Mask, open_input, read_bytes, write_atomically};
use image::codecs::png::PngEncoder;
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageReader, Limits};
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// Decoder memory per pixel: 16-bit RGBA, twice.
const BYTES_PER_PIXEL: u64 = 16;
/// Decoder memory besides: row buffers, a colour profile.
const BYTES_BESIDES: u64 = 16 << 20;

/// Largest file of an image, and largest memory of its decoder (bytes).
fn most_bytes(size: ImageSize) -> u64 {
    size.pixels() as u64 * BYTES_PER_PIXEL + BYTES_BESIDES
}

/// An 8-bit image of exactly `size`; alpha is ignored, grey is spread over the channels.
///
/// # Errors
/// When the file is missing, damaged or of another size.
pub fn read_image(file: &Path, size: ImageSize) -> Result<ImageRgb8, DatasetError> {
    read_image_with_file(file, size).map(|(image, _)| image)
}

/// As [`read_image`], with the bytes of the file, which is opened once.
///
/// # Errors
/// As [`read_image`].
pub fn read_image_with_file(file: &Path, size: ImageSize) -> Result<(ImageRgb8, Vec<u8>), DatasetError> {
    let bytes = read_bytes(file, most_bytes(size)).map_err(|source| DatasetError::io(file, source))?;
    let data = decode(&mut Cursor::new(&bytes), file, size)?.into_rgb8().into_raw();
    Ok((ImageRgb8::new(size, data).expect("decode checked the size"), bytes))
}

/// A mask of exactly `size`: foreground where any channel is not zero, or, of a cut-out, where the alpha channel is
/// at least half.
///
/// # Errors
/// When the file is missing, damaged or of another size.
pub fn read_mask(file: &Path, size: ImageSize) -> Result<Mask, DatasetError> {
    let data = match decode(&mut open(file)?, file, size)? {
        DynamicImage::ImageLuma8(grey) => grey.into_raw(),
        // Scaled to 8 bit, 1 would round to 0.
        DynamicImage::ImageLuma16(grey) => grey.into_raw().iter().map(|v| u8::from(*v != 0)).collect(),
        other if is_cut_out(&other) => other.into_rgba8().pixels().map(|p| u8::from(p.0[3] >= 128)).collect(),
        other => other.into_rgb8().pixels().map(|p| u8::from(p.0 != [0; 3])).collect(),
    };
    Ok(Mask::new(size, data).expect("decode checked the size"))
}

/// Writes an 8-bit RGB PNG, whole or not at all.
///
/// # Errors
/// When the file cannot be written.
pub fn write_image(file: &Path, image: &ImageRgb8) -> Result<(), DatasetError> {
    write_png(file, image.data(), image.size(), ExtendedColorType::Rgb8)
}

/// Writes a mask as a grey PNG of 0 and 255, whole or not at all.
///
/// # Errors
/// When the file cannot be written.
pub fn write_mask(file: &Path, mask: &Mask) -> Result<(), DatasetError> {
    let bytes: Vec<u8> = mask.data().iter().map(|v| v * 255).collect();
    write_png(file, &bytes, mask.size(), ExtendedColorType::L8)
}

fn write_png(
    file: &Path,
    bytes: &[u8],
    size: ImageSize,
    colour: ExtendedColorType,
) -> Result<(), DatasetError> {
    let write = |out: &mut BufWriter<File>| {
        let encoder = PngEncoder::new(out);
        encoder.write_image(bytes, size.width as u32, size.height as u32, colour).map_err(io::Error::other)
    };
    write_atomically(file, write).map_err(|source| DatasetError::Write { file: file.to_owned(), source })
}

/// Last bytes of a whole PNG (the empty IEND chunk with its checksum) and of a whole JPEG (end of image).
const ENDS: [&[u8]; 2] = [b"\0\0\0\0IEND\xaeB`\x82", b"\xff\xd9"];

/// Checks that an image of `size` begins and ends as it should, without decoding it; where the end tells nothing, it is
/// decoded.
///
/// # Errors
/// When the file is missing, cut off or of another size.
pub fn probe_image(file: &Path, size: ImageSize) -> Result<(), DatasetError> {
    let mut opened = open(file)?;
    check_size(&mut opened, file, size)?;
    let ends = ENDS.iter().any(|end| ends_with(&mut opened, end).unwrap_or(false));
    if ends { Ok(()) } else { decode(&mut opened, file, size).map(|_| ()) }
}

fn open(file: &Path) -> Result<BufReader<File>, DatasetError> {
    open_input(file).map(BufReader::new).map_err(|source| DatasetError::io(file, source))
}

fn ends_with(opened: &mut BufReader<File>, end: &[u8]) -> io::Result<bool> {
    opened.seek(SeekFrom::End(-(end.len() as i64)))?;
    let mut last = Vec::new();
    opened.take(end.len() as u64).read_to_end(&mut last)?;
    Ok(last == end)
}

/// Whether the header says that the image has the size of its camera; nothing larger is unpacked.
fn check_size(opened: &mut (impl BufRead + Seek), file: &Path, size: ImageSize) -> Result<(), DatasetError> {
    let (width, height) = reader(opened, file, size)?.into_dimensions().map_err(|e| damaged(file, &e))?;
    let found = ImageSize { width: width as usize, height: height as usize };
    if found != size {
        return Err(DatasetError::ImageSize { file: file.to_owned(), expected: size, found });
    }
    Ok(())
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

/// Decodes an image of `size`.
fn decode(
    opened: &mut (impl BufRead + Seek),
    file: &Path,
    size: ImageSize,
) -> Result<DynamicImage, DatasetError> {
    check_size(opened, file, size)?;
    reader(opened, file, size)?.decode().map_err(|e| damaged(file, &e))
}

/// Reads from the beginning.
fn reader<'a, R: BufRead + Seek>(
    opened: &'a mut R,
    file: &Path,
    size: ImageSize,
) -> Result<ImageReader<&'a mut R>, DatasetError> {
    let guessed = opened.rewind().and_then(|()| ImageReader::new(opened).with_guessed_format());
    let mut reader = guessed.map_err(|source| DatasetError::io(file, source))?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(most_bytes(size));
    reader.limits(limits);
    Ok(reader)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize { width: 5, height: 3 };

    #[test]
    fn what_is_written_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let image = ImageRgb8::new(SIZE, (0..45).map(|i| i * 5).collect()).unwrap();
        let mask = Mask::new(SIZE, (0..15).map(|i| u8::from(i % 4 == 1)).collect()).unwrap();
        let [picture, silhouette] = ["ims/a/0.png", "seg/a/0.png"].map(|name| folder.path().join(name));
        write_image(&picture, &image).unwrap();
        write_mask(&silhouette, &mask).unwrap();
        assert_eq!(read_image(&picture, SIZE).unwrap(), image);
        assert_eq!(read_mask(&silhouette, SIZE).unwrap(), mask);
        let error = write_image(&picture.join("inside.png"), &image).unwrap_err();
        assert!(error.to_string().starts_with(&format!("cannot write {}", picture.display())), "{error}");
    }
}
