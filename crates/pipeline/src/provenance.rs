//! What a run was made from: a capture that changes between two halves of a run is noticed.

use anyhow::{Context, Result};
use crc32fast::Hasher;
use ffgs_core::open_input;
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

/// Digest of what a frame is made from and measured on: images, masks, and the motion into it. `views` are the training
/// views used.
pub(crate) fn frame_digest(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<String> {
    let at = |split: Split, view: usize| ViewAt { split, view, frame };
    let mut shots: Vec<ViewAt> = views.iter().map(|&view| at(Split::Train, view)).collect();
    shots.extend((0..capture.views(Split::Test).len()).map(|view| at(Split::Test, view)));
    if frame == 0 {
        shots.extend((0..capture.views(Split::Init).len()).map(|view| at(Split::Init, view)));
    }
    let mut sums: Vec<_> = shots.par_iter().map(|&at| shot_checksum(capture, at)).collect::<Result<_>>()?;
    for file in track_files(capture, views, frame)? {
        sums.push(checksum(&file)?);
    }
    let all: Vec<u8> =
        sums.iter().flat_map(|(sum, bytes)| format!("{sum:08x} {bytes}\n").into_bytes()).collect();
    let bytes: u64 = sums.iter().map(|(_, bytes)| bytes).sum();
    Ok(format!("{:08x}-{bytes}", crc32fast::hash(&all)))
}

/// The tracker files of the motion into a frame.
fn track_files(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<Vec<PathBuf>> {
    let Some(store) = TrackStore::of(capture)?.filter(|_| frame > 0) else { return Ok(Vec::new()) };
    let cameras = || views.iter().map(|&view| capture.views(Split::Train)[view].as_str());
    let files =
        (0..store.trackers().len()).flat_map(|tracker| cameras().map(move |camera| (tracker, camera)));
    Ok(files.map(|(tracker, camera)| store.path(tracker, camera, frame)).collect::<Result<_, _>>()?)
}

/// Checksum of an image, as its file has it where there is one, and of its mask.
fn shot_checksum(capture: &dyn Capture, at: ViewAt) -> Result<(u32, u64)> {
    let mut hasher = Hasher::new();
    let bytes = if let Some(file) = capture.image_file(at) {
        let (sum, bytes) = checksum(&file)?;
        hasher.update(&sum.to_le_bytes());
        bytes
    } else {
        let image = capture.image(at)?;
        hasher.update(image.data());
        image.data().len() as u64
    };
    if let Some(mask) = capture.mask(at)? {
        hasher.update(mask.data());
    }
    Ok((hasher.finalize(), bytes))
}

/// CRC-32 and length of a file; zeros for one that is not there.
fn checksum(file: &Path) -> Result<(u32, u64)> {
    checksum_of(file).with_context(|| format!("cannot read {}", file.display()))
}

fn checksum_of(file: &Path) -> io::Result<(u32, u64)> {
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
