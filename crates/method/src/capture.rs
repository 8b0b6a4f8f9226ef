//! Captures: calibrated cameras with images over frames.

use crate::{Fault, Plugin};
use ffgs_core::{Camera, ImageRgb8, Mask, is_fixed};
use glam::DVec3;
use std::collections::HashSet;
use std::fmt;
use std::path::{Path, PathBuf};

/// A layout of captures on disk, e.g. that of Dynamic3DGaussians.
pub trait CaptureFormat: Plugin {
    /// Why the folder is taken for a capture of this format (what was found there); `None` when it is not one. Looks
    /// at names and first bytes, not at whole files.
    fn detect(&self, folder: &Path) -> Option<String>;

    /// Opens the capture: reads the cameras. Images are read when asked for.
    ///
    /// # Errors
    /// When the list of cameras cannot be used. A single bad camera or image is the error of [`Capture::camera`] and
    /// [`Capture::image`], so that a check lists all of them.
    fn open(&self, folder: &Path) -> Result<Box<dyn Capture>, Fault>;
}

/// An opened capture. Nothing is kept: an image is decoded when asked for, from whatever holds it.
pub trait Capture: fmt::Debug + Send + Sync {
    /// The capture's folder.
    fn root(&self) -> &Path;

    /// Number of frames of the training and test views.
    fn frames(&self) -> usize;

    /// Where the world of [`camera`](Self::camera) and [`points`](Self::points) has its origin, in the coordinates of the
    /// files (m). Positions are kept as f32, so a capture far from its origin (UTM) is read about a near one.
    fn origin(&self) -> DVec3 {
        DVec3::ZERO
    }

    /// Names of the views of a split, each once; [`ViewAt::view`] is an index into it.
    fn views(&self, split: Split) -> &[String];

    /// The camera of a view at a frame. Cameras may move, and may differ in size.
    ///
    /// # Errors
    /// When the camera is none, or the capture has no such view.
    fn camera(&self, at: ViewAt) -> Result<Camera, Fault>;

    /// Whether a view's camera stands still, by [`ffgs_core::is_fixed`].
    ///
    /// # Errors
    /// As [`Capture::camera`], of the first frame whose camera cannot be read.
    fn is_fixed(&self, split: Split, view: usize) -> Result<bool, Fault> {
        is_fixed((0..self.frames_of(split)).map(|frame| self.camera(ViewAt { split, view, frame })))
    }

    /// The image, of the camera's size.
    ///
    /// # Errors
    /// When it is missing, damaged or of another size.
    fn image(&self, at: ViewAt) -> Result<ImageRgb8, Fault>;

    /// The image, and the bytes of the file that holds it alone, from one reading; without bytes where there is no such
    /// file, or where another reading costs nothing.
    ///
    /// # Errors
    /// As [`Capture::image`].
    fn image_with_file(&self, at: ViewAt) -> Result<(ImageRgb8, Option<Vec<u8>>), Fault> {
        self.image(at).map(|image| (image, None))
    }

    /// Checks that the image is there and whole, decoding no more than that takes.
    ///
    /// # Errors
    /// As [`Capture::image`]; damage inside the file may be found only by that.
    fn probe(&self, at: ViewAt) -> Result<(), Fault> {
        self.image(at).map(|_| ())
    }

    /// File that holds the image as it is, for programs that show it; `None` where there is none, e.g. in a video.
    fn image_file(&self, at: ViewAt) -> Option<PathBuf> {
        let _ = at;
        None
    }

    /// Foreground mask of the camera's size; `None` where the capture has none for this image.
    ///
    /// # Errors
    /// When there is one that is damaged or of another size.
    fn mask(&self, at: ViewAt) -> Result<Option<Mask>, Fault>;

    /// Whether there is a mask, and it is whole, decoding no more than that takes.
    ///
    /// # Errors
    /// As [`Capture::mask`]; damage inside the file may be found only by that.
    fn probe_mask(&self, at: ViewAt) -> Result<bool, Fault> {
        self.mask(at).map(|mask| mask.is_some())
    }

