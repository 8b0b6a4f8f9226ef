//! `intri.yml` and `extri.yml` of EasyMocap, EasyVolcap and ZJU-MoCap: OpenCV's YAML with `K_NAME`, `dist_NAME`,
//! `Rot_NAME` (or `R_NAME`, a Rodrigues vector) and `T_NAME`, world to camera, metres.

use super::file_storage::{Values, parse, value};
use super::{Format, checked, file_called, image_or_given_size, intrinsics, read_text, rigid, rodrigues};
use crate::media::{images_in, stem};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Pictures, Role, SourceCamera};
use glam::{DMat3, DVec3};
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
        let masks = masks(home, name, &pictures);
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
    let empty = Vec::new();
    let coefficients =
        [format!("dist_{name}"), format!("D_{name}")].into_iter().find_map(|key| values.get(&key));
    let distortion = Distortion::opencv(coefficients.unwrap_or(&empty))?;
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

/// Masks of the same number as the pictures.
fn masks(home: &Path, name: &str, pictures: &Pictures) -> Option<Pictures> {
    let Pictures::Files(files) = pictures else { return None };
    let all = MASKS.iter().map(|folder| images_in(&home.join(folder).join(name)));
    let same = |masks: &Vec<PathBuf>| {
        masks.len() == files.len() && masks.iter().zip(files).all(|(m, f)| stem(m) == stem(f))
    };
    all.into_iter().find(same).map(Pictures::Files)
}
