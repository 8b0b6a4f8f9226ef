//! `poses_bounds.npy` of LLFF, as N3DV (DyNeRF) uses it: per camera 3x5 `[R | t | (h, w, f)]` and two depths,
//! camera-to-world with the columns of R down, right, back.

use super::{Format, checked, file_called, rigid};
use crate::media::{natural_order, stem};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Pictures, Role, SourceCamera};
use ffgs_arrays::read_npy;
use ffgs_core::{ImageSize, Intrinsics, counted};
use glam::{DMat3, DMat4, DVec3};
use std::path::Path;

/// Reads N3DV's and LLFF's poses.
pub const FORMAT: Format = Format {
    name: "n3dv",
    looks_for: "poses_bounds.npy (N3DV, LLFF)",
    find: |folder| file_called(folder, "poses_bounds.npy"),
    read,
};

/// Most bytes of the poses: thousands of cameras have a hundredth of it.
const MAX_BYTES: usize = 1 << 24;

fn read(_: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let array = read_npy::<f64>(file, &[None, Some(17)], MAX_BYTES)?;
    let rows = array.rows::<17>().unwrap_or_default();
    let mut pictures = pictures(&Media::find(file.parent().unwrap_or(Path::new(".")))?);
    if pictures.len() != rows.len() {
        let reason = format!(
            "{}, but pictures of {} beside it: they belong together in the order of their names",
            counted(rows.len(), "pose"),
            counted(pictures.len(), "camera")
        );
        return Err(CalibrationError::content(file, reason));
    }
    pictures.sort_by(|a, b| natural_order(Path::new(&a.0), Path::new(&b.0)));
    let mut footage = Footage::default();
    for ((name, pictures), row) in pictures.into_iter().zip(rows) {
        footage.cameras.push(checked(camera(name, pictures, row), file)?);
    }
    footage.assumed.push("the n-th pose belongs to the n-th video by name".to_owned());
    Ok(footage)
}

/// A video per camera; else an image folder per camera; else an image per camera.
fn pictures(media: &Media) -> Vec<(String, Pictures)> {
    if !media.videos().is_empty() {
        return media.videos().iter().map(|v| (stem(v), Pictures::Video(v.clone()))).collect();
    }
    let folders: Vec<_> = media.folders().collect();
    match folders[..] {
        [(_, images)] => images.iter().map(|i| (stem(i), Pictures::Files(vec![i.clone()]))).collect(),
        _ => {
            folders.iter().map(|(folder, images)| (stem(folder), Pictures::Files(images.to_vec()))).collect()
        }
    }
}

fn camera(name: String, pictures: Pictures, row: &[f64; 17]) -> SourceCamera {
    let at = |r: usize, c: usize| row[r * 5 + c];
    let column = |c: usize| DVec3::new(at(0, c), at(1, c), at(2, c));
    let (height, width, focal) = (at(0, 4), at(1, 4), at(2, 4));
    let size = ImageSize { width: width as usize, height: height as usize };
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx: width / 2.0, cy: height / 2.0 };
    let role = if name == "cam00" { Role::Test } else { Role::Unsaid };
    let lens = Lens { intrinsics, distortion: Distortion::None, size };
    SourceCamera { name, lens, poses: vec![pose(&column)], pictures, masks: None, role }
}

/// Columns down, right, back, centre to world-to-camera with x right, y down, z forward.
fn pose(column: &dyn Fn(usize) -> DVec3) -> DMat4 {
    let world_from_camera = DMat3::from_cols(column(1), column(0), -column(2));
    let rotation = world_from_camera.transpose();
    rigid(rotation, -(rotation * column(3)))
}
