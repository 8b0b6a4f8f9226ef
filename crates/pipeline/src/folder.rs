//! The output folder of a run.

use anyhow::{Context, Result};
use ffgs_core::{is_present, read_bytes};
use std::path::{Path, PathBuf};

/// Most bytes that a method may keep for the next frame.
const MAX_METHOD_BYTES: u64 = 1 << 32;

/// Where the files of a run lie.
#[derive(Clone, Debug)]
pub struct RunFolder(pub PathBuf);

impl RunFolder {
    /// Folder of one frame.
    pub fn frame(&self, frame: usize) -> PathBuf {
        self.0.join(format!("frames/{frame:06}"))
    }

    /// The frame's exact state; it exists when, and only when, the frame is finished.
    pub fn state(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("state.ffgs")
    }

    /// What the method keeps for the next frame, where it keeps anything.
    pub fn method_state(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("method.state")
    }

    /// What the method kept; nothing where it kept nothing.
    ///
    /// # Errors
    /// When there is something that cannot be read.
    pub fn read_method_state(&self, frame: usize) -> Result<Vec<u8>> {
        let path = self.method_state(frame);
        if !is_present(&path) {
            return Ok(Vec::new());
        }
        read_bytes(&path, MAX_METHOD_BYTES).with_context(|| format!("cannot read {}", path.display()))
    }

    /// The frame's numbers.
    pub fn record(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("frame.json")
    }

    /// The frame's encoded pictures, a [`ffgs_report::FramePictures`].
    pub fn pictures(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("pictures.json")
    }

    /// How near to the truth the motion initialisation was, once `ffgs-lab motion-eval --run` has scored it.
    pub fn motion_accuracy(&self) -> PathBuf {
        self.0.join("motion-accuracy.json")
    }

    /// Removes the half-written files of runs that were killed; only for who holds the folder.
    ///
    /// # Errors
    /// When one cannot be removed.
    pub fn remove_half_written(&self) -> Result<()> {
        let mut folders = vec![self.0.clone()];
        for frame in entries(&self.0.join("frames")) {
            folders.extend([frame.join("test"), frame]);
        }
        for file in folders.iter().flat_map(|folder| entries(folder)).filter(|file| is_half_written(file)) {
            std::fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
        }
        Ok(())
    }

    /// The run's own description.
    pub fn manifest(&self) -> PathBuf {
        self.0.join("run.json")
    }
}

/// What a folder holds; nothing for none.
fn entries(folder: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
}

/// `NAME.PID.part`, as `write_atomically` calls a file before it is complete.
fn is_half_written(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let process = name.strip_suffix(".part").and_then(|name| name.rsplit_once('.'));
    process.is_some_and(|(_, pid)| pid.parse::<u32>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_half_written_files_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder(folder.path().to_owned());
        std::fs::create_dir_all(run.frame(0).join("test")).unwrap();
        let [half, report, mine] =
            ["state.ffgs.123.part", "test/a.png.9.part", "my.part"].map(|n| run.frame(0).join(n));
        let outside = folder.path().join("run.json.77.part");
        for file in [&half, &report, &mine, &outside, &run.state(0)] {
            std::fs::write(file, "x").unwrap();
        }
        run.remove_half_written().unwrap();
        assert!(!half.exists() && !report.exists() && !outside.exists());
        assert!(mine.exists() && run.state(0).exists());
    }
}
