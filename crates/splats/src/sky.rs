use crate::error::InFile;
use crate::{Problem, SplatError};
use ffgs_core::write_atomically;
use image::{ImageFormat, RgbImage};
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

/// Names of the cube faces in the order of the texture.
pub const SKY_FACES: [&str; 6] = ["px", "nx", "py", "ny", "pz", "nz"];

/// Column and row of each face in the 4 x 3 cross: +y above +z, -y below, and -x, +z, +x, -z in the middle row.
const CROSS: [(u32, u32); 6] = [(2, 1), (0, 1), (1, 0), (1, 2), (1, 1), (3, 1)];

/// Writes the sky as six 8-bit PNGs `sky_px.png` .. `sky_nz.png` into `folder` and returns their paths.
///
/// `texels` holds 6 * face_size^2 * 3 values: face ([`SKY_FACES`]), row, column, RGB; clamped to [0, 1].
pub fn write_sky_faces(folder: &Path, face_size: usize, texels: &[f32]) -> Result<Vec<PathBuf>, SplatError> {
    let faces = faces(face_size, texels).in_file(folder)?;
    let write = |(face, name): (&RgbImage, &str)| {
        let path = folder.join(format!("sky_{name}.png"));
        write_png(&path, face).map(|()| path)
    };
    faces.iter().zip(SKY_FACES).map(write).collect()
}

/// Writes the sky as one 8-bit PNG, a cross of 4 x 3 faces; the corners are black. `texels` as in
/// [`write_sky_faces`].
pub fn write_sky_cross(path: &Path, face_size: usize, texels: &[f32]) -> Result<(), SplatError> {
    let faces = faces(face_size, texels).in_file(path)?;
    let edge = face_size as u32;
    let mut cross = RgbImage::new(4 * edge, 3 * edge);
    for (face, (column, row)) in faces.iter().zip(CROSS) {
        for (x, y, pixel) in face.enumerate_pixels() {
            cross.put_pixel(column * edge + x, row * edge + y, *pixel);
        }
    }
    write_png(path, &cross)
}

fn faces(face_size: usize, texels: &[f32]) -> Result<Vec<RgbImage>, Problem> {
    /// Larger faces cannot be meant (a cross of these has 3 GiB).
    const MAX_FACE_SIZE: usize = 1 << 13;
    if !(1..=MAX_FACE_SIZE).contains(&face_size) || texels.len() != 18 * face_size * face_size {
        let found = texels.len();
        return Err(Problem::Shape(format!("a sky of 6 x {face_size}^2 RGB texels, found {found} values")));
    }
    let quantise = |v: &f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let edge = face_size as u32;
    let face = |values: &[f32]| RgbImage::from_raw(edge, edge, values.iter().map(quantise).collect());
    Ok(texels.chunks_exact(3 * face_size * face_size).filter_map(face).collect())
}

fn write_png(path: &Path, picture: &RgbImage) -> Result<(), SplatError> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).in_file(path)?;
    write_atomically(path, |out| out.write_all(bytes.get_ref())).in_file(path)
}
