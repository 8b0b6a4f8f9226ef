//! A capture of the layout.

use crate::error::DatasetError;
use crate::meta::{Entry, Meta, View};
use crate::{origin, pixels, points};
use ffgs_core::{Camera, ImageRgb8, Mask, counted, is_present};
use ffgs_method::{Points, Split};
use glam::DVec3;
use std::io;
use std::path::{Path, PathBuf};

/// Initial points of a capture.
pub(crate) const POINTS_FILE: &str = "init_pt_cld.npz";

/// Name of the camera list of a split.
pub(crate) fn meta_file(split: Split) -> &'static str {
    match split {
        Split::Train => "train_meta.json",
        Split::Test => "test_meta.json",
        Split::Init => "init_meta.json",
    }
}

/// An opened capture: camera lists are in memory, images are read when asked for.
#[derive(Debug)]
pub struct Capture {
    root: PathBuf,
    splits: [Meta; 3],
    /// Names of the views of each split.
    names: [Vec<String>; 3],
    /// Near the cameras (m).
    origin: DVec3,
}

impl Capture {
    /// Reads the camera lists of the capture in `root`. Invalid cameras are reported on access, not here.
    ///
    /// # Errors
    /// When a camera list is missing or damaged, or the splits differ in their frames.
    pub fn open(root: &Path) -> Result<Self, DatasetError> {
        if !root.is_dir() {
            return Err(DatasetError::io(
                root,
                io::Error::new(io::ErrorKind::NotFound, "no such capture folder"),
            ));
        }
        let file = |split: Split| root.join(meta_file(split));
        let train = Meta::read(&file(Split::Train))?;
        let test = Meta::read_optional(&file(Split::Test))?;
        let init = Meta::read_optional(&file(Split::Init))?;
        if !test.entries.is_empty() && test.entries.len() != train.entries.len() {
            let reason =
                format!("{}, train has {}", counted(test.entries.len(), "frame"), train.entries.len());
            return Err(DatasetError::Meta { file: file(Split::Test), reason });
        }
        let splits = [train, test, init];
        let names = splits.each_ref().map(|meta| meta.views.iter().map(|view| view.name.clone()).collect());
        let cameras = splits[Split::Train as usize].entries.first().into_iter().flatten();
        let origin = origin::near(cameras.filter_map(|entry| entry.camera().ok()));
        Ok(Self { root: root.to_owned(), splits, names, origin })
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

    /// Names of these views.
    pub fn names(&self, split: Split) -> &[String] {
        &self.names[split as usize]
    }

    /// The camera of a view at a frame.
    ///
    /// # Errors
    /// When it is no camera, or the capture has no such view at that frame.
    pub fn camera(&self, split: Split, view: usize, frame: usize) -> Result<Camera, DatasetError> {
        let entry = self.entry(split, view, frame)?;
        entry.camera().map_err(|source| DatasetError::Camera {
            file: self.root.join(meta_file(split)),
            view: self.views(split)[view].name.clone(),
            frame,
            source,
        })
    }

    /// Path of a view's image.
    ///
    /// # Errors
    /// When the capture has no such view at that frame.
    pub fn image_path(&self, split: Split, view: usize, frame: usize) -> Result<PathBuf, DatasetError> {
        Ok(self.root.join("ims").join(&self.entry(split, view, frame)?.file_name))
    }

    /// Path of a view's mask, which need not exist (always .png, as Dynamic3DGaussians stores it).
    ///
    /// # Errors
    /// When the capture has no such view at that frame.
    pub fn mask_path(&self, split: Split, view: usize, frame: usize) -> Result<PathBuf, DatasetError> {
        Ok(self.root.join("seg").join(&self.entry(split, view, frame)?.file_name).with_extension("png"))
    }

    /// Reads an image of the size of its camera.
    ///
    /// # Errors
    /// When it is missing, damaged or of another size, or the capture has no such view at that frame.
    pub fn load_image(&self, split: Split, view: usize, frame: usize) -> Result<ImageRgb8, DatasetError> {
        self.load_image_with_file(split, view, frame).map(|(image, _)| image)
    }

    /// As [`Capture::load_image`], with the bytes of the file, which is opened once.
    ///
    /// # Errors
    /// As [`Capture::load_image`].
    pub fn load_image_with_file(
        &self,
        split: Split,
        view: usize,
        frame: usize,
    ) -> Result<(ImageRgb8, Vec<u8>), DatasetError> {
        let size = self.camera(split, view, frame)?.size();
        pixels::read_image_with_file(&self.image_path(split, view, frame)?, size)
    }

    /// Checks that the image is there, has the size of its camera and is not cut off, without decoding it.
    ///
    /// # Errors
    /// As [`Capture::load_image`]; damage inside the file is found only by that.
    pub fn probe_image(&self, split: Split, view: usize, frame: usize) -> Result<(), DatasetError> {
        let size = self.camera(split, view, frame)?.size();
        pixels::probe_image(&self.image_path(split, view, frame)?, size)
    }

    /// Reads a foreground mask of the size of its camera; `None` when the capture has no mask for this image.
    ///
    /// # Errors
    /// When there is one that is damaged or of another size, or the capture has no such view at that frame.
    pub fn load_mask(&self, split: Split, view: usize, frame: usize) -> Result<Option<Mask>, DatasetError> {
        let size = self.camera(split, view, frame)?.size();
        let path = self.mask_path(split, view, frame)?;
        if is_present(&path) { pixels::read_mask(&path, size).map(Some) } else { Ok(None) }
    }

    /// Whether the capture has a mask for this image, which has its camera's size and is not cut off, without decoding it.
    ///
    /// # Errors
    /// As [`Capture::load_mask`]; damage inside the file is found only by that.
    pub fn probe_mask(&self, split: Split, view: usize, frame: usize) -> Result<bool, DatasetError> {
        let size = self.camera(split, view, frame)?.size();
        let path = self.mask_path(split, view, frame)?;
        if is_present(&path) { pixels::probe_image(&path, size).map(|()| true) } else { Ok(false) }
    }

    /// Reads the initial points; non-finite ones are dropped and counted in [`Points::dropped`].
    ///
    /// # Errors
    /// When the file is missing or damaged.
    pub fn initial_points(&self) -> Result<Points, DatasetError> {
        points::read(&self.points_path(), DVec3::ZERO, self.training_pixels())
    }

    /// The same relative to [`Capture::origin`].
    pub(crate) fn near_points(&self) -> Result<Points, DatasetError> {
        points::read(&self.points_path(), self.origin, self.training_pixels())
    }

    /// Pixels of the training images of a frame.
    fn training_pixels(&self) -> usize {
        let views = 0..self.views(Split::Train).len();
        views.filter_map(|view| self.camera(Split::Train, view, 0).ok()).map(|c| c.size().pixels()).sum()
    }

    /// A place near the cameras, where these are so far from zero that f32 would blur them (m); else zero.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Path of the initial points.
    pub fn points_path(&self) -> PathBuf {
        self.root.join(POINTS_FILE)
    }

    fn meta(&self, split: Split) -> &Meta {
        &self.splits[split as usize]
    }

    fn entry(&self, split: Split, view: usize, frame: usize) -> Result<&Entry, DatasetError> {
        let entry = self.meta(split).entries.get(frame).and_then(|views| views.get(view));
        entry.ok_or(DatasetError::NoSuchView { split, view, frame })
    }
}
