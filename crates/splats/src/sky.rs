//! The sky as a picture: a cross of the cube's faces, and an equirectangular panorama for players.

use crate::error::InFile;
use crate::{Problem, SplatError};
use ffgs_core::write_atomically;
use glam::Vec3;
use image::codecs::jpeg::JpegEncoder;
use image::{ImageFormat, Rgb, RgbImage};
use std::f32::consts::PI;
use std::io::{Cursor, Write};
use std::path::Path;

/// Of 100: artefacts are not visible in a smooth sky.
const JPEG_QUALITY: u8 = 85;

/// Column and row of each face in the 4 x 3 cross: +y above +z, -y below, and -x, +z, +x, -z in the middle row.
const CROSS: [(u32, u32); 6] = [(2, 1), (0, 1), (1, 0), (1, 2), (1, 1), (3, 1)];

/// Writes the sky as one 8-bit PNG, a cross of 4 x 3 faces; the corners are black.
///
/// `texels` holds 6 * face_size^2 * 3 values: face (+x, -x, +y, -y, +z, -z), row, column, RGB; clamped to [0, 1].
///
/// # Errors
/// When the texels do not fit the face size, or the file cannot be written.
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

/// Writes the sky as an equirectangular 8-bit JPEG, as [`encode_sky_equirectangular`] makes it.
///
/// # Errors
/// When the texels do not fit the face size, or the file cannot be written.
pub fn write_sky_equirectangular(
    path: &Path,
    face_size: usize,
    texels: &[f32],
    up: Vec3,
    forward: Vec3,
) -> Result<(), SplatError> {
    let bytes = encode_sky_equirectangular(face_size, texels, up, forward).in_file(path)?;
    write_atomically(path, |out| out.write_all(&bytes)).in_file(path)
}

/// The sky as an equirectangular 8-bit JPEG, twice as wide as high. The top row looks along `up`, the middle column along
/// `forward` (unit vectors of the world, at right angles), columns run to the right of it. `texels` as in
/// [`write_sky_cross`].
///
/// # Errors
/// When the texels do not fit the face size.
pub fn encode_sky_equirectangular(
    face_size: usize,
    texels: &[f32],
    up: Vec3,
    forward: Vec3,
) -> Result<Vec<u8>, Problem> {
    let faces = faces(face_size, texels)?;
    // As many texels along a quarter turn as a face has: more would be interpolated ones.
    let height = 2 * face_size as u32;
    let right = forward.cross(up);
    let mut picture = RgbImage::new(2 * height, height);
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        let (sin_y, cos_y) = ((y as f32 + 0.5) / height as f32 * PI).sin_cos();
        let (sin_x, cos_x) = ((x as f32 + 0.5) / height as f32 * PI - PI).sin_cos();
        let (face, at) = face_place(sin_y * (cos_x * forward + sin_x * right) + cos_y * up, face_size);
        *pixel = bilinear(&faces[face], at);
    }
    let mut bytes = Cursor::new(Vec::new());
    picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY))?;
    Ok(bytes.into_inner())
}

/// An equirectangular sky to look things up in.
#[derive(Clone, Debug)]
pub struct Panorama {
    picture: RgbImage,
    up: Vec3,
    forward: Vec3,
}

impl Panorama {
    /// Decodes what [`encode_sky_equirectangular`] made.
    ///
    /// # Errors
    /// When the bytes are no JPEG.
    pub fn decode(jpeg: &[u8], up: Vec3, forward: Vec3) -> Result<Self, Problem> {
        let picture = image::load_from_memory_with_format(jpeg, ImageFormat::Jpeg)?.to_rgb8();
        Ok(Self { picture, up, forward })
    }

    /// RGB (0..=1) in a direction, bilinear.
    pub fn colour(&self, direction: Vec3) -> [f32; 3] {
        let right = self.forward.cross(self.up);
        let (width, height) = (self.picture.width(), self.picture.height());
        let polar = direction.normalize_or_zero().dot(self.up).clamp(-1.0, 1.0).acos() / PI;
        let round = direction.dot(right).atan2(direction.dot(self.forward)) / (2.0 * PI) + 0.5;
        let (x, y) = (round * width as f32 - 0.5, polar * height as f32 - 0.5);
        let texel = |dx: f32, dy: f32| {
            let column = (x.floor() + dx).rem_euclid(width as f32) as u32;
            let row = (y.floor() + dy).clamp(0.0, height as f32 - 1.0) as u32;
            Vec3::from(self.picture.get_pixel(column.min(width - 1), row).0.map(f32::from)) / 255.0
        };
        let (u, v) = (x - x.floor(), y - y.floor());
        let top = texel(0.0, 0.0).lerp(texel(1.0, 0.0), u);
        top.lerp(texel(0.0, 1.0).lerp(texel(1.0, 1.0), u), v).to_array()
    }
}

/// Face that a direction meets (OpenGL 4.6 specification, table 8.19), and where: 0 to `face_size` along each side.
fn face_place(d: Vec3, face_size: usize) -> (usize, [f32; 2]) {
    let size = d.abs();
    let (face, s, t, major) = if size.x >= size.y && size.x >= size.z {
        (0, -d.z * d.x.signum(), -d.y, d.x)
    } else if size.y >= size.z {
        (2, d.x, d.z * d.y.signum(), d.y)
    } else {
        (4, d.x * d.z.signum(), -d.y, d.z)
    };
    let place = |c: f32| (0.5 + 0.5 * c / major.abs()) * face_size as f32;
    (face + usize::from(major < 0.0), [s, t].map(place))
}

/// The colour at a place of a face, constant over the outer half texel: what a render of the sky shows there.
fn bilinear(face: &RgbImage, at: [f32; 2]) -> Rgb<u8> {
    let last = face.width() as f32 - 1.0;
    let [x, y] = at.map(|c| (c - 0.5).clamp(0.0, last));
    let texel = |x: f32, y: f32| Vec3::from(face.get_pixel(x as u32, y as u32).0.map(f32::from));
    let (right, below) = ((x + 1.0).min(last), (y + 1.0).min(last));
    let (u, v) = (x.fract(), y.fract());
    let row = |y: f32| texel(x, y).lerp(texel(right, y), u);
    Rgb(row(y).lerp(row(below), v).to_array().map(|c| c.round() as u8))
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