    /// Coloured points of frame 0; `None` where the capture has none.
    ///
    /// # Errors
    /// When there are some that cannot be read.
    fn points(&self) -> Result<Option<Points>, Fault>;

    /// The file or folder that holds a part of the capture, for messages; it need not exist.
    fn part(&self, part: Part) -> PathBuf {
        let _ = part;
        self.root().to_owned()
    }

    /// Number of frames of a split: 0 without views, at most 1 of [`Split::Init`].
    fn frames_of(&self, split: Split) -> usize {
        match split {
            _ if self.views(split).is_empty() => 0,
            Split::Init => self.frames().min(1),
            Split::Train | Split::Test => self.frames(),
        }
    }
}

/// Of what a capture consists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The cameras of a split.
    Cameras(Split),
    /// The images.
    Images,
    /// The foreground masks.
    Masks,
    /// The initial points.
    Points,
}

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

/// One view at one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewAt {
    /// Part of the capture.
    pub split: Split,
    /// Index into [`Capture::views`].
    pub view: usize,
    /// Frame.
    pub frame: usize,
}

/// Coloured points of frame 0, columns of one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Points {
    /// Positions in the world (m), finite.
    pub positions: Vec<[f32; 3]>,
    /// sRGB in 0..=1.
    pub colours: Vec<[f32; 3]>,
    /// Whether the point lies on the dynamic foreground.
    pub foreground: Vec<bool>,
    /// Points left out because a value was NaN or infinite.
    pub dropped: usize,
}

impl Points {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Number of foreground points.
    pub fn foreground_count(&self) -> usize {
        self.foreground.iter().filter(|f| **f).count()
    }

    /// The points without those that lie exactly where an earlier one lies, which tell nothing of the surface and are seldom
    /// meant; and how many these were. A search for neighbours among many points of one place takes quadratic time.
    pub fn distinct(self) -> (Self, usize) {
        let mut taken = HashSet::new();
        let mut kept = Self { dropped: self.dropped, ..Self::default() };
        for (i, position) in self.positions.iter().enumerate() {
            // Zero has two signs.
            if taken.insert(position.map(|v| (v + 0.0).to_bits())) {
                kept.positions.push(*position);
                kept.colours.push(self.colours[i]);
                kept.foreground.push(self.foreground[i]);
            }
        }
        let left_out = self.len() - kept.len();
        (kept, left_out)
    }

    /// Appends a point: x, y, z (m), r, g, b (clamped to 0..=1). One with a value that is NaN or infinite is left out, and counted.
    pub fn push(&mut self, point: [f32; 6], foreground: bool) {
        if !point.iter().all(|v| v.is_finite()) {
            self.dropped += 1;
            return;
        }
        let [x, y, z, r, g, b] = point;
        self.positions.push([x, y, z]);
        self.colours.push([r, g, b].map(|c| c.clamp(0.0, 1.0)));
        self.foreground.push(foreground);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_are_not_finite_are_counted() {
        let mut points = Points::default();
        for x in [0.5, f32::NAN, f32::INFINITY, 1e39_f64 as f32] {
            points.push([x, 0.0, 0.0, 0.5, 0.5, 0.5], true);
        }
        points.push([0.0, 0.0, 0.0, 0.5, f32::NAN, 0.5], false);
        assert_eq!((points.positions.len(), points.dropped), (1, 4));
        assert_eq!(points.colours.len() + points.foreground.len(), 2);
    }

    #[test]
    fn the_first_point_of_each_place_stays() {
        let mut points = Points { dropped: 3, ..Points::default() };
        for (x, red, foreground) in
            [(1.0, 0.1, true), (0.0, 0.2, false), (1.0, 0.3, false), (-0.0, 0.4, true)]
        {
            points.push([x, 0.0, 2.0, red, 0.0, 0.0], foreground);
        }
        let (kept, left_out) = points.distinct();
        assert_eq!((left_out, kept.dropped), (2, 3));
        assert_eq!(kept.positions, [[1.0, 0.0, 2.0], [0.0, 0.0, 2.0]]);
        assert_eq!((kept.colours[1][0], kept.foreground), (0.2, vec![true, false]));
    }
}
