//! What a run was made from: a capture that changes between two halves of a run is noticed.

use anyhow::{Context, Result};
use crc32fast::Hasher;
use ffgs_core::{ImageRgb8, Mask, TrainingView, open_input};
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_tracks::TrackStore;
use rayon::prelude::*;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Version and commit.
pub(crate) const VERSION: &str = env!("FFGS_VERSION");

/// Bytes read at a time.
const BLOCK: usize = 1 << 16;

/// Digest of what belongs to no single frame: cameras, points, the list of trackers.
pub(crate) fn capture_digest(capture: &dyn Capture) -> Result<String> {
    let mut hasher = Hasher::new();
    for split in Split::ALL {
        for (view, name) in capture.views(split).iter().enumerate() {
            hasher.update(name.as_bytes());
            for frame in 0..capture.frames_of(split) {
                let camera = capture.camera(ViewAt { split, view, frame })?;
                hasher.update(format!("{:?}", (camera.intrinsics(), camera.camera_from_world())).as_bytes());
            }
        }
    }
    if let Some(points) = capture.points()? {
        let values = points.positions.iter().chain(&points.colours).flatten();
        values.for_each(|value| hasher.update(&value.to_le_bytes()));
    }
    if capture.origin() != glam::DVec3::ZERO {
        hasher.update(format!("{:?}", capture.origin()).as_bytes());
    }
    let trackers = checksum(&capture.root().join("tracks/tracks.json"))?;
    hasher.update(format!("{trackers:?}").as_bytes());
    Ok(format!("{:08x}", hasher.finalize()))
}

/// CRC-32 of what was read, and its length (bytes).
pub(crate) type Checksum = (u32, u64);

/// Checksums of views that are not in memory. Nothing is decoded but masks, where files hold the images.
pub(crate) fn checksums(capture: &dyn Capture, views: &[ViewAt]) -> Result<Vec<Checksum>> {
    views.par_iter().map(|&at| checksum_again(capture, at)).collect()
}

/// Checksums of the tracker files of the motion into a frame, for the training views `views` (by index).
///
/// # Errors
/// When one of them cannot be read.
pub(crate) fn track_checksums(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<Vec<Checksum>> {
    track_files(capture, views, frame)?.iter().map(|file| checksum(file)).collect()
}

/// Digest of what a frame is made from and measured on: checksums of the training views used, of the test views, of the
/// initialisation views and of the tracks into the frame, in this order.
pub(crate) fn frame_digest(sums: &[&[Checksum]]) -> String {
    let sums = || sums.iter().copied().flatten();
    let all: Vec<u8> = sums().flat_map(|(sum, bytes)| format!("{sum:08x} {bytes}\n").into_bytes()).collect();
    let bytes: u64 = sums().map(|(_, bytes)| bytes).sum();
    format!("{:08x}-{bytes}", crc32fast::hash(&all))
}

/// Digest of a file.
///
/// # Errors
/// When it cannot be read.
pub(crate) fn file_digest(file: &Path) -> Result<String> {
    Ok(frame_digest(&[&[checksum(file)?]]))
}

/// The tracker files of the motion into a frame.
fn track_files(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<Vec<PathBuf>> {
    let Some(store) = TrackStore::of(capture)?.filter(|_| frame > 0) else { return Ok(Vec::new()) };
    let cameras = || views.iter().map(|&view| capture.views(Split::Train)[view].as_str());
    let files =
        (0..store.trackers().len()).flat_map(|tracker| cameras().map(move |camera| (tracker, camera)));
    Ok(files.map(|(tracker, camera)| store.path(tracker, camera, frame)).collect::<Result<_, _>>()?)
}

/// Checksum of a view that is not in memory: nothing is decoded but its mask, where a file holds its image.
fn checksum_again(capture: &dyn Capture, at: ViewAt) -> Result<Checksum> {
    let mask = capture.mask(at)?;
    match capture.image_file(at) {
        Some(file) => Ok(of_view(&Picture::File(checksum(&file)?), mask.as_ref())),
        None => Ok(of_view(&Picture::Pixels(&capture.image(at)?), mask.as_ref())),
    }
}

/// An image as a checksum takes it.
enum Picture<'a> {
    /// Held by a file alone.
    File(Checksum),
    /// Held by something else, e.g. a video.
    Pixels(&'a ImageRgb8),
}

fn of_view(picture: &Picture, mask: Option<&Mask>) -> Checksum {
    let mut hasher = Hasher::new();
    let bytes = match picture {
        Picture::File((sum, bytes)) => {
            hasher.update(&sum.to_le_bytes());
            *bytes
        }
        Picture::Pixels(image) => {
            hasher.update(image.data());
            image.data().len() as u64
        }
    };
    mask.into_iter().for_each(|mask| hasher.update(mask.data()));
    (hasher.finalize(), bytes)
}

/// Loads a view, and takes the checksum of what it was read from. Its image is opened once.
///
/// # Errors
/// When its camera, image or mask cannot be read.
pub(crate) fn load_with_checksum(capture: &dyn Capture, at: ViewAt) -> Result<(TrainingView, Checksum)> {
    let camera = capture.camera(at)?;
    let (image, bytes) = capture.image_with_file(at)?;
    let mask = capture.mask(at)?;
    let picture = match (bytes, capture.image_file(at)) {
        (Some(bytes), _) => Picture::File((crc32fast::hash(&bytes), bytes.len() as u64)),
        (None, Some(file)) => Picture::File(checksum(&file)?),
        (None, None) => Picture::Pixels(&image),
    };
    let checksum = of_view(&picture, mask.as_ref());
    let mask = mask.unwrap_or_else(|| Mask::filled(camera.size(), false));
    Ok((TrainingView { camera, image, mask }, checksum))
}

/// CRC-32 and length of a file; zeros for one that is not there.
fn checksum(file: &Path) -> Result<Checksum> {
    checksum_of(file).with_context(|| format!("cannot read {}", file.display()))
}

fn checksum_of(file: &Path) -> io::Result<Checksum> {
    let mut opened = match open_input(file) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok((0, 0)),
        opened => opened?,
    };
    let (mut hasher, mut block, mut bytes) = (Hasher::new(), vec![0; BLOCK], 0);
    loop {
        let read = opened.read(&mut block)?;
        if read == 0 {
            return Ok((hasher.finalize(), bytes));
        }
        hasher.update(&block[..read]);
        bytes += read as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checksum_is_of_the_content_and_a_missing_file_is_empty() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        assert_eq!(checksum(&file).unwrap(), (0, 0));
        // The check value of the catalogue of CRC algorithms.
        std::fs::write(&file, "123456789").unwrap();
        assert_eq!(checksum(&file).unwrap(), (0xCBF4_3926, 9));
        let told = format!("{:#}", checksum(folder.path()).unwrap_err());
        assert!(told.contains(&folder.path().display().to_string()), "{told}");
    }
}
