//! `intri.yml` and `extri.yml` of EasyMocap, EasyVolcap and ZJU-MoCap: OpenCV's YAML with `K_NAME`, `dist_NAME`,
//! `Rot_NAME` (or `R_NAME`, a Rodrigues vector) and `T_NAME`, world to camera, metres.

use super::{Format, checked, file_called, image_size, intrinsics, read_text, rigid, rodrigues};
use crate::media::{images_in, stem};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Pictures, Role, SourceCamera};
use ffgs_core::ImageSize;
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

/// Numbers of every key; scalars are one number. OpenCV's files start with `%YAML:1.0` and use the tag
/// `!!opencv-matrix`, which YAML readers refuse, and need no more of YAML than this.
fn parse(text: &str) -> Result<BTreeMap<String, Vec<f64>>, String> {
    let mut values: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut key = String::new();
    let mut open: Option<String> = None;
    for line in text.lines().map(str::trim_end).filter(|l| !l.starts_with(['%', '#']) && *l != "---") {
        if let Some(data) = &mut open {
            data.push_str(line);
        } else if let Some((name, rest)) = line.split_once(':') {
            let (indented, name, rest) = (line.starts_with([' ', '\t']), name.trim(), rest.trim());
            if !indented {
                name.trim_matches('"').clone_into(&mut key);
            }
            match (indented, name, rest.starts_with('[')) {
                (true, "data", _) | (false, _, true) => open = Some(rest.to_owned()),
                (false, ..) => {
                    values.extend(rest.parse().ok().map(|v: f64| (key.clone(), vec![v])));
                }
                _ => {}
            }
        }
        if open.as_ref().is_some_and(|data| data.contains(']')) {
            values.insert(
                key.clone(),
                numbers(&open.take().unwrap_or_default()).map_err(|e| format!("{key}: {e}"))?,
            );
        }
    }
    Ok(values)
}

fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let inner = text.trim_start_matches('[').split(']').next().unwrap_or_default();
    let words = inner.split(',').map(str::trim).filter(|w| !w.is_empty());
    // OpenCV writes .Nan and .Inf.
    words.map(|w| w.trim_start_matches('.').parse().map_err(|_| format!("'{w}' is not a number"))).collect()
}

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

type Values = BTreeMap<String, Vec<f64>>;

fn value<'a, const N: usize>(values: &'a Values, key: &str) -> Option<&'a [f64; N]> {
    values.get(key)?.as_slice().try_into().ok()
}

fn lens(values: &Values, name: &str, pictures: &Pictures) -> Result<Lens, String> {
    let k = value::<9>(values, &format!("K_{name}")).ok_or("K is not 3x3")?;
    let rows = [[k[0], k[1], k[2]], [k[3], k[4], k[5]], [k[6], k[7], k[8]]];
    let empty = Vec::new();
    let coefficients =
        [format!("dist_{name}"), format!("D_{name}")].into_iter().find_map(|key| values.get(&key));
    let distortion = Distortion::opencv(coefficients.unwrap_or(&empty))?;
    let side = |letter: &str| values.get(&format!("{letter}_{name}")).and_then(|v| v.first()).copied();
    let size = match (side("W"), side("H"), pictures) {
        (Some(w), Some(h), _) if w > 0.0 && h > 0.0 => ImageSize { width: w as usize, height: h as usize },
        (_, _, Pictures::Files(files)) => image_size(&files[0]).map_err(|e| e.to_string())?,
        // The size of a video is known when ffmpeg has looked at it; the lens belongs to that size.
        (_, _, Pictures::Video(_)) => ImageSize { width: 0, height: 0 },
    };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opencvs_yaml_is_read_in_all_its_forms() {
        let text = "%YAML:1.0\n---\nnames:\n  - \"01\"\nK_01: !!opencv-matrix\n   rows: 2\n   cols: 2\n   dt: d\n   \
            data: [ 1., 2.5e+02,\n       -3, 0. ]\nH_01: 1080\nv: [1, 2]\nbad: !!opencv-matrix\n   data: [ .Nan ]\n";
        let values = parse(text).unwrap();
        assert_eq!(values["K_01"], [1.0, 250.0, -3.0, 0.0]);
        assert_eq!(
            (values["H_01"].as_slice(), values["v"].as_slice()),
            ([1080.0].as_slice(), [1.0, 2.0].as_slice())
        );
        assert!(values["bad"][0].is_nan());
        assert!(parse("K: !!opencv-matrix\n   data: [ x ]\n").unwrap_err().contains('x'));
    }
}
