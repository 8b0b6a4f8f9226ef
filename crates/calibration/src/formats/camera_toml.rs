//! TOML of caliscope (`camera_array.toml`, `config.toml`), aniposelib (`calibration.toml`) and Pose2Sim (`Calib_*.toml`): a table per camera
//! with `matrix`, `distortions`, `size`, `rotation` (3x3 or a Rodrigues vector) and `translation`, world to camera.

use super::{
    Format, checked, find_below, intrinsics, read_text, rigid, rodrigues, square, timestamps_near,
    told_of_others,
};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Pictures, Role, SourceCamera};
use ffgs_core::ImageSize;
use glam::{DMat3, DVec3};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Reads caliscope's and aniposelib's camera lists.
pub const FORMAT: Format = Format {
    name: "toml",
    looks_for: "a .toml with camera matrices (caliscope, aniposelib, Pose2Sim)",
    find,
    read,
};

/// Keys that every camera's table needs.
const NEEDED: [&str; 2] = ["matrix", "translation"];
/// Keys of a camera's table: one that has two of them is meant for a camera.
const TELLING: [&str; 5] = ["matrix", "distortions", "rotation", "translation", "size"];

fn find(folder: &Path) -> Option<PathBuf> {
    find_toml(folder, |table| !cameras(table).is_empty())
}

fn find_toml(folder: &Path, fits: impl Fn(&Table) -> bool) -> Option<PathBuf> {
    find_below(folder, &|path| is_toml(path, &fits))
}

fn is_toml(path: &Path, fits: &impl Fn(&Table) -> bool) -> bool {
    path.extension().is_some_and(|e| e == "toml") && fits(&parsed(path).unwrap_or_default())
}

fn parsed(file: &Path) -> Result<Table, CalibrationError> {
    let parsed = read_text(file)?.parse();
    parsed.map_err(|e: toml::de::Error| CalibrationError::content(file, e.to_string()))
}

/// A TOML whose tables are meant for cameras but lack what makes them cameras, as the error that says what they lack.
pub(super) fn almost_found(folder: &Path) -> Option<CalibrationError> {
    let file = find_toml(folder, |table| !incomplete(table).is_empty())?;
    let lacking = incomplete(&parsed(&file).ok()?);
    Some(CalibrationError::content(&file, lacking.join("; ")))
}

/// What tables lack that are meant for cameras, one sentence each.
fn incomplete(table: &Table) -> Vec<String> {
    let mut found = Vec::new();
    visit(table, "", &mut |name, inner| {
        let lacks: Vec<String> =
            NEEDED.iter().filter(|key| !inner.contains_key(**key)).map(|key| format!("'{key}'")).collect();
        let meant = TELLING.iter().filter(|key| inner.contains_key(**key)).count() > 1;
        if meant && !lacks.is_empty() {
            let has: Vec<&str> = inner.keys().map(String::as_str).collect();
            found.push(format!(
                "the table [{name}] has no {}, only {}",
                lacks.join(" and no "),
                has.join(", ")
            ));
        }
    });
    found
}

/// All tables in a table, with their names as in the file.
fn visit(table: &Table, within: &str, each: &mut dyn FnMut(&str, &Table)) {
    for (name, value) in table {
        if let Value::Table(inner) = value {
            let name = if within.is_empty() { name.clone() } else { format!("{within}.{name}") };
            each(&name, inner);
            visit(inner, &name, each);
        }
    }
}

/// The tables that hold a camera, with the name of their section; caliscope nests them in `[cameras]`.
fn cameras(table: &Table) -> Vec<(&String, &Table)> {
    let mut found = Vec::new();
    for (name, value) in table {
        let Value::Table(inner) = value else { continue };
        if NEEDED.iter().all(|key| inner.contains_key(*key)) {
            found.push((name, inner));
        } else {
            found.extend(cameras(inner));
        }
    }
    found
}

fn read(folder: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let fail = |reason: String| CalibrationError::content(file, reason);
    let table = parsed(file)?;
    let media = Media::find(folder)?;
    let mut footage = Footage { skipped: incomplete(&table), ..Footage::default() };
    let is_other = |path: &Path| is_toml(path, &|table| !cameras(table).is_empty());
    footage.assumed.extend(told_of_others(folder, file, &is_other));
    let mut straight = Vec::new();
    for (section, camera) in cameras(&table) {
        let names = names(section, camera);
        if camera.get("ignore").and_then(Value::as_bool) == Some(true) {
            footage.skipped.push(format!("camera '{}' is marked as ignored", names[0]));
            continue;
        }
        let Some(pictures) = media.likely_of_camera(&names, &mut footage.assumed) else {
            footage.skipped.push(media.why_none(&names));
            continue;
        };
        if !camera.contains_key(DISTORTIONS) {
            straight.push(format!("'{}'", names[0]));
        }
        let camera = source_camera(names[0].clone(), camera, pictures)
            .map_err(|reason| fail(format!("camera '{}': {reason}", names[0])))?;
        footage.cameras.push(checked(camera, file)?);
    }
    if !straight.is_empty() {
        let cameras = straight.join(", ");
        footage
            .assumed
            .push(format!("cameras without '{DISTORTIONS}' are taken to have no lens distortion: {cameras}"));
    }
    let first = footage.cameras.first().map(|c| match &c.pictures {
        Pictures::Video(path) => path.clone(),
        Pictures::Files(files) => files[0].clone(),
    });
    footage.timestamps = timestamps_near(file, first.as_deref());
    Ok(footage)
}

