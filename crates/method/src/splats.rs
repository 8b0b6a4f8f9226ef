//! Files for other programs.

use crate::{Fault, Plugin};
use ffgs_core::Scene;
use std::path::{Path, PathBuf};

/// The scene of one frame.
#[derive(Clone, Debug)]
pub struct FrameScene {
    /// Frame.
    pub frame: usize,
    /// The scene.
    pub scene: Scene,
}

/// Writes scenes in a format.
pub trait SplatWriter: Plugin {
    /// Writes one frame into `folder`, which exists; returns the files.
    ///
    /// # Errors
    /// When a file cannot be written, or the format cannot hold the scene.
    fn write_frame(&self, scene: &Scene, folder: &Path) -> Result<Vec<PathBuf>, Fault>;

    /// Writes the frames of a run, in order, into `folder`, which exists. By default each goes to a folder of its own,
    /// `folder/NNNNNN`; a format over time writes one file.
    ///
    /// # Errors
    /// As [`write_frame`](Self::write_frame); an error of `frames` is handed on.
    fn write_run(
        &self,
        frames: &mut dyn Iterator<Item = Result<FrameScene, Fault>>,
        folder: &Path,
    ) -> Result<Vec<PathBuf>, Fault> {
        let mut files = Vec::new();
        for frame in frames {
            let FrameScene { frame, scene } = frame?;
            files.extend(self.write_frame(&scene, &folder.join(format!("{frame:06}")))?);
        }
        Ok(files)
    }
}
