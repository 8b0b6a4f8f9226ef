//! `train_meta.json` of Dynamic3DGaussians: already a capture, undistorted, with world-to-camera poses.

use super::{Format, checked, file_called, intrinsics, pose, read_text, square};
use crate::{CalibrationError, ColouredPoint, Distortion, Footage, Lens, Pictures, Role, SourceCamera};
use ffgs_arrays::{ArraysError, NpzFile};
use ffgs_core::ImageSize;
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

#[derive(Deserialize)]
struct MetaFile {
    w: usize,
    h: usize,
    k: Vec<Vec<Vec<Vec<f64>>>>,
    w2c: Vec<Vec<Vec<Vec<f64>>>>,
    #[serde(rename = "fn")]
    file_names: Vec<Vec<String>>,
}

fn read(_: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let home = file.parent().unwrap_or(Path::new("."));
    let mut footage = Footage { metres_per_unit: Some(1.0), ..Footage::default() };
    footage.cameras = split(file, home, Role::Train)?;
    let test = file.with_file_name("test_meta.json");
    if test.is_file() {
        footage.cameras.extend(split(&test, home, Role::Test)?);
    }
    if file.with_file_name("init_meta.json").is_file() {
        footage
            .skipped
            .push("the views of init_meta.json, which are of frame 0 only, are left out".to_owned());
    }
    let points = file.with_file_name("init_pt_cld.npz");
    if points.is_file() {
        footage.points = initial_points(&points)?;
        footage.points_are_complete = true;
    }
    Ok(footage)
}

/// Rows of position (m), colour (0 to 1) and foreground, which the masks say as well.
fn initial_points(file: &Path) -> Result<Vec<ColouredPoint>, CalibrationError> {
    let fail = |error: ArraysError| CalibrationError::content(file, error.to_string());
    let data = NpzFile::open_within(file, MOST_BYTES).map_err(fail)?;
    let data = data.shaped::<f64>("data", &[None, Some(7)]).map_err(fail)?;
    let rows = data.rows::<7>().unwrap_or_default();
    let point = |row: &[f64; 7]| {
        let [x, y, z, rgb @ .., _] = *row;
        ColouredPoint { position: DVec3::new(x, y, z), colour: rgb.map(|v| (v * 255.0).round() as u8) }
    };
    Ok(rows.iter().filter(|row| row.iter().all(|v| v.is_finite())).map(point).collect())
}

fn split(file: &Path, home: &Path, role: Role) -> Result<Vec<SourceCamera>, CalibrationError> {
    let fail = |reason: String| CalibrationError::content(file, reason);
    let meta: MetaFile = serde_json::from_str(&read_text(file)?).map_err(|e| fail(e.to_string()))?;
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
    (0..cameras).map(|c| checked(camera(&meta, home, c, role).map_err(fail)?, file)).collect()
}

/// Cameras are matched by folder, because their order may differ between frames.
fn camera(meta: &MetaFile, home: &Path, c: usize, role: Role) -> Result<SourceCamera, String> {
    let folder = |name: &str| name.rsplit_once('/').map_or(String::new(), |(folder, _)| folder.to_owned());
    let name = folder(&meta.file_names[0][c]);
    let (mut poses, mut files) = (Vec::new(), Vec::new());
    for (t, names) in meta.file_names.iter().enumerate() {
        let here = names.iter().position(|n| folder(n) == name);
        let here = here.ok_or_else(|| format!("camera '{name}' is missing in frame {t}"))?;
        poses.push(matrix(&meta.w2c[t][here])?);
        files.push(home.join("ims").join(&names[here]));
    }
    let k = square(&meta.k[0][c]).ok_or("k is not 3x3")?;
    let lens = Lens {
        intrinsics: intrinsics(k)?,
        distortion: Distortion::None,
        size: ImageSize { width: meta.w, height: meta.h },
    };
    let mask = |f: &PathBuf| {
        home.join("seg").join(f.strip_prefix(home.join("ims")).unwrap_or(f)).with_extension("png")
    };
    let masks: Vec<PathBuf> = files.iter().map(mask).collect();
    let masks = masks.iter().all(|m| m.is_file()).then_some(Pictures::Files(masks));
    let poses = if poses.iter().all(|p| *p == poses[0]) { vec![poses[0]] } else { poses };
    Ok(SourceCamera { name, lens, poses, pictures: Pictures::Files(files), masks, role })
}

fn matrix(rows: &[Vec<f64>]) -> Result<DMat4, String> {
    let three = rows.get(..3).filter(|r| r.iter().all(|row| row.len() == 4)).ok_or("w2c is not 4x4")?;
    let rotation: Vec<Vec<f64>> = three.iter().map(|row| row[..3].to_vec()).collect();
    let rotation = square(&rotation).ok_or("w2c is not 4x4")?;
    Ok(pose(rotation, [three[0][3], three[1][3], three[2][3]]))
}

/// Python's json writes NaN and Infinity bare, which JSON does not have.
pub(super) fn nan_to_null(text: &str) -> String {
    text.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null")
}
