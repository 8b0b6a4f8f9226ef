//! A run that has finished frames, to be read.

use crate::job::frame::{select_views, trained_cameras};
use crate::job::manifest::Manifest;
use crate::outputs::exposure_files::read_exposures;
use crate::outputs::folder::RunFolder;
use crate::outputs::json::read_json;
use crate::outputs::record::FrameRecord;
use crate::outputs::state;
use crate::plugins::registry::open_capture;
use anyhow::{Result, bail};
use ffgs_core::{Camera, Scene};
use ffgs_method::Capture;
use ffgs_reconstruction::Exposures;
use std::path::Path;

/// A run with at least one finished frame, and its capture.
pub struct FinishedRun {
    /// Output folder.
    pub folder: RunFolder,
    /// What was run.
    pub manifest: Manifest,
    /// What it was run on.
    pub capture: Box<dyn Capture>,
    /// Finished frames whose Gaussians are there, ascending.
    pub frames: Vec<usize>,
    /// Finished frames whose Gaussians were not kept (`ffgs run --keep`), ascending: only their numbers are there.
    pub thinned: Vec<usize>,
}

impl FinishedRun {
    /// Opens the run in `path`.
    ///
    /// # Errors
    /// When the folder holds no run with a finished frame, or its capture is gone.
    pub fn open(path: &Path) -> Result<Self> {
        let folder = RunFolder(path.to_owned());
        if !folder.manifest().exists() {
            bail!("{} is no output folder of ffgs run: it has no run.json", path.display());
        }
        let manifest: Manifest = read_json(&folder.manifest())?;
        let (frames, thinned) = finished_frames(&folder);
        if frames.is_empty() {
            bail!("{} has no finished frame; finish one with ffgs run --resume", path.display());
        }
        let at = &manifest.capture_path;
        if !at.is_dir() {
            bail!(
                "the capture of this run is not at {} any more; move it back, or set capture_path in {}",
                at.display(),
                folder.manifest().display()
            );
        }
        let capture = open_capture(at)?;
        Ok(Self { folder, manifest, capture, frames, thinned })
    }

    /// The numbers of every finished frame.
    ///
    /// # Errors
    /// When one of them cannot be read.
    pub fn records(&self) -> Result<Vec<FrameRecord>> {
        self.frames.iter().map(|&frame| self.record(frame)).collect()
    }

    /// The numbers of a finished frame.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn record(&self, frame: usize) -> Result<FrameRecord> {
        FrameRecord::read(&self.folder, frame, &*self.capture)
    }

    /// The exposures of its cameras in a frame.
    ///
    /// # Errors
    /// When their file is damaged.
    pub fn exposures(&self, frame: usize) -> Result<Exposures> {
        read_exposures(&self.folder, frame)
    }

    /// The cameras that a frame was trained on, and those of the initialisation views: only frame 0 has their photographs, but every frame can be
    /// looked at from there.
    ///
    /// # Errors
    /// When one of them is not in the capture any more.
    pub fn trained_cameras(&self, frame: usize) -> Result<Vec<Camera>> {
        let views = select_views(&*self.capture, self.manifest.train_views.as_deref())?;
        trained_cameras(&*self.capture, &views, frame)
    }

    /// Reads the scene of a frame.
    ///
    /// # Errors
    /// When its state cannot be read.
    pub fn scene(&self, frame: usize) -> Result<Scene> {
        state::load(&self.folder.state(frame), frame)
    }

    /// The frame asked for, or the last one.
    pub(crate) fn choose(&self, frame: Option<usize>) -> Result<usize> {
        match frame.or_else(|| self.frames.last().copied()) {
            Some(frame) if self.frames.contains(&frame) => Ok(frame),
            Some(frame) if self.thinned.contains(&frame) => bail!(
                "--frame {frame}: its Gaussians were not kept (--keep of the run); there are those of the frames {:?}",
                self.frames
            ),
            _ => bail!("--frame: not finished; this run has the frames {:?}", self.frames),
        }
    }
}

/// Those with their Gaussians, and those without.
fn finished_frames(folder: &RunFolder) -> (Vec<usize>, Vec<usize>) {
    let entries = std::fs::read_dir(folder.0.join("frames")).into_iter().flatten().flatten();
    let numbers = entries.filter_map(|e| e.file_name().to_str()?.parse().ok());
    let mut frames: Vec<usize> = numbers.filter(|&f| folder.is_finished(f)).collect();
    frames.sort_unstable();
    frames.into_iter().partition(|&frame| folder.state(frame).exists())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_a_run_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = FinishedRun::open(folder.path()).err().unwrap().to_string();
        assert!(error.contains("run.json"), "{error}");
    }
}
