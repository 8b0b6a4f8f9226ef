//! `intri.yml` and `extri.yml` of EasyMocap, EasyVolcap and ZJU-MoCap: OpenCV's YAML with `K_NAME`, `dist_NAME`,
//! `Rot_NAME` (or `R_NAME`, a Rodrigues vector) and `T_NAME`, world to camera, metres.

use super::file_storage::{Values, parse, value};
use super::left_out::complete_masks;
use super::{Format, checked, file_called, image_or_given_size, intrinsics, read_text, rigid, rodrigues};
use crate::media::{images_in, stem};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Pictures, Role, SourceCamera};
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Reads EasyMocap's and EasyVolcap's calibration.
pub const FORMAT: Format = Format {
    name: "easyvolcap",
    looks_for: "intri.yml and extri.yml (EasyVolcap, EasyMocap)",
    find: |folder| file_called(folder, "intri.yml").filter(|f| f.with_file_name("extri.yml").is_file()),
    read,
};

/// The folders in which these programs keep masks.
const MASKS: [&str; 3] = ["masks", "mask", "bgmasks"];

fn read(folder: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let load =
        |file: &Path| parse(&read_text(file)?).map_err(|reason| CalibrationError::content(file, reason));
    let extri = file.with_file_name("extri.yml");
    let (optics, poses) = (load(file)?, load(&extri)?);
    let media = Media::find(folder)?;
    let home = file.parent().unwrap_or(folder);
    let mut footage = Footage { metres_per_unit: Some(1.0), ..Footage::default() };
    for name in optics.keys().filter_map(|key| key.strip_prefix("K_")) {
        let Some(pictures) = media.likely_of_camera(&[name.to_owned()], &mut footage.assumed) else {
            footage.skipped.push(media.why_none(&[name.to_owned()]));
            continue;
        };
        let fail = |reason: String| CalibrationError::content(file, format!("camera '{name}': {reason}"));
        let pose_of =
            |reason: String| CalibrationError::content(&extri, format!("camera '{name}': {reason}"));
        let lens = lens(&optics, name, &pictures).map_err(fail)?;
        let pose =
            rigid(rotation(&poses, name).map_err(pose_of)?, translation(&poses, name).map_err(pose_of)?);
        let masks = masks(home, name, &pictures, &mut footage.skipped);
        let camera = SourceCamera {
            name: name.to_owned(),
            lens,
            poses: vec![pose],
            pictures,
            masks,
            role: Role::Unsaid,
        };
        footage.cameras.push(checked(camera, file)?);
    }
    Ok(footage)
}

fn lens(values: &Values, name: &str, pictures: &Pictures) -> Result<Lens, String> {
    let k = value::<9>(values, &format!("K_{name}")).ok_or("K is not 3x3")?;
    let rows = [[k[0], k[1], k[2]], [k[3], k[4], k[5]], [k[6], k[7], k[8]]];
    let keys = [format!("dist_{name}"), format!("D_{name}")];
    let distortion = match keys.into_iter().find_map(|key| values.get_key_value(&key)) {
        Some((key, found)) => Distortion::opencv(found).map_err(|reason| format!("{key}: {reason}"))?,
        None => Distortion::None,
    };
    let side = |letter: &str| values.get(&format!("{letter}_{name}")).and_then(|v| v.first()).copied();
    let size = image_or_given_size([side("W"), side("H")], pictures)?;
    Ok(Lens::with_integer_centers(intrinsics(rows)?, distortion, size))
}

fn rotation(values: &Values, name: &str) -> Result<DMat3, String> {
    if let Some(matrix) = value::<9>(values, &format!("Rot_{name}")) {
        return Ok(DMat3::from_cols_array(matrix).transpose());
    }
    let vector = value::<3>(values, &format!("R_{name}"));
    vector.map(|v| rodrigues(*v)).ok_or_else(|| "neither Rot (3x3) nor R (three numbers) is given".to_owned())
}

fn translation(values: &Values, name: &str) -> Result<DVec3, String> {
    let t = value::<3>(values, &format!("T_{name}")).ok_or("T is not three numbers")?;
    Ok(DVec3::from(*t))
}

/// Of the first folder with a mask for each picture, called as it; without such a folder none, and `skipped` tells what the first with masks lacks.
fn masks(home: &Path, name: &str, pictures: &Pictures, skipped: &mut Vec<String>) -> Option<Pictures> {
    let folders = MASKS.iter().map(|folder| home.join(folder).join(name));
    let folders: Vec<PathBuf> = folders.filter(|folder| !images_in(folder).is_empty()).collect();
    let first = folders.first()?.display();
    let Pictures::Files(files) = pictures else {
        skipped.push(format!("the masks in {first} are not used: camera '{name}' has a video, not pictures"));
        return None;
    };
    let mut found: Vec<_> = folders.iter().map(|folder| of_files(folder, files)).collect();
    let complete = found.iter().position(|masks| masks.iter().all(Result::is_ok));
    let masks = found.swap_remove(complete.unwrap_or(0));
    if masks.iter().all(Result::is_err) {
        let picture = stem(&files[0]);
        skipped.push(format!(
            "the masks in {first} are not used: none is called as a picture of camera '{name}', such as {picture}"
        ));
    }
    complete_masks(name, masks, skipped)
}

/// For each picture the mask of the folder that is called as it.
fn of_files(folder: &Path, files: &[PathBuf]) -> Vec<Result<PathBuf, String>> {
    let masks: BTreeMap<String, PathBuf> =
        images_in(folder).into_iter().map(|mask| (stem(&mask), mask)).collect();
    let missing = |name: &str| folder.join(name).display().to_string();
    let of_file = |name: String| masks.get(&name).cloned().ok_or_else(|| missing(&name));
    files.iter().map(|file| of_file(stem(file))).collect()
}
