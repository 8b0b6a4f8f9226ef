//! `transforms.json` of instant-ngp and nerfstudio: camera-to-world with OpenGL axes, intrinsics for all pictures or
//! one each, COLMAP's pixel centres (0.5). nerfstudio's points (`ply_file_path`) lie in the same world.

use super::left_out::{complete_masks, file_or_name};
use super::point_ply::read_points;
use super::{Format, checked, file_called, from_opengl, image_size, read_text};
use crate::footage::one_if_fixed;
use crate::media::{is_picture, stem};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Pictures, Role, SourceCamera};
use ffgs_core::{ImageSize, Intrinsics, is_present, nan_to_null};
use glam::DMat4;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Reads instant-ngp's and nerfstudio's camera lists.
pub const FORMAT: Format = Format {
    name: "transforms",
    looks_for: "transforms.json (nerfstudio, instant-ngp)",
    find: |folder| file_called(folder, "transforms.json"),
    read,
};

#[derive(Clone, Default, PartialEq, Deserialize)]
struct Optics {
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

#[derive(Deserialize)]
struct Entry {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    mask_path: Option<String>,
    #[serde(flatten)]
    optics: Optics,
}

#[derive(Deserialize)]
struct Transforms {
    frames: Vec<Entry>,
    #[serde(flatten)]
    optics: Optics,
    test_filenames: Option<Vec<String>>,
    ply_file_path: Option<String>,
}

fn read(folder: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let fail = |reason: String| CalibrationError::content(file, reason);
    let text = read_text(file)?;
    let transforms: Transforms =
        serde_json::from_str(&nan_to_null(&text)).map_err(|e| fail(e.to_string()))?;
    let home = file.parent().unwrap_or(folder);
    let media = Media::find(home)?;
    let mut footage = Footage::default();
    for (name, entries) in grouped(&transforms.frames) {
        let there: Vec<&Entry> =
            entries.iter().copied().filter(|e| located(home, &media, e).is_some()).collect();
        let missing = entries.iter().filter(|e| located(home, &media, e).is_none());
        footage.skipped.extend(missing.map(|e| format!("{} is listed but not there", e.file_path)));
        if let Some(mut camera) = source_camera(&transforms, home, &media, &name, &there).map_err(fail)? {
            camera.masks = masks(home, &camera, &there, &mut footage.skipped);
            footage.cameras.push(checked(camera, file)?);
        }
    }
    footage.cameras.sort_by(|a, b| crate::media::natural_order(Path::new(&a.name), Path::new(&b.name)));
    if let Some(name) = transforms.ply_file_path {
        let ply = home.join(&name);
        if is_present(&ply) {
            footage.points = read_points(&ply, &mut footage.skipped)?;
        } else {
            footage.skipped.push(format!("{name} is listed but not there"));
        }
    }
    Ok(footage)
}

/// Entries by camera: pictures in several folders are cameras with a frame each; in one folder every picture is a
/// camera of its own (a static scene, or a video per camera).
fn grouped(entries: &[Entry]) -> BTreeMap<String, Vec<&Entry>> {
    let plain =
        |e: &Entry| Path::new(&e.file_path).strip_prefix(".").unwrap_or(Path::new(&e.file_path)).to_owned();
    let parent = |e: &Entry| plain(e).parent().map(Path::to_owned).unwrap_or_default();
    let mut folders: BTreeMap<PathBuf, Vec<&Entry>> = BTreeMap::new();
    entries.iter().for_each(|e| folders.entry(parent(e)).or_default().push(e));
    let cameras = folders.len() > 1 && folders.values().any(|v| v.len() > 1);
    if cameras { named(folders) } else { named(entries.iter().map(|e| (plain(e), vec![e])).collect()) }
}

/// Each group by the last part of its path; by all of it where two would have the same name.
fn named(groups: BTreeMap<PathBuf, Vec<&Entry>>) -> BTreeMap<String, Vec<&Entry>> {
    let short: BTreeSet<String> = groups.keys().map(|path| bare(path)).collect();
    let names = if short.len() == groups.len() { bare } else { joined };
    groups.into_iter().map(|(path, entries)| (names(&path), entries)).collect()
}

fn joined(path: &Path) -> String {
    let folders = path.parent().into_iter().flatten().map(|part| part.to_string_lossy().into_owned());
    folders.chain([bare(path)]).collect::<Vec<_>>().join("_")
}

/// The last part of a path without the ending of a picture; what follows a dot in another name, as in `frame.0001`, belongs to it.
fn bare(path: &Path) -> String {
    let whole = || path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    if is_picture(path) { stem(path) } else { whole() }
}

/// The picture of an entry; `file_path` may lack its ending, or have that of pictures that were converted since, and may name the first picture of
/// a video.
fn located(home: &Path, media: &Media, entry: &Entry) -> Option<Pictures> {
    const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "JPG", "PNG"];
    let path = home.join(&entry.file_path);
    let with_ending = |ending: &str| path.with_file_name(format!("{}.{ending}", bare(&path)));
    let image = std::iter::once(path.clone()).chain(ENDINGS.map(with_ending)).find(|p| p.is_file());
    let video = || media.videos().iter().find(|v| stem(v) == bare(&path)).map(|v| Pictures::Video(v.clone()));
    video().or_else(|| Some(Pictures::Files(vec![image?])))
}

