//! `cameras.bin`, `images.bin`, `points3D.bin`: little-endian records after a count.

use super::colmap_model::{CameraRecord, ImageRecord, Model};
use crate::{CalibrationError, ColouredPoint};
use ffgs_core::{ImageSize, read_bytes};
use glam::DVec3;
use std::path::Path;

/// A model of ten thousand images with ten thousand observations each takes half of it.
const MAX_MODEL_BYTES: u64 = 1 << 32;

/// Model ids of COLMAP and the number of their parameters.
const MODELS: [(&str, usize); 11] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
];

pub(super) fn read(cameras: &Path) -> Result<Model, CalibrationError> {
    let points = cameras.with_file_name("points3D.bin");
    Ok(Model {
        cameras: records(cameras, camera)?,
        images: records(&cameras.with_file_name("images.bin"), image)?,
        points: if points.is_file() { records(&points, point)? } else { Vec::new() },
    })
}

fn records<T>(file: &Path, read: impl Fn(&mut Bytes) -> Option<T>) -> Result<Vec<T>, CalibrationError> {
    let data = read_bytes(file, MAX_MODEL_BYTES).map_err(|e| CalibrationError::io(file, e))?;
    let mut bytes = Bytes(&data);
    let damaged = || CalibrationError::content(file, "not a binary model of COLMAP, or truncated");
    let count = bytes.u64().ok_or_else(damaged)?;
    (0..count).map(|_| read(&mut bytes).ok_or_else(damaged)).collect()
}

fn camera(bytes: &mut Bytes) -> Option<CameraRecord> {
    let (id, model) = (bytes.u32()?, bytes.u32()?);
    let size = ImageSize { width: bytes.u64()? as usize, height: bytes.u64()? as usize };
    let (name, parameters) = MODELS.get(model as usize)?;
    let parameters = (0..*parameters).map(|_| bytes.f64()).collect::<Option<_>>()?;
    Some(CameraRecord { id, model: (*name).to_owned(), size, parameters })
}

fn image(bytes: &mut Bytes) -> Option<ImageRecord> {
    bytes.u32()?;
    let rotation = [bytes.f64()?, bytes.f64()?, bytes.f64()?, bytes.f64()?];
    let translation = [bytes.f64()?, bytes.f64()?, bytes.f64()?];
    let camera = bytes.u32()?;
    let length = bytes.0.iter().position(|b| *b == 0)?;
    let name = String::from_utf8_lossy(bytes.take(length)?).into_owned();
    bytes.take(1)?;
    // x, y and the point's id of every observation.
    let observations = bytes.u64()?;
    bytes.take(usize::try_from(observations).ok()?.checked_mul(24)?)?;
    Some(ImageRecord { rotation, translation, camera, name })
}

fn point(bytes: &mut Bytes) -> Option<ColouredPoint> {
    bytes.u64()?;
    let position = DVec3::new(bytes.f64()?, bytes.f64()?, bytes.f64()?);
    let colour = bytes.take(3)?.try_into().ok()?;
    bytes.f64()?;
    let track = bytes.u64()?;
    bytes.take(usize::try_from(track).ok()?.checked_mul(8)?)?;
    Some(ColouredPoint { position, colour })
}

/// What has not been read yet.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, n: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(head)
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.take(4)?.try_into().ok()?))
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    fn f64(&mut self) -> Option<f64> {
        Some(f64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }
}
