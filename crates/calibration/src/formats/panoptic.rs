//! `calibration_SEQUENCE.json` of CMU Panoptic: K, distCoef, R, t per camera, world to camera, in centimetres.

use super::{Format, checked, find_below, intrinsics, pose, read_text, square};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Role, SourceCamera};
use ffgs_core::ImageSize;
use serde::Deserialize;
use std::path::Path;

/// Reads the raw calibration of CMU Panoptic.
pub const FORMAT: Format = Format {
    name: "panoptic",
    looks_for: "calibration_*.json (CMU Panoptic)",
    find: |folder| {
        find_below(folder, &|path| {
            path.extension().is_some_and(|e| e == "json")
                && crate::media::stem(path).starts_with("calibration_")
        })
    },
    read,
};

const METRES_PER_UNIT: f64 = 0.01;

#[derive(Deserialize)]
struct Calibration {
    cameras: Vec<Entry>,
}

#[derive(Deserialize)]
struct Entry {
    name: String,
    #[serde(rename = "type", default)]
    kind: String,
    resolution: [usize; 2],
    #[serde(rename = "K")]
    k: Vec<Vec<f64>>,
    #[serde(rename = "distCoef")]
    distortion: Vec<f64>,
    #[serde(rename = "R")]
    r: Vec<Vec<f64>>,
    t: Vec<Vec<f64>>,
}

fn read(folder: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let fail = |reason: String| CalibrationError::content(file, reason);
    let calibration: Calibration =
        serde_json::from_str(&read_text(file)?).map_err(|e| fail(e.to_string()))?;
    let media = Media::find(folder)?;
    let mut footage = Footage { metres_per_unit: Some(METRES_PER_UNIT), ..Footage::default() };
    let mut without = 0;
    for entry in &calibration.cameras {
        match source_camera(entry, &media)
            .map_err(|reason| fail(format!("camera '{}': {reason}", entry.name)))?
        {
            Some(camera) => footage.cameras.push(checked(camera, file)?),
            None => without += 1,
        }
    }
    if without > 0 {
        footage.skipped.push(format!(
            "no video or images are here for {without} of {} cameras",
            calibration.cameras.len()
        ));
    }
    Ok(footage)
}

fn source_camera(entry: &Entry, media: &Media) -> Result<Option<SourceCamera>, String> {
    let names = [format!("{}_{}", entry.kind, entry.name), entry.name.clone()];
    let Some(pictures) = media.of_camera(&names) else { return Ok(None) };
    let [k, r] = [square(&entry.k).ok_or("K is not 3x3")?, square(&entry.r).ok_or("R is not 3x3")?];
    let t: Vec<f64> = entry.t.iter().flatten().copied().collect();
    let t: [f64; 3] = t.try_into().map_err(|_| "t is not three numbers")?;
    let size = ImageSize { width: entry.resolution[0], height: entry.resolution[1] };
    let lens = Lens::with_integer_centers(intrinsics(k)?, Distortion::opencv(&entry.distortion)?, size);
    let name = entry.name.clone();
    Ok(Some(SourceCamera { name, lens, poses: vec![pose(r, t)], pictures, masks: None, role: Role::Unsaid }))
}