/// The camera's own name, and the others by which its pictures may go.
fn names(section: &str, camera: &Table) -> Vec<String> {
    let text = |key: &str| match camera.get(key) {
        Some(Value::String(s)) => Some(s.clone()),
        Some(Value::Integer(i)) => Some(i.to_string()),
        _ => None,
    };
    let ids: Vec<String> = ["name", "cam_id", "port"].iter().filter_map(|key| text(key)).collect();
    let id = ids.first().cloned().unwrap_or_else(|| section.to_owned());
    let numeric = id.chars().all(|c| c.is_ascii_digit());
    let own = if numeric { format!("cam_{id}") } else { id.clone() };
    let mut names = vec![own, id.clone()];
    // Not `camcam_01`.
    if !id.to_lowercase().starts_with("cam") {
        let padded = format!("{id:0>2}");
        names.extend(["port_", "cam", "cam_", "cam-", "camera"].map(|word| format!("{word}{id}")));
        names.extend(["cam", "cam_"].map(|word| format!("{word}{padded}")));
    }
    names.push(section.to_owned());
    names.dedup();
    names
}

const DISTORTIONS: &str = "distortions";

/// The coefficients of the lens; none where the table says nothing of them.
fn distortions(camera: &Table) -> Result<Vec<f64>, String> {
    match camera.get(DISTORTIONS) {
        Some(value) => flat(Some(value)).ok_or_else(|| format!("'{DISTORTIONS}' is no list of numbers")),
        None => match camera.iter().find(|(key, value)| may_mean_distortions(key, value)) {
            Some((key, _)) => Err(format!(
                "the lens's coefficients are wanted as '{DISTORTIONS}', not as '{key}': rename it"
            )),
            None => Ok(Vec::new()),
        },
    }
}

/// Without its distortion a lens would be taken for a straight one, and nothing would tell but the pictures.
fn may_mean_distortions(key: &str, value: &Value) -> bool {
    let key = key.to_lowercase();
    if !(value.is_array() || key == "k1") {
        return false;
    }
    let distance = key.contains("distance");
    (key.contains("dist") && !distance) || key.contains("coef") || ["d", "k1"].contains(&key.as_str())
}

fn source_camera(name: String, camera: &Table, pictures: Pictures) -> Result<SourceCamera, String> {
    let k = rows(camera, "matrix").and_then(|r| square(&r)).ok_or("'matrix' is not 3x3")?;
    let coefficients = distortions(camera)?;
    let fisheye = camera.get("fisheye").and_then(Value::as_bool) == Some(true);
    let distortion =
        if fisheye { Distortion::fisheye(&coefficients)? } else { Distortion::opencv(&coefficients)? };
    let size = flat(camera.get("size")).filter(|s| s.len() == 2).ok_or("'size' is not [width, height]")?;
    let size = ImageSize { width: size[0] as usize, height: size[1] as usize };
    let translation: [f64; 3] = flat(camera.get("translation"))
        .and_then(|t| t.try_into().ok())
        .ok_or("'translation' is not three numbers")?;
    let pose = rigid(rotation(camera)?, DVec3::from(translation));
    let lens = Lens::with_integer_centers(intrinsics(k)?, distortion, size);
    Ok(SourceCamera { name, lens, poses: vec![pose], pictures, masks: None, role: Role::Unsaid })
}

fn rotation(camera: &Table) -> Result<DMat3, String> {
    let values = flat(camera.get("rotation")).unwrap_or_default();
    match values.len() {
        3 => Ok(rodrigues([values[0], values[1], values[2]])),
        9 => Ok(DMat3::from_cols_slice(&values).transpose()),
        n => Err(format!("'rotation' has {n} numbers: 9 (a matrix) or 3 (a Rodrigues vector) are known")),
    }
}

fn rows(camera: &Table, key: &str) -> Option<Vec<Vec<f64>>> {
    camera.get(key)?.as_array()?.iter().map(|row| flat(Some(row))).collect()
}

/// All numbers of nested arrays, row by row.
fn flat(value: Option<&Value>) -> Option<Vec<f64>> {
    match value? {
        Value::Array(entries) => Some(
            entries
                .iter()
                .map(|v| flat(Some(v)))
                .collect::<Option<Vec<_>>>()?
                .into_iter()
                .flatten()
                .collect(),
        ),
        Value::Float(v) => Some(vec![*v]),
        Value::Integer(v) => Some(vec![*v as f64]),
        _ => None,
    }
}