fn source_camera(
    all: &Transforms,
    home: &Path,
    media: &Media,
    name: &str,
    entries: &[&Entry],
) -> Result<Option<SourceCamera>, String> {
    let mut files = Vec::new();
    for entry in entries {
        match located(home, media, entry) {
            Some(Pictures::Files(file)) => files.extend(file),
            Some(video) => return one_video(all, name, entry, video).map(Some),
            None => {}
        }
    }
    let Some(first) = entries.first() else { return Ok(None) };
    let lens = one_lens(all, entries, &files[0]).map_err(|reason| format!("camera '{name}': {reason}"))?;
    let poses = entries.iter().map(|e| pose(e)).collect::<Result<Vec<_>, _>>()?;
    let poses = one_if_fixed(poses);
    let (name, role) = (name.to_owned(), role(all, &first.file_path));
    Ok(Some(SourceCamera { name, lens, poses, pictures: Pictures::Files(files), masks: None, role }))
}

/// The lens of all entries of a camera, of which `picture` is the first.
fn one_lens(all: &Transforms, entries: &[&Entry], picture: &Path) -> Result<Lens, String> {
    let first = &entries[0].optics;
    let of_first = lens(&all.optics, first, Some(picture))?;
    for entry in entries.iter().filter(|entry| entry.optics != *first) {
        of_first.refuse_other(&lens(&all.optics, &entry.optics, Some(picture))?, &entry.file_path)?;
    }
    Ok(of_first)
}

/// The masks that the entries of a camera name.
fn masks(
    home: &Path,
    camera: &SourceCamera,
    entries: &[&Entry],
    skipped: &mut Vec<String>,
) -> Option<Pictures> {
    let unnamed = |entry: &Entry| format!("that of {}", entry.file_path);
    let mask = |entry: &Entry| {
        entry.mask_path.as_ref().map_or_else(|| Err(unnamed(entry)), |path| file_or_name(home.join(path)))
    };
    let masks = entries.iter().map(|entry| mask(entry)).collect();
    let of_files = matches!(camera.pictures, Pictures::Files(_));
    if of_files { complete_masks(&camera.name, masks, skipped) } else { None }
}

fn one_video(all: &Transforms, name: &str, entry: &Entry, video: Pictures) -> Result<SourceCamera, String> {
    let lens = lens(&all.optics, &entry.optics, None)?;
    let (name, role) = (name.to_owned(), role(all, &entry.file_path));
    Ok(SourceCamera { name, lens, poses: vec![pose(entry)?], pictures: video, masks: None, role })
}

/// nerfstudio lists the files that are held out; without the list nothing is said.
fn role(all: &Transforms, file_path: &str) -> Role {
    match &all.test_filenames {
        None => Role::Unsaid,
        Some(test) if test.iter().any(|t| t == file_path) => Role::Test,
        Some(_) => Role::Train,
    }
}

fn pose(entry: &Entry) -> Result<DMat4, String> {
    let flat: Vec<f64> = entry.transform_matrix.iter().flatten().copied().collect();
    let wrong = || format!("transform_matrix of {} is not 4x4", entry.file_path);
    match flat.len() {
        12 | 16 => {
            let mut all = [0.0; 16];
            all[15] = 1.0;
            all[..flat.len()].copy_from_slice(&flat);
            Ok(from_opengl(DMat4::from_cols_array(&all).transpose()))
        }
        _ => Err(wrong()),
    }
}

fn lens(all: &Optics, own: &Optics, picture: Option<&Path>) -> Result<Lens, String> {
    let pick = |of: fn(&Optics) -> Option<f64>| of(own).or(of(all));
    let size = match (pick(|o| o.w), pick(|o| o.h), picture) {
        (Some(w), Some(h), _) => ImageSize { width: w as usize, height: h as usize },
        (_, _, Some(file)) => image_size(file).map_err(|e| e.to_string())?,
        _ => return Err("neither w and h nor a picture gives the image size".to_owned()),
    };
    let (w, h) = (size.width as f64, size.height as f64);
    let by_angle = |length: f64, angle: Option<f64>| angle.map(|a| 0.5 * length / (0.5 * a).tan());
    let fx = pick(|o| o.fl_x).or(by_angle(w, pick(|o| o.camera_angle_x)));
    let fx = fx.ok_or("neither fl_x nor camera_angle_x is given")?;
    let fy = pick(|o| o.fl_y).or(by_angle(h, pick(|o| o.camera_angle_y))).unwrap_or(fx);
    let (cx, cy) = (pick(|o| o.cx).unwrap_or(w / 2.0), pick(|o| o.cy).unwrap_or(h / 2.0));
    let distortion = distortion(all, own)?;
    Ok(Lens { intrinsics: Intrinsics { fx, fy, cx, cy }, distortion, size })
}

fn distortion(all: &Optics, own: &Optics) -> Result<Distortion, String> {
    let pick = |of: fn(&Optics) -> Option<f64>| of(own).or(of(all)).unwrap_or(0.0);
    let [k1, k2, k3, k4] = [pick(|o| o.k1), pick(|o| o.k2), pick(|o| o.k3), pick(|o| o.k4)];
    let model = own.camera_model.as_ref().or(all.camera_model.as_ref()).map_or("", String::as_str);
    if model == "OPENCV_FISHEYE" || own.is_fisheye.or(all.is_fisheye) == Some(true) {
        return Distortion::fisheye(&[k1, k2, k3, k4]);
    }
    if !["", "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV"].contains(&model)
    {
        return Err(format!("camera_model {model} is not supported: undistort with its own program first"));
    }
    // nerfstudio's k4 is the fourth power of r², which OpenCV's model does not have.
    if k4 != 0.0 {
        return Err("k4 of a perspective camera is not supported".to_owned());
    }
    Distortion::opencv(&[k1, k2, pick(|o| o.p1), pick(|o| o.p2), k3])
}
