use crate::index::read_index;
use crate::{TrackFormat, Tracker, TracksError, correspondences, dense, exr_flow, flo};
use ffgs_core::{ImageSize, ViewMotion, is_present};
use ffgs_method::{Capture, Split, ViewAt};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What became of the rows or pixels of the files that were read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadStats {
    /// Rows (correspondences) or pixels (flow) in the files.
    pub read: usize,
    /// Those left out because they are not finite, or marked as unknown.
    pub dropped: usize,
}

/// The trackers of a capture. Nothing is cached.
#[derive(Clone, Debug)]
pub struct TrackStore {
    folder: PathBuf,
    stems: BTreeMap<String, Vec<String>>,
    trackers: Vec<Tracker>,
}

impl TrackStore {
    /// Reads `tracks/tracks.json` of the capture; `None` when the capture has none.
    pub fn open(capture_root: &Path) -> Result<Option<Self>, TracksError> {
        let folder = capture_root.join("tracks");
        let index = folder.join("tracks.json");
        if !is_present(&index) {
            return Ok(None);
        }
        Ok(Some(Self { trackers: read_index(&index)?, stems: BTreeMap::new(), folder }))
    }

    /// The trackers of an opened capture, which learn the names of its images; `None` when it has none.
    pub fn of(capture: &dyn Capture) -> Result<Option<Self>, TracksError> {
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

    /// Path of a tracker's file for the motion of a camera (folder name) from `frame - 1` to `frame`.
    pub fn path(&self, tracker: usize, camera: &str, frame: usize) -> Result<PathBuf, TracksError> {
        let entry = self.trackers.get(tracker).ok_or(TracksError::NoSuchTracker(tracker))?;
        let index = || self.folder.join("tracks.json");
        let file = entry
            .expand(camera, frame, self.stem(camera, frame))
            .map_err(|reason| TracksError::Index { file: index(), reason })?;
        Ok(self.folder.join(file))
    }

    fn stem(&self, camera: &str, frame: usize) -> Option<&str> {
        self.stems.get(camera)?.get(frame).map(String::as_str)
    }

    /// Reads that file; `None` when it does not exist. `size` is the camera's image size.
    pub fn load(
        &self,
        tracker: usize,
        camera: &str,
        frame: usize,
        size: ImageSize,
    ) -> Result<Option<ViewMotion>, TracksError> {
        Ok(self.load_counted(tracker, camera, frame, size)?.map(|(motion, _)| motion))
    }

    /// As [`TrackStore::load`], with the number of rows or pixels that were dropped.
    pub fn load_counted(
        &self,
        tracker: usize,
        camera: &str,
        frame: usize,
        size: ImageSize,
    ) -> Result<Option<(ViewMotion, LoadStats)>, TracksError> {
        let file = self.path(tracker, camera, frame)?;
        if !is_present(&file) {
            return Ok(None);
        }
        let mut stats = LoadStats::default();
        let motion = read(&self.trackers[tracker], &file, size, &mut stats)?;
        Ok(Some((motion, stats)))
    }
}

fn read(
    tracker: &Tracker,
    file: &Path,
    size: ImageSize,
    stats: &mut LoadStats,
) -> Result<ViewMotion, TracksError> {
    let flow = match tracker.format {
        TrackFormat::Npz => {
            return correspondences::read(file, size, tracker.pixel_center, stats).map(ViewMotion::Tracks);
        }
        TrackFormat::Flo => flo::read(file, size)?,
        TrackFormat::Exr => exr_flow::read_exr(file, size)?,
        TrackFormat::Npy => dense::read_npy_flow(file, size)?,
    };
    flow.into_motion(file, size, stats).map(ViewMotion::Dense)
}
