//! A file of OpenCV's `FileStorage` (XML or YAML) for each camera, or several in the camera's own folder: camera matrix, distortion, and the pose of
//! `cv2.solvePnP`, world to camera. Those who write such files name the keys themselves; the usual names are known.

use super::file_storage::{Values, parse};
use super::{Format, checked, image_or_given_size, intrinsics, levels, pose, read_text, rigid, rodrigues};
use crate::media::stem;
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Pictures, Role, SourceCamera};
use glam::{DMat4, DVec3};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Reads calibrations that were written with OpenCV.
pub const FORMAT: Format = Format {
    name: "opencv",
    looks_for: "an .xml or .yml of OpenCV with a camera matrix, rotation and translation for each camera",
    find: |folder| entries(folder, &mut Vec::new()).into_iter().next().map(|entry| entry.file),
    read,
};

/// Larger files are something else, such as a trained detector.
const MOST_BYTES: u64 = 1 << 20;
/// Words in the name of a file that are no part of its camera's.
const NO_NAME: [&str; 10] = [
    "calib",
    "calibration",
    "calibrated",
    "params",
    "parameters",
    "intrinsics",
    "extrinsics",
    "config",
    "matrix",
    "data",
];

/// A camera's values, and what it may be called.
struct Entry {
    file: PathBuf,
    names: Vec<String>,
    values: Values,
}

/// The cameras in or below a folder, in natural order; `skipped` gets files that are none though they look like one.
fn entries(folder: &Path, skipped: &mut Vec<String>) -> Vec<Entry> {
    let mut folders: Vec<(PathBuf, Vec<(PathBuf, Values)>)> = Vec::new();
    for file in levels(folder).flatten().filter(|path| may_be_one(path)) {
        let home = file.parent().unwrap_or(folder);
        match load(&file) {
            Ok(values) if matrix(&values).or(rotation(&values)).is_some() => {
                match folders.iter_mut().find(|(known, _)| known == home) {
                    Some((_, files)) => files.push((file, values)),
                    None => folders.push((home.to_owned(), vec![(file, values)])),
                }
            }
            Ok(_) => {}
            Err(reason) => skipped.extend(reason.map(|reason| format!("{}: {reason}", file.display()))),
        }
    }
    let of_one = |(home, files): (PathBuf, Vec<_>)| {
        let own = home.file_name().filter(|_| home != folder).map(|name| name.to_string_lossy().into_owned());
        of_one_folder(files, own, skipped)
    };
    folders.into_iter().flat_map(of_one).collect()
}

/// Each complete file is a camera; without one, all together are, as of `intrinsics.xml` and `extrinsics.xml`. `own` is the name of a folder that
/// may be a camera's.
fn of_one_folder(
    files: Vec<(PathBuf, Values)>,
    own: Option<String>,
    skipped: &mut Vec<String>,
) -> Vec<Entry> {
    let (complete, parts): (Vec<_>, Vec<_>) =
        files.into_iter().partition(|(_, values)| lacks(values).is_none());
    if complete.is_empty() {
        let mut together = Values::new();
        parts.iter().rev().for_each(|(_, values)| together.extend(values.clone()));
        let Some((file, _)) = parts.into_iter().next() else { return Vec::new() };
        return match (lacks(&together), own) {
            (None, Some(name)) => vec![Entry { file, names: vec![name], values: together }],
            (lack, _) => {
                let lack = lack.unwrap_or("a folder or a name of its camera");
                skipped.push(format!("{} is no camera's calibration: it lacks {lack}", file.display()));
                Vec::new()
            }
        };
    }
    let own = own.filter(|_| complete.len() == 1);
    complete
        .into_iter()
        .map(|(file, values)| Entry {
            names: own.iter().cloned().chain(names(&file)).collect(),
            file,
            values,
        })
        .collect()
}

/// What the camera of a file may be called, by the file's name.
fn names(file: &Path) -> Vec<String> {
    let whole = stem(file);
    let words = whole.split(['_', '-', '.', ' ']).filter(|w| !NO_NAME.contains(&w.to_lowercase().as_str()));
    let bare = words.collect::<Vec<_>>().join("_");
    if bare.is_empty() || bare == whole { vec![whole] } else { vec![bare, whole] }
}

fn may_be_one(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let small = || fs::metadata(path).is_ok_and(|facts| facts.is_file() && facts.len() <= MOST_BYTES);
    ["xml", "yml", "yaml"].contains(&ending.as_str()) && small()
}

/// # Errors
/// When it cannot be read: why, if it is OpenCV's.
fn load(file: &Path) -> Result<Values, Option<String>> {
    let text = read_text(file).map_err(|_| None)?;
    parse(&text).map_err(|reason| text.contains("opencv").then_some(reason))
}

