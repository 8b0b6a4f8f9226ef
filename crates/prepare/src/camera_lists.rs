//! `train_meta.json` and `test_meta.json`.

use crate::PrepareError;
use crate::extraction::file_name;
use crate::rig::{Rig, RigCamera};
use crate::schedule::Schedule;
use ffgs_core::{Intrinsics, write_atomically};
use serde_json::{Value, json};
use std::io::{self, Write};
use std::path::Path;

/// Writes both lists; the training list comes last, so that a capture that has it is complete.
pub(crate) fn write(rig: &Rig, schedule: &Schedule, out: &Path) -> Result<(), PrepareError> {
    let test = out.join("test_meta.json");
    match list(rig, schedule, true) {
        Some(list) => write_json(&test, &list)?,
        None if test.exists() => std::fs::remove_file(&test).map_err(|e| PrepareError::io(&test, e))?,
        None => {}
    }
    let train = list(rig, schedule, false).unwrap_or_default();
    write_json(&out.join("train_meta.json"), &train)
}

/// Writes JSON whole or not at all.
pub(crate) fn write_json(file: &Path, value: &Value) -> Result<(), PrepareError> {
    write_atomically(file, |w| w.write_all(value.to_string().as_bytes()))
        .map_err(|e: io::Error| PrepareError::io(file, e))
}

fn list(rig: &Rig, schedule: &Schedule, test: bool) -> Option<Value> {
    let chosen: Vec<(usize, &RigCamera)> =
        rig.cameras.iter().enumerate().filter(|(_, c)| c.test == test).collect();
    let sizes: Vec<_> = chosen.iter().map(|(_, c)| c.undistortion.size()).collect();
    let same = sizes.iter().all(|s| *s == *sizes.first().unwrap_or(s));
    let side = |of: fn(&ffgs_core::ImageSize) -> usize| {
        if same { json!(sizes.first().map(of)) } else { json!(sizes.iter().map(of).collect::<Vec<_>>()) }
    };
    let per_frame = |value: &dyn Fn(usize, usize, &RigCamera) -> Value| {
        let row = |t: usize| chosen.iter().map(|(c, camera)| value(t, *c, camera)).collect::<Vec<_>>();
        (0..schedule.frames.len()).map(row).collect::<Vec<_>>()
    };
    let list = json!({
        "w": side(|s| s.width),
        "h": side(|s| s.height),
        "k": per_frame(&|_, _, camera| matrix(camera.undistortion.intrinsics())),
        "w2c": per_frame(&|t, c, camera| pose(camera, schedule.frames[t][c])),
        "fn": per_frame(&|t, _, camera| json!(file_name(&camera.name, t))),
        "cam_id": per_frame(&|_, c, _| json!(c)),
    });
    (!chosen.is_empty()).then_some(list)
}

fn matrix(Intrinsics { fx, fy, cx, cy }: Intrinsics) -> Value {
    json!([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
}

fn pose(camera: &RigCamera, picture: usize) -> Value {
    let pose = camera.poses.get(picture).or(camera.poses.first()).copied().unwrap_or_default();
    json!(pose.transpose().to_cols_array_2d())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pictures::Look;
    use crate::schedule::Sequence;
    use ffgs_calibration::{Distortion, Footage, Lens, Pictures, Undistortion, detect};
    use ffgs_core::ImageSize;
    use ffgs_dataset::{Capture, Split};
    use glam::DMat4;

    fn camera(name: &str, width: usize) -> RigCamera {
        let size = ImageSize { width, height: 48 };
        let intrinsics = Intrinsics { fx: 70.0, fy: 72.0, cx: 30.0, cy: 20.0 };
        let lens = Lens { intrinsics, distortion: Distortion::None, size };
        RigCamera {
            name: name.to_owned(),
            undistortion: Undistortion::new(lens, size).unwrap(),
            poses: vec![DMat4::from_translation(glam::DVec3::Z)],
            pictures: Pictures::Files(Vec::new()),
            masks: None,
            test: false,
            look: Look { size, transparent: false, turned: false },
            sequence: Sequence { name: name.to_owned(), pictures: 2, rate: None, moments: None },
        }
    }

    /// The lists of two cameras with these widths, as a capture and as footage.
    fn written(widths: [usize; 2]) -> (Capture, Footage) {
        let folder = tempfile::tempdir().unwrap();
        let cameras = vec![camera("a", widths[0]), camera("b", widths[1])];
        let rig = Rig { cameras, ..Rig::default() };
        let schedule = Schedule { frames: vec![vec![0, 0], vec![1, 1]], ..Schedule::default() };
        write(&rig, &schedule, folder.path()).unwrap();
        let (format, file) = detect(folder.path(), None).unwrap();
        (Capture::open(folder.path()).unwrap(), (format.read)(folder.path(), &file).unwrap())
    }

    #[test]
    fn what_is_written_is_read_as_a_capture_and_prepared_again() {
        for widths in [[64, 80], [64, 64]] {
            let (capture, footage) = written(widths);
            let sizes =
                |frame| [0, 1].map(|view| capture.camera(Split::Train, view, frame).unwrap().size().width);
            assert_eq!([sizes(0), sizes(1)], [widths; 2]);
            let lenses: Vec<_> =
                footage.cameras.iter().map(|c| (c.name.as_str(), c.lens.size.width)).collect();
            assert_eq!(lenses, [("a", widths[0]), ("b", widths[1])]);
        }
    }
}
