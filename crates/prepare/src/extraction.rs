//! Pictures and masks of the footage, undistorted and reduced, to `ims/` and `seg/`.

use crate::rig::{Rig, RigCamera};
use crate::schedule::Schedule;
use crate::{PrepareError, Progress, pictures, video};
use ffgs_calibration::Pictures;
use ffgs_core::{ImageRgb8, ImageSize, Mask};
use ffgs_dataset::{write_image, write_mask};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Place of a picture below `ims/` and `seg/`.
pub(crate) fn file_name(camera: &str, frame: usize) -> String {
    format!("{camera}/{frame:06}.png")
}

/// Writes every picture that is not there yet; cameras work in parallel. Returns how many were written.
pub(crate) fn extract(
    rig: &Rig,
    schedule: &Schedule,
    out: &Path,
    progress: &dyn Progress,
) -> Result<usize, PrepareError> {
    let total = rig.cameras.len() * schedule.frames.len();
    let (done, written) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let tick = |new: bool| {
        written.fetch_add(usize::from(new), Ordering::Relaxed);
        progress.advance("pictures", done.fetch_add(1, Ordering::Relaxed) + 1, total);
    };
    rig.cameras.par_iter().enumerate().try_for_each(|(c, camera)| {
        let wanted: Vec<usize> = schedule.frames.iter().map(|row| row[c]).collect();
        extract_camera(camera, &wanted, out, &tick)?;
        extract_masks(camera, &wanted, out)
    })?;
    Ok(written.into_inner())
}

fn extract_camera(
    camera: &RigCamera,
    wanted: &[usize],
    out: &Path,
    tick: &(dyn Fn(bool) + Sync),
) -> Result<(), PrepareError> {
    let path = |frame: usize| out.join("ims").join(file_name(&camera.name, frame));
    let missing: Vec<(usize, PathBuf)> =
        wanted.iter().enumerate().filter(|(t, _)| !path(*t).exists()).map(|(t, i)| (*i, path(t))).collect();
    (missing.len()..wanted.len()).for_each(|_| tick(false));
    match &camera.pictures {
        Pictures::Video(file) => extract_video(camera, file, &missing, tick),
        Pictures::Files(files) => missing.iter().try_for_each(|(index, to)| {
            write(camera, &pictures::read_rgb(&files[*index])?, &files[*index], to)?;
            tick(true);
            Ok(())
        }),
    }
}

fn extract_video(
    camera: &RigCamera,
    file: &Path,
    missing: &[(usize, PathBuf)],
    tick: &(dyn Fn(bool) + Sync),
) -> Result<(), PrepareError> {
    let Some(last) = missing.iter().map(|(index, _)| *index).max() else { return Ok(()) };
    let mut frames = video::Frames::open(file)?;
    for index in 0..=last {
        let ended = || {
            PrepareError::picture(
                file,
                format!("decoding ended after {index} frames, {} are needed", last + 1),
            )
        };
        let picture = frames.next()?.ok_or_else(ended)?;
        for (_, to) in missing.iter().filter(|(i, _)| *i == index) {
            write(camera, &picture, file, to)?;
            tick(true);
        }
    }
    Ok(())
}

fn write(camera: &RigCamera, picture: &ImageRgb8, from: &Path, to: &Path) -> Result<(), PrepareError> {
    same_size(camera, picture.size(), from)?;
    // It has content everywhere: lenses with which it would not have are refused.
    Ok(write_image(to, &camera.undistortion.apply(picture).0)?)
}

/// # Errors
/// When a picture is not as large as the camera's first one.
pub(crate) fn same_size(camera: &RigCamera, found: ImageSize, from: &Path) -> Result<(), PrepareError> {
    let expected = camera.undistortion.source_size();
    if found == expected {
        return Ok(());
    }
    let reason = format!(
        "{} x {}, but the camera's first picture is {} x {}",
        found.width, found.height, expected.width, expected.height
    );
    Err(PrepareError::picture(from, reason))
}

/// Some pictures of a camera.
pub(crate) struct Sequence<'a> {
    pub pictures: &'a Pictures,
    pub count: usize,
    /// How many of them a second, where they are a video.
    pub rate: Option<f64>,
}

impl<'a> Sequence<'a> {
    /// At most `count` of them, spread over all, as they are; each with its file.
    ///
    /// # Errors
    /// When one cannot be read.
    pub(crate) fn spread(&self, count: usize) -> Result<Vec<(&'a Path, ImageRgb8)>, PrepareError> {
        let count = count.min(self.count);
        let chosen = (0..count).map(|i| (2 * i + 1) * self.count / (2 * count));
        let mut out = Vec::new();
        for index in chosen {
            let (file, picture) = match self.pictures {
                Pictures::Files(files) => (&files[index], Some(pictures::read_rgb(&files[index])?)),
                Pictures::Video(file) => {
                    let time = index as f64 / self.rate.unwrap_or(1.0);
                    (file, video::Frames::open_at(file, time)?.next()?)
                }
            };
            out.extend(picture.map(|picture| (file.as_path(), picture)));
        }
        Ok(out)
    }
}

fn extract_masks(camera: &RigCamera, wanted: &[usize], out: &Path) -> Result<(), PrepareError> {
    let Some(Pictures::Files(files)) = &camera.masks else { return Ok(()) };
    for (frame, index) in wanted.iter().enumerate() {
        let to = out.join("seg").join(file_name(&camera.name, frame));
        if !to.exists() {
            let mask: Mask = pictures::read_mask(&files[*index])?;
            same_size(camera, mask.size(), &files[*index])?;
            write_mask(&to, &camera.undistortion.apply_to_mask(&mask))?;
        }
    }
    Ok(())
}