/// The first key that is called so and has one of these `counts` of numbers; capitals and separators do not count.
fn called<'a>(
    values: &'a Values,
    counts: &[usize],
    fits: impl Fn(&str) -> bool,
) -> Option<(&'a str, &'a [f64])> {
    let plain = |key: &str| key.to_lowercase().replace(|c: char| !c.is_alphanumeric(), "");
    let mut entries = values.iter().map(|(key, found)| (key.as_str(), found.as_slice()));
    entries.find(|(key, found)| counts.contains(&found.len()) && fits(&plain(key)))
}

fn matrix(values: &Values) -> Option<(&str, &[f64])> {
    const NAMES: [&str; 7] =
        ["cameramatrix", "intrinsicmatrix", "intrinsics", "intrinsic", "cameraintrinsics", "mtx", "k"];
    called(values, &[9], |key| NAMES.contains(&key))
}

fn rotation(values: &Values) -> Option<(&str, &[f64])> {
    let is_it =
        |key: &str| key.starts_with("rot") || ["r", "rvec", "rvecs", "rmat", "rmatrix"].contains(&key);
    called(values, &[3, 9], is_it)
}

fn translation(values: &Values) -> Option<(&str, &[f64])> {
    called(values, &[3], |key| key.starts_with("trans") || ["t", "tvec", "tvecs"].contains(&key))
}

/// The key and the coefficients, if there are any.
fn distortion(values: &Values) -> Option<(&str, &[f64])> {
    let several: Vec<usize> = (2..=100).collect();
    called(values, &several, |key| key.starts_with("dist") || key == "d")
}

/// What is missing for a camera.
fn lacks(values: &Values) -> Option<&'static str> {
    let parts = [
        (matrix(values), "a camera matrix (3x3)"),
        (rotation(values), "a rotation (Rodrigues vector or 3x3)"),
        (translation(values), "a translation (three numbers)"),
    ];
    parts.into_iter().find_map(|(found, what)| found.is_none().then_some(what))
}

fn read(folder: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let mut footage = Footage::default();
    let entries = entries(folder, &mut footage.skipped);
    let media = Media::find(folder)?;
    let mut known = BTreeSet::new();
    for Entry { file, names, values } in &entries {
        let Some(pictures) = media.likely_of_camera(names, &mut footage.assumed) else {
            footage.skipped.push(media.why_none(names));
            continue;
        };
        let name = names[0].clone();
        if !known.insert(name.clone()) {
            footage.skipped.push(format!("{}: there is another camera '{name}'", file.display()));
            continue;
        }
        let fail = |reason: String| CalibrationError::content(file, format!("camera '{name}': {reason}"));
        if distortion(values).is_none() {
            footage
                .assumed
                .push(format!("camera '{name}' has no distortion: {} tells of none", file.display()));
        }
        let (lens, pose) = (lens(values, &pictures).map_err(fail)?, camera_from_world(values).map_err(fail)?);
        let camera =
            SourceCamera { name, lens, poses: vec![pose], pictures, masks: None, role: Role::Unsaid };
        footage.cameras.push(checked(camera, file)?);
    }
    let keys =
        entries.first().map(|e| [matrix, rotation, translation].map(|of| of(&e.values).map_or("", |v| v.0)));
    footage.assumed.extend(keys.map(|[matrix, rotation, translation]| {
        format!(
            "{rotation} and {translation} of files as {} lead from the world to the camera, as those of cv2.solvePnP, and {matrix} counts pixels from the \
             centre of the first",
            file.display()
        )
    }));
    Ok(footage)
}

fn lens(values: &Values, pictures: &Pictures) -> Result<Lens, String> {
    let [fx, skew, cx, _, fy, cy, ..] = matrix(values).map_or(&[][..], |v| v.1) else {
        return Err("its camera matrix is not 3x3".to_owned());
    };
    let side = |name: &str| called(values, &[1], |key| key == name).map(|(_, v)| v[0]);
    let size = image_or_given_size([side("imagewidth"), side("imageheight")], pictures)?;
    let rows = [[*fx, *skew, *cx], [0.0, *fy, *cy], [0.0, 0.0, 1.0]];
    let distortion = match distortion(values) {
        Some((key, found)) => Distortion::opencv(found).map_err(|reason| format!("{key}: {reason}"))?,
        None => Distortion::None,
    };
    Ok(Lens::with_integer_centers(intrinsics(rows)?, distortion, size))
}

fn camera_from_world(values: &Values) -> Result<DMat4, String> {
    let [rotation, translation] =
        [rotation(values), translation(values)].map(|found| found.map_or(&[][..], |v| v.1));
    let translation: [f64; 3] = translation.try_into().map_err(|_| "its translation is not three numbers")?;
    match rotation {
        [x, y, z] => Ok(rigid(rodrigues([*x, *y, *z]), DVec3::from(translation))),
        [a, b, c, d, e, f, g, h, i] => Ok(pose([[*a, *b, *c], [*d, *e, *f], [*g, *h, *i]], translation)),
        _ => Err("its rotation is neither a vector nor 3x3".to_owned()),
    }
}
