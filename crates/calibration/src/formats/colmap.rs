//! COLMAP's sparse models: text or binary, one for all frames or one per frame; world to camera, pixel centres at
//! 0.5.

use super::colmap_model::{CameraRecord, ImageRecord, Model};
use super::left_out::usable_points;
use super::{Format, checked, colmap_binary, colmap_text, find_below, told_of_others};
use crate::media::{natural_order, stem};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Pictures, Role, SourceCamera};
use ffgs_core::Intrinsics;
use glam::{DMat3, DMat4, DQuat, DVec3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Reads COLMAP's models.
pub const FORMAT: Format =
    Format { name: "colmap", looks_for: "cameras.bin or cameras.txt with images (COLMAP)", find, read };

fn find(folder: &Path) -> Option<PathBuf> {
    find_below(folder, &is_model)
}

/// Whether a path is the list of cameras of a model.
fn is_model(path: &Path) -> bool {
    let named = |name: &str| path.file_name().is_some_and(|n| n == name);
    let both = |ending: &str| {
        named(&format!("cameras.{ending}")) && path.with_file_name(format!("images.{ending}")).is_file()
    };
    both("bin") || both("txt")
}

fn read(folder: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let per_frame = models_of_frames(folder, file);
    if per_frame.len() > 1 { read_frames(&per_frame) } else { read_one(folder, file) }
}

/// A model without points that are no places, which `skipped` tells.
fn read_model(cameras: &Path, skipped: &mut Vec<String>) -> Result<Model, CalibrationError> {
    let is_binary = cameras.extension().is_some_and(|e| e == "bin");
    let mut model = if is_binary { colmap_binary::read(cameras) } else { colmap_text::read(cameras) }?;
    let file = cameras.with_file_name(if is_binary { "points3D.bin" } else { "points3D.txt" });
    model.points = usable_points(model.points, &file, skipped);
    Ok(model)
}

/// One model whose images are cameras: photographs of a static scene, or the first frames of videos.
fn read_one(folder: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let mut footage = Footage::default();
    let model = read_model(file, &mut footage.skipped)?;
    footage.points = model.points;
    // A model in both forms is one.
    let is_other = |path: &Path| is_model(path) && path.parent() != file.parent();
    footage.assumed.extend(told_of_others(folder, file, &is_other));
    let media = Media::find(folder)?;
    for image in &model.images {
        match pictures(&media, &image.name) {
            None => footage.skipped.push(format!("{} is in the model but not here", image.name)),
            Some(pictures) => {
                let lens = lens_of(&model.cameras, image, file)?;
                let name = camera_name(&image.name, &pictures);
                let camera = SourceCamera {
                    name,
                    lens,
                    poses: vec![pose(image)],
                    pictures,
                    masks: None,
                    role: Role::Unsaid,
                };
                footage.cameras.push(checked(camera, file)?);
            }
        }
    }
    footage.cameras.sort_by(|a, b| natural_order(Path::new(&a.name), Path::new(&b.name)));
    Ok(footage)
}

/// A video or image folder called as the image (or as its folder), else the image itself.
fn pictures(media: &Media, image: &str) -> Option<Pictures> {
    let path = Path::new(image);
    let mut names = vec![stem(path)];
    names.extend(path.parent().map(stem).filter(|n| !n.is_empty()));
    let whole = |file: &&PathBuf| file.ends_with(image);
    let single =
        || media.folders().flat_map(|(_, files)| files).find(whole).map(|f| Pictures::Files(vec![f.clone()]));
    media.of_camera(&names).or_else(single)
}

fn camera_name(image: &str, pictures: &Pictures) -> String {
    match pictures {
        Pictures::Video(video) => stem(video),
        Pictures::Files(files) if files.len() == 1 => stem(Path::new(image)),
        Pictures::Files(files) => files[0].parent().map(stem).unwrap_or_default(),
    }
}

/// `cameras` files at the same place below sibling folders whose names differ in their digits only, each with its own
/// pictures: a model per frame.
fn models_of_frames(folder: &Path, file: &Path) -> Vec<(PathBuf, PathBuf)> {
    let Ok(below) = file.strip_prefix(folder) else { return Vec::new() };
    let mut parts = below.components();
    let Some(first) = parts.next() else { return Vec::new() };
    let inner = parts.as_path();
    if inner.as_os_str().is_empty() {
        return Vec::new();
    }
    let shape = |name: &str| name.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned();
    let wanted = first.as_os_str().to_string_lossy().into_owned();
    if shape(&wanted) == wanted {
        return Vec::new();
    }
    let siblings = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    let mut frames: Vec<(PathBuf, PathBuf)> = siblings
        .filter(|p| p.file_name().is_some_and(|n| shape(&n.to_string_lossy()) == shape(&wanted)))
        .map(|p| (p.join(inner), p))
        .filter(|(cameras, _)| cameras.is_file())
        .map(|(cameras, home)| (home, cameras))
        .collect();
    frames.sort_by(|a, b| natural_order(&a.0, &b.0));
    frames
}

/// A model per frame: each image name is a camera. One that some frame lacks is left out.
fn read_frames(frames: &[(PathBuf, PathBuf)]) -> Result<Footage, CalibrationError> {
    let mut footage = Footage::default();
    let mut cameras: BTreeMap<String, SourceCamera> = BTreeMap::new();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for (home, file) in frames {
        let mut skipped = Vec::new();
        let model = read_model(file, &mut skipped)?;
        let media = Media::find(home)?;
        for image in &model.images {
            let Some(Pictures::Files(files)) = pictures(&media, &image.name) else { continue };
            let name = stem(Path::new(&image.name));
            *counts.entry(name.clone()).or_default() += 1;
            let lens = lens_of(&model.cameras, image, file)?;
            let empty = || SourceCamera {
                name: name.clone(),
                lens,
                poses: Vec::new(),
                pictures: Pictures::Files(Vec::new()),
                masks: None,
                role: Role::Unsaid,
            };
            let camera = cameras.entry(name.clone()).or_insert_with(empty);
            let picture = files[0].display().to_string();
            camera
                .lens
                .refuse_other(&lens, &picture)
                .map_err(|reason| CalibrationError::content(file, format!("camera '{name}': {reason}")))?;
            camera.poses.push(pose(image));
            if let Pictures::Files(all) = &mut camera.pictures {
                all.push(files[0].clone());
            }
        }
        if footage.points.is_empty() {
            footage.points = model.points;
            footage.skipped.extend(skipped);
        }
    }
    for (name, camera) in cameras {
        if counts[&name] == frames.len() {
            footage.cameras.push(checked(camera, &frames[0].1)?);
        } else {
            footage.skipped.push(format!(
                "camera '{name}' is missing in {} of {} frames",
                frames.len() - counts[&name],
                frames.len()
            ));
        }
    }
    footage
        .assumed
        .push(format!("{} models are the frames in the order of their names, in one world", frames.len()));
    Ok(footage)
}

fn pose(image: &ImageRecord) -> DMat4 {
    let [w, x, y, z] = image.rotation;
    let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    super::rigid(rotation, DVec3::from(image.translation))
}

fn lens_of(cameras: &[CameraRecord], image: &ImageRecord, file: &Path) -> Result<Lens, CalibrationError> {
    let fail = |reason: String| CalibrationError::content(file, reason);
    let camera = cameras.iter().find(|c| c.id == image.camera);
    let camera = camera
        .ok_or_else(|| fail(format!("{} names camera {}, which is not there", image.name, image.camera)))?;
    lens(camera).map_err(|reason| fail(format!("camera {}: {reason}", camera.id)))
}

/// COLMAP, `src/colmap/sensor/models.h`: the parameters of each model, in order.
fn lens(camera: &CameraRecord) -> Result<Lens, String> {
    let p = &camera.parameters;
    let need = |n: usize| {
        if p.len() == n { Ok(()) } else { Err(format!("{} has {} parameters", camera.model, p.len())) }
    };
    let one_focal = || Intrinsics { fx: p[0], fy: p[0], cx: p[1], cy: p[2] };
    let two_focals = || Intrinsics { fx: p[0], fy: p[1], cx: p[2], cy: p[3] };
    let (intrinsics, distortion) = match camera.model.as_str() {
        "SIMPLE_PINHOLE" => need(3).map(|()| (one_focal(), Ok(Distortion::None)))?,
        "PINHOLE" => need(4).map(|()| (two_focals(), Ok(Distortion::None)))?,
        "SIMPLE_RADIAL" => need(4).map(|()| (one_focal(), Distortion::simple_radial(p[3], 0.0)))?,
        "RADIAL" => need(5).map(|()| (one_focal(), Distortion::simple_radial(p[3], p[4])))?,
        "OPENCV" => need(8).map(|()| (two_focals(), Distortion::opencv(&p[4..])))?,
        "FULL_OPENCV" => need(12).map(|()| (two_focals(), Distortion::opencv(&p[4..])))?,
        "OPENCV_FISHEYE" => need(8).map(|()| (two_focals(), Distortion::fisheye(&p[4..])))?,
        "SIMPLE_RADIAL_FISHEYE" => {
            need(4).map(|()| (one_focal(), Distortion::fisheye(&[p[3], 0.0, 0.0, 0.0])))?
        }
        "RADIAL_FISHEYE" => need(5).map(|()| (one_focal(), Distortion::fisheye(&[p[3], p[4], 0.0, 0.0])))?,
        other => {
            return Err(format!(
                "the model {other} is not supported: undistort with COLMAP's image_undistorter"
            ));
        }
    };
    Ok(Lens { intrinsics, distortion: distortion?, size: camera.size })
}
