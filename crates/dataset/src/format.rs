//! The layout as a plug-in: what the contract asks of a capture.

use crate::capture::{Capture, POINTS_FILE, meta_file};
use crate::error::DatasetError;
use ffgs_core::{Camera, ImageRgb8, Mask, is_present};
use ffgs_method::{self as method, CaptureFormat, Fault, Part, Plugin, Points, Split, ViewAt};
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Captures as Dynamic3DGaussians stores them.
#[derive(Clone, Copy, Debug)]
pub struct Dynamic3dGaussians;

impl Plugin for Dynamic3dGaussians {
    fn name(&self) -> &'static str {
        "dynamic3dgs"
    }

    fn summary(&self) -> &'static str {
        "Dynamic3DGaussians: train_meta.json, ims/, seg/, init_pt_cld.npz"
    }
}

impl CaptureFormat for Dynamic3dGaussians {
    fn detect(&self, folder: &Path) -> Option<String> {
        let file = meta_file(Split::Train);
        folder.join(file).is_file().then(|| file.to_owned())
    }

    fn open(&self, folder: &Path) -> Result<Box<dyn method::Capture>, Fault> {
        let capture = Capture::open(folder).map_err(|error| error.in_capture(folder))?;
        Ok(Box::new(capture))
    }
}

impl method::Capture for Capture {
    fn root(&self) -> &Path {
        self.root()
    }

    fn frames(&self) -> usize {
        self.frames()
    }

    fn origin(&self) -> DVec3 {
        self.origin()
    }

    fn views(&self, split: Split) -> &[String] {
        self.names(split)
    }

    fn camera(&self, at: ViewAt) -> Result<Camera, Fault> {
        let camera =
            self.camera(at.split, at.view, at.frame).map_err(|error| error.in_capture(self.root()))?;
        Ok(camera.relative_to(self.origin()))
    }

    fn image(&self, at: ViewAt) -> Result<ImageRgb8, Fault> {
        self.load_image(at.split, at.view, at.frame).map_err(|error| error.in_capture(self.root()))
    }

    fn image_with_file(&self, at: ViewAt) -> Result<(ImageRgb8, Option<Vec<u8>>), Fault> {
        let read = self.load_image_with_file(at.split, at.view, at.frame);
        read.map(|(image, bytes)| (image, Some(bytes))).map_err(|error| error.in_capture(self.root()))
    }

    fn probe(&self, at: ViewAt) -> Result<(), Fault> {
        self.probe_image(at.split, at.view, at.frame).map_err(|error| error.in_capture(self.root()))
    }

    fn image_file(&self, at: ViewAt) -> Option<PathBuf> {
        self.image_path(at.split, at.view, at.frame).ok()
    }

    fn mask(&self, at: ViewAt) -> Result<Option<Mask>, Fault> {
        self.load_mask(at.split, at.view, at.frame).map_err(|error| error.in_capture(self.root()))
    }

    fn probe_mask(&self, at: ViewAt) -> Result<bool, Fault> {
        self.probe_mask(at.split, at.view, at.frame).map_err(|error| error.in_capture(self.root()))
    }

    fn points(&self) -> Result<Option<Points>, Fault> {
        if !is_present(&self.points_path()) {
            return Ok(None);
        }
        self.near_points().map(Some).map_err(|error| error.in_capture(self.root()))
    }

    fn part(&self, part: Part) -> PathBuf {
        match part {
            Part::Cameras(split) => self.root().join(meta_file(split)),
            Part::Images => self.root().join("ims"),
            Part::Masks => self.root().join("seg"),
            Part::Points => self.points_path(),
        }
    }
}

impl DatasetError {
    /// This error with the file of the capture in `root` that it is about.
    pub fn in_capture(&self, root: &Path) -> Fault {
        let file = match self {
            Self::Io { file, .. }
            | Self::Write { file, .. }
            | Self::Meta { file, .. }
            | Self::Camera { file, .. }
            | Self::Image { file, .. }
            | Self::ImageSize { file, .. } => file.clone(),
            Self::Points(_) => root.join(POINTS_FILE),
            Self::NoSuchView { split, .. } => root.join(meta_file(*split)),
        };
        Fault::new(&file, self, self.fix())
    }
}
