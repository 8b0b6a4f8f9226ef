//! The output folder of a run.

use anyhow::{Context, Result};
use ffgs_core::{is_present, read_bytes, refuse_link, write_atomically};
use ffgs_prepare::Summary;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Most bytes that a method may keep for the next frame.
const MAX_METHOD_BYTES: u64 = 1 << 32;

/// Beginning and end of the names of a frame's large files.
const HEAVY: [(&str, &str); 7] = [
    ("static", ".ply"),
    ("dynamic", ".ply"),
    ("sky", ".png"),
    ("motion", ".png"),
    ("uncertainty", ".png"),
    ("method", ".state"),
    ("state", ".ffgs"),
];

/// A frame's exact state,
pub(crate) const STATE: &str = "state.ffgs";
/// and the mark of one that is finished without.
const THINNED: &str = "thinned";

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
        self.frame(frame).join(STATE)
    }

    /// Whether the frame is finished, also when its Gaussians are not kept.
    pub fn is_finished(&self, frame: usize) -> bool {
        is_finished(&self.frame(frame))
    }

    /// Whether any frame is.
    pub(crate) fn has_finished_frames(&self) -> bool {
        entries(&self.0.join("frames")).iter().any(|frame| is_finished(frame))
    }

    /// There when the frame is finished and its Gaussians are not kept.
    pub(crate) fn thinned(&self, frame: usize) -> PathBuf {
        self.frame(frame).join(THINNED)
    }

    /// Removes the Gaussians and the full-size pictures of a finished frame. Its numbers, the pictures of the report and what a
    /// method stores in its own form stay.
    ///
    /// # Errors
    /// When a file cannot be removed.
    pub(crate) fn thin(&self, frame: usize) -> Result<()> {
        // First the mark: a frame without state and mark is not finished.
        let mark = self.thinned(frame);
        write_atomically(&mark, |out| out.write_all(b"the run's option --keep thinned this frame\n"))
            .with_context(|| format!("cannot write {}", mark.display()))?;
        let folder = self.frame(frame);
        let heavy = |file: &PathBuf| {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            HEAVY.iter().any(|(stem, ending)| name.starts_with(stem) && name.ends_with(ending))
        };
        let pictures = entries(&folder.join("test")).into_iter().filter(|file| file.is_file());
        for file in entries(&folder).into_iter().filter(heavy).chain(pictures) {
            std::fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
        }
        Ok(())
    }

    /// What the method keeps for the next frame, where it keeps anything.
    pub(crate) fn method_state(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("method.state")
    }

    /// What the method kept; nothing where it kept nothing.
    ///
    /// # Errors
    /// When there is something that cannot be read.
    pub(crate) fn read_method_state(&self, frame: usize) -> Result<Vec<u8>> {
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

    /// The exposures of the cameras, where they differ.
    pub(crate) fn exposures(&self) -> PathBuf {
        self.0.join("exposures.json")
    }

    /// Those of a frame, where it changes any.
    pub(crate) fn exposures_of(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("exposures.json")
    }

    /// The circle around what moves, a [`ffgs_report::Turntable`]; a run writes it at its end.
    pub fn turntable(&self) -> PathBuf {
        self.0.join("turntable.json")
    }

    /// The training cameras' first photographs with what is drawn on them, a [`ffgs_report::CameraPictures`].
    pub(crate) fn cameras(&self) -> PathBuf {
        self.0.join("cameras.json")
    }

    /// How the capture was prepared, copied from it, where it was.
    pub(crate) fn preparation(&self) -> PathBuf {
        self.0.join(Summary::FILE)
    }

    /// How near to the truth the motion initialisation was, once `ffgs-lab motion-eval --run` has scored it.
    pub fn motion_accuracy(&self) -> PathBuf {
        self.0.join("motion-accuracy.json")
    }

    /// Refuses a folder whose parts are links: what is written or removed through them lies elsewhere.
    ///
    /// # Errors
    /// Names the link.
    pub(crate) fn refuse_links(&self) -> Result<()> {
        let frames = self.0.join("frames");
        refuse_link_at(&frames)?;
        for frame in entries(&frames) {
            refuse_link_at(&frame)?;
            refuse_link_at(&frame.join("test"))?;
        }
        Ok(())
    }

    /// Where a command writes unless it is told another place: a folder of this name, and one in it.
    ///
    /// # Errors
    /// When one of them is a link.
    pub fn inside(&self, names: &[&str]) -> Result<PathBuf> {
        let mut path = self.0.clone();
        for name in names {
            path.push(name);
            refuse_link_at(&path)?;
        }
        Ok(path)
    }

    /// Removes the half-written files of runs that were killed; only for the process that holds the folder.
    ///
    /// # Errors
    /// When one cannot be removed.
    pub(crate) fn remove_half_written(&self) -> Result<()> {
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

/// Of a frame's folder.
fn is_finished(frame: &Path) -> bool {
    [STATE, THINNED].iter().any(|name| frame.join(name).exists())
}

fn refuse_link_at(path: &Path) -> Result<()> {
    refuse_link(path).with_context(|| format!("cannot write into {}", path.display()))
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

    #[cfg(unix)]
    #[test]
    fn links_that_lead_out_of_the_folder_are_refused() {
        let place = tempfile::tempdir().unwrap();
        let (run, outside) = (RunFolder(place.path().join("run")), place.path().join("outside"));
        std::fs::create_dir_all(run.frame(0)).unwrap();
        std::fs::create_dir(&outside).unwrap();
        run.refuse_links().unwrap();
        assert_eq!(run.inside(&["export", "spz"]).unwrap(), run.0.join("export/spz"));
        for link in [run.frame(0).join("test"), run.frame(1), run.0.join("export/spz"), run.0.join("renders")]
        {
            std::fs::create_dir_all(link.parent().unwrap()).unwrap();
            std::os::unix::fs::symlink(&outside, &link).unwrap();
            let ended = run.refuse_links().and(run.inside(&["export", "spz"])).and(run.inside(&["renders"]));
            let told = format!("{:#}", ended.unwrap_err());
            assert!(told.contains(&link.display().to_string()) && told.contains("remove it"), "{told}");
            std::fs::remove_file(link).unwrap();
        }
    }

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
