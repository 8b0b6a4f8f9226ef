use crate::meta::{Entry, Meta, io_error};
use crate::{DatasetError, PointCloud, pixels, points};
use ffgs_core::{Camera, ImageRgb8, Mask};
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Which part of a capture a view belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Views that are reconstructed from.
    Train,
    /// Held-out views; may move.
    Test,
    /// Views of frame 0 only, for the first frame, never for evaluation.
    Init,
}

impl Split {
    /// All splits.
    pub const ALL: [Self; 3] = [Self::Train, Self::Test, Self::Init];

    /// Name of the camera list in a capture.
    pub fn meta_file(self) -> &'static str {
        match self {
            Self::Train => "train_meta.json",
            Self::Test => "test_meta.json",
            Self::Init => "init_meta.json",
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Train => "train",
            Self::Test => "test",
            Self::Init => "init",
        })
    }
}

/// A physical camera of a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct View {
    /// Folder of its images below `ims/`.
    pub name: String,
    /// `cam_id` of the meta file.
    pub id: u32,
}

/// An opened capture: camera lists are in memory, images are read when asked for.
#[derive(Debug)]
pub struct Capture {
    root: PathBuf,
    splits: [Meta; 3],
}

impl Capture {
    /// Reads the camera lists of the capture in `root`. Cameras that are none are reported when asked for.
    pub fn open(root: &Path) -> Result<Self, DatasetError> {
        if !root.is_dir() {
            return Err(io_error(root, io::Error::new(io::ErrorKind::NotFound, "no such capture folder")));
        }
        let file = |split: Split| root.join(split.meta_file());
        let train = Meta::read(&file(Split::Train))?;
        let test = Meta::read_optional(&file(Split::Test))?;
        let init = Meta::read_optional(&file(Split::Init))?;
        if !test.entries.is_empty() && test.entries.len() != train.entries.len() {
            let reason = format!("{} frames, train has {}", test.entries.len(), train.entries.len());
            return Err(DatasetError::Meta { file: file(Split::Test), reason });
        }
        Ok(Self { root: root.to_owned(), splits: [train, test, init] })
    }

    /// The capture's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Number of frames of the train and test views.
    pub fn frames(&self) -> usize {
        self.meta(Split::Train).entries.len()
    }

    /// Number of frames of a split: [`Capture::frames`], at most 1 for `Init`, 0 for a split without views.
    pub fn frames_of(&self, split: Split) -> usize {
        let frames = self.meta(split).entries.len();
        if split == Split::Init { frames.min(1) } else { frames }
    }

    /// Views of a split in the order of the meta file; indices below refer to it.
    pub fn views(&self, split: Split) -> &[View] {
        &self.meta(split).views
    }

    /// The camera of a view at a frame.
    pub fn camera(&self, split: Split, view: usize, frame: usize) -> Result<Camera, DatasetError> {
        let entry = self.entry(split, view, frame)?;
        entry.camera().map_err(|source| DatasetError::Camera {
            file: self.root.join(split.meta_file()),
            view: self.views(split)[view].name.clone(),
            frame,
            source,
        })
    }

    /// Path of a view's image.
    pub fn image_path(&self, split: Split, view: usize, frame: usize) -> Result<PathBuf, DatasetError> {
        Ok(self.root.join("ims").join(&self.entry(split, view, frame)?.file_name))
    }

    /// Path of a view's mask, which need not exist (always .png, as Dynamic3DGaussians stores it).
    pub fn mask_path(&self, split: Split, view: usize, frame: usize) -> Result<PathBuf, DatasetError> {
        Ok(self.root.join("seg").join(&self.entry(split, view, frame)?.file_name).with_extension("png"))
    }

    /// Reads an image of the size of its camera.
    pub fn load_image(&self, split: Split, view: usize, frame: usize) -> Result<ImageRgb8, DatasetError> {
        let size = self.camera(split, view, frame)?.size();
        pixels::read_rgb(&self.image_path(split, view, frame)?, size)
    }

    /// Checks that the image is there, has the size of its camera and is not cut off, without decoding it.
    ///
    /// # Errors
    /// As [`Capture::load_image`]; damage inside the file is found only by that.
    pub fn probe_image(&self, split: Split, view: usize, frame: usize) -> Result<(), DatasetError> {
        let size = self.camera(split, view, frame)?.size();
        pixels::probe(&self.image_path(split, view, frame)?, size)
    }

    /// Reads a foreground mask of the size of its camera; `None` when the capture has no mask for this image.
    pub fn load_mask(&self, split: Split, view: usize, frame: usize) -> Result<Option<Mask>, DatasetError> {
        let size = self.camera(split, view, frame)?.size();
        let path = self.mask_path(split, view, frame)?;
        if path.exists() { pixels::read_mask(&path, size).map(Some) } else { Ok(None) }
    }

    /// Reads the initial points; non-finite ones are dropped and counted in [`PointCloud::dropped`].
    pub fn initial_points(&self) -> Result<PointCloud, DatasetError> {
        points::read(&self.points_path())
    }

    /// Path of the initial points.
    pub fn points_path(&self) -> PathBuf {
        self.root.join("init_pt_cld.npz")
    }

    fn meta(&self, split: Split) -> &Meta {
        &self.splits[split as usize]
    }

    fn entry(&self, split: Split, view: usize, frame: usize) -> Result<&Entry, DatasetError> {
        let entry = self.meta(split).entries.get(frame).and_then(|views| views.get(view));
        entry.ok_or(DatasetError::NoSuchView { split, view, frame })
    }
}
