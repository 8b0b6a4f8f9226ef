//! Footage with damaged calibrations, pictures and videos: prepared, or refused with a sentence.

use super::capture::files;
use super::case::{Case, Laboratory, names_a_file, said};
use super::inputs::{change, replace_by_no_file, stays_inside};
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Footage that the cases damage copies of.
const KINDS: [&str; 4] = ["colmap", "nerfstudio", "dynamic3dgs", "videos"];
/// Pixels of a video's side; its content does not matter.
const VIDEO_SIZE: &str = "64x48";

/// One file of the footage is damaged or no file at all; its pictures are taken, and every fourth time everything is made.
pub(crate) fn damaged_footage(case: &mut Case) -> Result<()> {
    let kind = case.one_of(&KINDS);
    let Some(sound) = footage(case, kind)? else { return Ok(()) };
    let footage = case.path("footage");
    super::capture::copy_folder(&sound, &footage)?;
    // Calibrations are few among many pictures and are damaged as often.
    let (pictures, others): (Vec<PathBuf>, Vec<PathBuf>) =
        files(&footage)?.into_iter().partition(|file| file.extension().is_some_and(|e| e == "png"));
    let pool = if case.below(4) == 0 { pictures } else { others };
    let Some(file) = (!pool.is_empty()).then(|| case.one_of(&pool)) else { return Ok(()) };
    let removed = case.below(5) == 0;
    if removed {
        replace_by_no_file(case, &file)?;
    } else {
        change(case, &file)?;
    }
    let paths = [&footage, &case.path("out")].map(|path| path.display().to_string());
    let mut words =
        ["prepare", &paths[0], "--out", &paths[1], "--count", "2", "--quiet"].map(str::to_owned).to_vec();
    if case.below(4) > 0 {
        words.extend(["--only", "pictures"].map(str::to_owned));
    }
    let ended = case.ffgs(&words)?;
    if removed {
        // What is no file could not be copied if the case failed.
        let _ = fs::remove_file(&file).or_else(|_| fs::remove_dir(&file));
    }
    ensure!(ended.status.success() || names_a_file(case, &said(&ended)), "which file? {}", said(&ended));
    stays_inside(case)
}

/// Sound footage of a kind, made by the program itself; `None` where that needs a tool that is not here.
fn footage(case: &mut Case, kind: &str) -> Result<Option<PathBuf>> {
    let laboratory = case.laboratory;
    let capture = laboratory.capture();
    match kind {
        "dynamic3dgs" => Ok(Some(capture)),
        "videos" if Command::new("ffmpeg").arg("-version").output().is_err() => Ok(None),
        "videos" => laboratory.shared(kind, |folder| videos(laboratory, folder)).map(Some),
        _ => {
            let words = |folder: &Path| {
                let paths = [&capture, folder].map(|path| path.display().to_string());
                ["convert", &paths[0], "--to", kind, "--out", &paths[1]].map(str::to_owned)
            };
            let convert = |folder: &Path| {
                let ended = case.ffgs(&words(folder))?;
                ensure!(ended.status.success(), "cannot convert: {}", said(&ended));
                Ok(())
            };
            laboratory.shared(kind, convert).map(Some)
        }
    }
}

/// A video of noise for each training camera, and the cameras as caliscope writes them.
fn videos(laboratory: &Laboratory, folder: &Path) -> Result<()> {
    fs::create_dir_all(folder)?;
    let meta: Value =
        serde_json::from_str(&fs::read_to_string(laboratory.capture().join("train_meta.json"))?)?;
    let mut calibration = String::new();
    let cameras = meta["k"][0].as_array().context("no cameras")?;
    for (i, k) in cameras.iter().enumerate() {
        let pose = &meta["w2c"][0][i];
        let row = |r: usize| format!("[{}, {}, {}]", pose[r][0], pose[r][1], pose[r][2]);
        write!(
            calibration,
            "[cam_{i}]\nsize = [64, 48]\nmatrix = {k}\ndistortions = []\nrotation = [{}, {}, {}]\n\
             translation = [{}, {}, {}]\n",
            row(0),
            row(1),
            row(2),
            pose[0][3],
            pose[1][3],
            pose[2][3]
        )?;
        let source = format!("testsrc=size={VIDEO_SIZE}:rate=10:duration=0.3");
        let mut ffmpeg = Command::new("ffmpeg");
        ffmpeg
            .args(["-loglevel", "error", "-f", "lavfi", "-i", &source])
            .arg(folder.join(format!("cam_{i}.mp4")));
        let output = ffmpeg.output().context("cannot start ffmpeg")?;
        ensure!(output.status.success(), "ffmpeg: {}", String::from_utf8_lossy(&output.stderr));
    }
    fs::write(folder.join("calibration.toml"), calibration).context("cannot write the calibration")
}
