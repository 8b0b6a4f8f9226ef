//! `train_meta.json` of Dynamic3DGaussians: already a capture, undistorted, with world-to-camera poses.

use super::left_out::{complete_masks, file_or_name, usable_points};
use super::{Format, checked, file_called, intrinsics, pose, read_text, square};
use crate::footage::one_if_fixed;
use crate::{CalibrationError, ColouredPoint, Distortion, Footage, Lens, Pictures, Role, SourceCamera};
use ffgs_arrays::{ArraysError, NpzFile};
use ffgs_core::{ImageSize, nan_to_null};
use glam::{DMat4, DVec3};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Reads captures, of which only masks, points or tracks may be missing.
pub(crate) const FORMAT: Format = Format {
    name: "dynamic3dgs",
    looks_for: "train_meta.json (Dynamic3DGaussians)",
    find: |folder| file_called(folder, "train_meta.json"),
    read,
};

/// More than the points of any scene take.
const MOST_BYTES: usize = 1 << 30;

/// A number; null, which [`nan_to_null`] makes of NaN, is NaN again.
#[derive(Clone, Copy, Deserialize)]
#[serde(from = "Option<f64>")]
struct Number(f64);

impl From<Option<f64>> for Number {
    fn from(number: Option<f64>) -> Self {
        Self(number.unwrap_or(f64::NAN))
    }
}

/// `[frame][camera]` row by row.
type Matrices = Vec<Vec<Vec<Vec<Number>>>>;

/// A side of the images: one for all cameras, or one for each camera of frame 0.
#[derive(Deserialize)]
#[serde(untagged)]
enum Side {
    All(usize),
    Each(Vec<usize>),
}

impl Side {
    fn of(&self, camera: usize) -> Option<usize> {
        match self {
            Self::All(side) => Some(*side),
            Self::Each(sides) => sides.get(camera).copied(),
        }
    }
}

#[derive(Deserialize)]
struct MetaFile {
    w: Side,
    h: Side,
    k: Matrices,
    w2c: Matrices,
    #[serde(rename = "fn")]
    file_names: Vec<Vec<String>>,
}

fn read(_: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let home = file.parent().unwrap_or(Path::new("."));
    let mut footage = Footage { metres_per_unit: Some(1.0), ..Footage::default() };
    footage.cameras = split(file, home, Role::Train, &mut footage.skipped)?;
    let test = file.with_file_name("test_meta.json");
    if test.is_file() {
        footage.cameras.extend(split(&test, home, Role::Test, &mut footage.skipped)?);
    }
    if file.with_file_name("init_meta.json").is_file() {
        footage
            .skipped
            .push("the views of init_meta.json, which are of frame 0 only, are left out".to_owned());
    }
    let points = file.with_file_name("init_pt_cld.npz");
    if points.is_file() {
        footage.points = usable_points(initial_points(&points)?, &points, &mut footage.skipped);
        footage.points_are_complete = true;
    }
    Ok(footage)
}

/// Rows of position (m), colour (0 to 1) and foreground, which the masks say as well. One with a number that is none has its point nowhere.
fn initial_points(file: &Path) -> Result<Vec<ColouredPoint>, CalibrationError> {
    let fail = |error: ArraysError| CalibrationError::content(file, error.to_string());
    let data = NpzFile::open_within(file, MOST_BYTES).map_err(fail)?;
    let data = data.shaped::<f64>("data", &[None, Some(7)]).map_err(fail)?;
    let rows = data.rows::<7>().unwrap_or_default();
    let point = |row: &[f64; 7]| {
        let [x, y, z, rgb @ .., _] = *row;
        let sound = row.iter().all(|v| v.is_finite());
        let position = if sound { DVec3::new(x, y, z) } else { DVec3::NAN };
        ColouredPoint { position, colour: rgb.map(|v| (v * 255.0).round() as u8) }
    };
    Ok(rows.iter().map(point).collect())
}

