//! The files of a capture's trackers.

use crate::error::TracksError;
use crate::index::{Tracker, read_index};
use ffgs_core::{ImageSize, is_present};
use ffgs_method::{Capture, Fault, Split, Tracked, ViewAt};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The trackers of a capture. Nothing is cached.
#[derive(Clone, Debug)]
pub struct TrackStore {
    folder: PathBuf,
    stems: BTreeMap<String, Vec<String>>,
    trackers: Vec<Tracker>,
}

impl TrackStore {
    /// Reads `tracks/tracks.json` of the capture; `None` when the capture has none.
    ///
    /// # Errors
    /// When the list cannot be used.
    pub fn open(capture_root: &Path) -> Result<Option<Self>, Fault> {
        let folder = capture_root.join("tracks");
        let index = folder.join("tracks.json");
        if !is_present(&index) {
            return Ok(None);
        }
        let trackers = read_index(&index).map_err(|error| error.in_file(&index))?;
        Ok(Some(Self { trackers, stems: BTreeMap::new(), folder }))
    }

    /// The trackers of an opened capture, which learn the names of its images; `None` when it has none.
    ///
    /// # Errors
    /// When the list of trackers cannot be used.
    pub fn of(capture: &dyn Capture) -> Result<Option<Self>, Fault> {
        let Some(mut store) = Self::open(capture.root())? else { return Ok(None) };
        for (view, camera) in capture.views(Split::Train).iter().enumerate() {
            let stem = |frame| {
                let file = capture.image_file(ViewAt { split: Split::Train, view, frame })?;
                Some(file.file_stem()?.to_string_lossy().into_owned())
            };
            store.stems.insert(camera.clone(), (0..capture.frames()).map_while(stem).collect());
        }
        Ok(Some(store))
    }

    /// The trackers in the order of the file; indices below refer to it.
    pub fn trackers(&self) -> &[Tracker] {
        &self.trackers
    }

    /// The file that lists them.
    pub fn list(&self) -> PathBuf {
        self.folder.join("tracks.json")
    }

    /// Path of the file of tracker `tracker` for the motion of a camera (folder name) from `frame - 1` to `frame`.
    ///
    /// # Errors
    /// When the file is named after an image that the capture does not have.
    pub fn path(&self, tracker: usize, camera: &str, frame: usize) -> Result<PathBuf, Fault> {
        let file = self.trackers[tracker].expand(camera, frame, self.stem(camera, frame));
        let file = file.map_err(|reason| {
            let index = self.list();
            TracksError::Index { file: index.clone(), reason }.in_file(&index)
        })?;
        Ok(self.folder.join(file))
    }

    fn stem(&self, camera: &str, frame: usize) -> Option<&str> {
        self.stems.get(camera)?.get(frame).map(String::as_str)
    }

    /// Reads that file; `None` when it does not exist. `size` is the camera's image size.
    ///
    /// # Errors
    /// When the file is damaged or of another size.
    pub fn load(
        &self,
        tracker: usize,
        camera: &str,
        frame: usize,
        size: ImageSize,
    ) -> Result<Option<Tracked>, Fault> {
        let file = self.path(tracker, camera, frame)?;
        let Tracker { format, pixel_center, .. } = &self.trackers[tracker];
        is_present(&file).then(|| format.read(&file, size, *pixel_center)).transpose()
    }
}
