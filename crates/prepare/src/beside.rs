//! Pictures of a camera beside those of the capture: of its whole footage, and of the empty scene (clean plates).

use crate::extraction::{Sequence, file_name, same_size};
use crate::journal::absolute;
use crate::pictures::read_rgb;
use crate::removal::remove;
use crate::rig::{Rig, RigCamera};
use crate::{PrepareError, Request, video};
use ffgs_calibration::{CLEAN_PLATES, Media, Pictures};
use ffgs_core::ImageRgb8;
use ffgs_dataset::write_image;
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// Pictures that are read of a camera's footage, and of the empty scene, at most.
const SAMPLES: usize = 16;
/// Folder of the capture for pictures of the footage: to find them in videos again, for every round of masks, would take longer than all else.
const KEPT: &str = "footage.part";

/// What the cameras saw beside the capture's pictures.
pub(crate) struct Beside<'a> {
    rig: &'a Rig,
    /// Pictures of the empty scene by camera.
    clean_plates: BTreeMap<String, Pictures>,
    kept: PathBuf,
    /// Pictures of the footage from one frame of the capture to the next.
    every: NonZeroUsize,
}

impl<'a> Beside<'a> {
    /// Looks for the clean plates of all cameras in the folder of the request, where there is one. Pictures are kept in its folder `out`.
    ///
    /// # Errors
    /// When the folder cannot be read or has none.
    pub(crate) fn new(rig: &'a Rig, request: &Request) -> Result<Self, PrepareError> {
        let mut clean_plates = BTreeMap::new();
        if let Some(folder) = request.clean_plates.as_deref() {
            let media = Media::find(folder)?;
            for camera in &rig.cameras {
                let names = names(camera);
                let found = media.of_camera(&names).or_else(|| media.image_of_camera(&names));
                clean_plates.extend(found.map(|pictures| (camera.name.clone(), pictures)));
            }
            if clean_plates.is_empty() {
                let first = &rig.cameras[0].name;
                let reason = format!(
                    "no picture, video or folder of pictures is named as a camera ({first}.png, for example)"
                );
                return Err(PrepareError::CleanPlates { folder: folder.to_owned(), reason });
            }
        }
        let kept = request.out.join(KEPT);
        remove(&kept)?;
        Ok(Self { rig, clean_plates, kept, every: request.every })
    }

    /// Removes the pictures that were kept.
    ///
    /// # Errors
    /// When they cannot be removed.
    pub(crate) fn discard(self) -> Result<(), PrepareError> {
        remove(&self.kept)
    }

    /// Whether the empty scene was filmed with a camera.
    pub(crate) fn has_clean_plate(&self, camera: &str) -> bool {
        self.clean_plates.contains_key(camera)
    }

    /// The empty scene in a camera; none where it was not filmed.
    ///
    /// # Errors
    /// When a picture cannot be read, none is there, or one is not as large as the camera's.
    pub(crate) fn clean_plates(&self, camera: &str) -> Result<Vec<ImageRgb8>, PrepareError> {
        let (Some(camera), Some(pictures)) = (self.camera(camera), self.clean_plates.get(camera)) else {
            return Ok(Vec::new());
        };
        let (count, rate) = match pictures {
            Pictures::Video(file) => {
                let facts = video::probe(file)?;
                (facts.frames, Some(facts.rate))
            }
            Pictures::Files(files) => (files.len(), None),
        };
        let undistorted = |(file, picture): (&Path, ImageRgb8)| {
            same_size(camera, picture.size(), file)?;
            Ok(camera.undistortion.apply(&picture).0)
        };
        let found = Sequence { pictures, count, rate }.spread(SAMPLES)?;
        if found.is_empty() {
            let file = first_file(pictures).unwrap_or(&self.kept);
            return Err(PrepareError::picture(file, "this clean plate holds no picture that can be decoded"));
        }
        found.into_iter().map(undistorted).collect()
    }

    /// How many times as long a camera's footage is as so many frames of it.
    pub(crate) fn times_longer(&self, camera: &str, frames: usize) -> f64 {
        let pictures = self.camera(camera).map_or(0, |camera| camera.sequence.pictures);
        pictures as f64 / (frames * self.every.get()) as f64
    }

    /// Pictures spread over the whole of a camera's footage, but for those of another size.
    ///
    /// # Errors
    /// When one cannot be read, or not be kept.
    pub(crate) fn footage(&self, camera: &str) -> Result<Vec<ImageRgb8>, PrepareError> {
        let file = |i: usize| self.kept.join(file_name(camera, i));
        if self.kept.join(camera).is_dir() {
            return (0..SAMPLES)
                .map(file)
                .take_while(|file| file.exists())
                .map(|file| read_rgb(&file))
                .collect();
        }
        let pictures = self.camera(camera).map_or(Ok(Vec::new()), spread)?;
        for (i, picture) in pictures.iter().enumerate() {
            write_image(&file(i), picture)?;
        }
        Ok(pictures)
    }

    fn camera(&self, name: &str) -> Option<&RigCamera> {
        self.rig.cameras.iter().find(|camera| camera.name == name)
    }
}

fn first_file(pictures: &Pictures) -> Option<&Path> {
    match pictures {
        Pictures::Video(file) => Some(file),
        Pictures::Files(files) => files.first().map(PathBuf::as_path),
    }
}

/// Pictures of a camera's footage, undistorted.
fn spread(camera: &RigCamera) -> Result<Vec<ImageRgb8>, PrepareError> {
    let (count, rate) = (camera.sequence.pictures, camera.sequence.rate);
    let found = Sequence { pictures: &camera.pictures, count, rate }.spread(SAMPLES)?;
    let usable = found.into_iter().filter(|(_, p)| p.size() == camera.undistortion.source_size());
    Ok(usable.map(|(_, picture)| camera.undistortion.apply(&picture).0).collect())
}

/// Clean plates do not lie where they would be taken for footage.
///
/// # Errors
/// When they do.
pub(crate) fn refuse_plates_among_footage(request: &Request) -> Result<(), PrepareError> {
    let Some(folder) = &request.clean_plates else { return Ok(()) };
    let place = absolute(folder);
    let Ok(within) = place.strip_prefix(absolute(&request.source)) else { return Ok(()) };
    if within.iter().any(|name| name.eq_ignore_ascii_case(CLEAN_PLATES)) {
        return Ok(());
    }
    let reason =
        format!("it lies in the footage's folder and would be taken for footage; call it {CLEAN_PLATES}");
    Err(PrepareError::CleanPlates { folder: folder.clone(), reason })
}

/// What a clean plate of a camera may be called: as the camera, or as its video or folder of pictures.
fn names(camera: &RigCamera) -> Vec<String> {
    let of = match &camera.pictures {
        Pictures::Video(file) => file.file_stem(),
        Pictures::Files(files) => files.first().and_then(|file| file.parent()?.file_name()),
    };
    let of = of.map(|name| name.to_string_lossy().into_owned());
    std::iter::once(camera.name.clone()).chain(of).collect()
}