fn split(
    file: &Path,
    home: &Path,
    role: Role,
    skipped: &mut Vec<String>,
) -> Result<Vec<SourceCamera>, CalibrationError> {
    let fail = |reason: String| CalibrationError::content(file, reason);
    let text = read_text(file)?;
    let meta: MetaFile = serde_json::from_str(&nan_to_null(&text)).map_err(|e| fail(e.to_string()))?;
    let frames = meta.k.len();
    let cameras = meta.file_names.first().map_or(0, Vec::len);
    let even = [meta.k.iter().map(Vec::len), meta.w2c.iter().map(Vec::len)]
        .into_iter()
        .flatten()
        .all(|n| n == cameras);
    if frames == 0 || meta.w2c.len() != frames || meta.file_names.len() != frames || !even {
        return Err(fail("k, w2c and fn differ in frames or cameras".to_owned()));
    }
    if meta.file_names.iter().any(|names| names.len() != cameras) {
        return Err(fail("fn has another number of cameras in some frames".to_owned()));
    }
    let mut read = Vec::new();
    for c in 0..cameras {
        let name = folder(&meta.file_names[0][c]);
        let fail = |reason: String| fail(format!("camera '{name}': {reason}"));
        let mut camera = camera(&meta, home, c, role).map_err(fail)?;
        camera.masks = masks(&camera, home, skipped);
        read.push(checked(camera, file)?);
    }
    Ok(read)
}

/// Where a picture lies below `ims`, which is its camera's name.
fn folder(name: &str) -> &str {
    name.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// Cameras are matched by folder, because their order may differ between frames.
fn camera(meta: &MetaFile, home: &Path, c: usize, role: Role) -> Result<SourceCamera, String> {
    let name = folder(&meta.file_names[0][c]);
    let lens = lens(meta, 0, c, c)?;
    let (mut poses, mut files) = (Vec::new(), Vec::new());
    for (t, names) in meta.file_names.iter().enumerate() {
        let here = names.iter().position(|n| folder(n) == name);
        let here = here.ok_or_else(|| format!("it is missing in frame {t}"))?;
        lens.refuse_other(&self::lens(meta, t, here, c)?, &format!("its picture of frame {t}"))?;
        poses.push(matrix(&numbers(&meta.w2c[t][here]))?);
        files.push(home.join("ims").join(&names[here]));
    }
    let poses = one_if_fixed(poses);
    Ok(SourceCamera {
        name: name.to_owned(),
        lens,
        poses,
        pictures: Pictures::Files(files),
        masks: None,
        role,
    })
}

/// The lens of the `here`th camera of a frame, which is the `c`th of frame 0.
fn lens(meta: &MetaFile, frame: usize, here: usize, c: usize) -> Result<Lens, String> {
    let k = square(&numbers(&meta.k[frame][here])).ok_or("k is not 3x3")?;
    let sides = meta.w.of(c).zip(meta.h.of(c));
    let (width, height) = sides.ok_or("w or h has no entry for it")?;
    Ok(Lens { intrinsics: intrinsics(k)?, distortion: Distortion::None, size: ImageSize { width, height } })
}

/// The files below `seg` that are called as the camera's pictures.
fn masks(camera: &SourceCamera, home: &Path, skipped: &mut Vec<String>) -> Option<Pictures> {
    let Pictures::Files(files) = &camera.pictures else { return None };
    let ims = home.join("ims");
    let mask =
        |file: &PathBuf| home.join("seg").join(file.strip_prefix(&ims).unwrap_or(file)).with_extension("png");
    let masks = files.iter().map(|file| file_or_name(mask(file))).collect();
    complete_masks(&camera.name, masks, skipped)
}

fn numbers(rows: &[Vec<Number>]) -> Vec<Vec<f64>> {
    rows.iter().map(|row| row.iter().map(|number| number.0).collect()).collect()
}

fn matrix(rows: &[Vec<f64>]) -> Result<DMat4, String> {
    let three = rows.get(..3).filter(|r| r.iter().all(|row| row.len() == 4)).ok_or("w2c is not 4x4")?;
    let rotation: Vec<Vec<f64>> = three.iter().map(|row| row[..3].to_vec()).collect();
    let rotation = square(&rotation).ok_or("w2c is not 4x4")?;
    Ok(pose(rotation, [three[0][3], three[1][3], three[2][3]]))
}
