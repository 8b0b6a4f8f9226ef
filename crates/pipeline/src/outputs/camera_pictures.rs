//! What the program believes of a camera: its photograph with the mask's outline, initial points and tracks drawn on it.

use crate::outputs::folder::RunFolder;
use crate::outputs::json::write_json;
use anyhow::Result;
use ffgs_core::{ImageRgb8, ImageSize, Mask, TrainingView, ViewMotion, is_present};
use ffgs_method::{Capture, Points, Split, ViewAt};
use ffgs_reconstruction::FirstViews;
use ffgs_report::{CameraPicture, CameraPictures, Thumbnails};
use ffgs_tracks::TrackStore;
use rayon::prelude::*;

/// Pictures in a report, at most: of more cameras every n-th is shown.
const MOST_CAMERAS: usize = 96;
/// Each before it becomes text: four megabytes of the report at most.
const MOST_BYTES: usize = 30_000;
/// Width of a picture in a report, at least (px).
const REPORT_WIDTH: usize = 480;
/// Initial points and tracks that are drawn, at most.
const POINTS: usize = 3000;
const TRACKS: usize = 1500;

const OUTLINE: [u8; 3] = [255, 0, 255];
const BACKGROUND: [u8; 3] = [0, 200, 0];
const FOREGROUND: [u8; 3] = [255, 220, 0];
const TRACK: [u8; 3] = [0, 220, 255];
const TRACK_END: [u8; 3] = [255, 60, 0];

/// Draws and encodes what was loaded of the training views in a run's first frame, for its report.
///
/// # Errors
/// When points or tracks cannot be read or the file not be written.
pub(crate) fn write_camera_pictures(
    folder: &RunFolder,
    capture: &dyn Capture,
    photographs: &FirstViews,
) -> Result<()> {
    let believed = Believed::of(capture)?;
    let thumbnails = Thumbnails::of_bytes(MOST_BYTES);
    let draw = |(at, view): &(&ViewAt, &TrainingView)| -> Result<CameraPicture> {
        let picture = thumbnails.encode(&believed.draw(**at, view, REPORT_WIDTH))?;
        Ok(CameraPicture { name: capture.views(at.split)[at.view].clone(), picture })
    };
    let all = photographs.shots.iter().zip(&photographs.views);
    let training: Vec<_> = all.filter(|(at, _)| at.split == Split::Train).collect();
    let shown: Vec<_> = training.iter().step_by(training.len().div_ceil(MOST_CAMERAS).max(1)).collect();
    let cameras = shown.into_par_iter().map(draw).collect::<Result<Vec<_>>>()?;
    let frame = photographs.shots.first().map_or(0, |at| at.frame);
    write_json(&folder.cameras(), &CameraPictures { frame, cameras })
}

/// A capture with what is drawn on its photographs.
pub(crate) struct Believed<'a> {
    capture: &'a dyn Capture,
    tracks: Option<TrackStore>,
    points: Points,
}

impl<'a> Believed<'a> {
    /// Reads the initial points and the list of trackers.
    ///
    /// # Errors
    /// When one of them cannot be read.
    pub(crate) fn of(capture: &'a dyn Capture) -> Result<Self> {
        let (tracks, points) = (TrackStore::of(capture)?, capture.points()?.unwrap_or_default());
        Ok(Self { capture, tracks, points })
    }

    /// The photograph of the training view `at` with the mask's outline (magenta), initial points (green, those on the foreground
    /// yellow), and the sparse and medium tracks to the next frame (light blue, ending in red). Small photographs are enlarged by
    /// a whole factor to at least `width` pixels.
    pub(crate) fn draw(&self, at: ViewAt, view: &TrainingView, width: usize) -> ImageRgb8 {
        let mut canvas = Canvas::new(&view.image, width);
        let step = self.points.len().div_ceil(POINTS).max(1);
        for (position, foreground) in self.points.positions.iter().zip(&self.points.foreground).step_by(step)
        {
            if let Some(seen) = view.camera.project(position.map(f64::from).into()) {
                let colour = if *foreground { FOREGROUND } else { BACKGROUND };
                canvas.dot([seen.pixel.x as f32, seen.pixel.y as f32], colour);
            }
        }
        canvas.outline(&view.mask);
        for (src, tgt) in self.tracks_of(at, view.camera.size()) {
            canvas.line(src, tgt, TRACK);
            canvas.dot(tgt, TRACK_END);
        }
        canvas.into_image()
    }

    /// Of the trackers that give correspondences, to the next frame.
    fn tracks_of(&self, at: ViewAt, size: ImageSize) -> Vec<([f32; 2], [f32; 2])> {
        let mut all = Vec::new();
        let (name, next) = (&self.capture.views(Split::Train)[at.view], at.frame + 1);
        let Some(store) = self.tracks.as_ref().filter(|_| next < self.capture.frames()) else { return all };
        let sparse = |&tracker: &usize| !store.trackers()[tracker].format.is_dense();
        for tracker in (0..store.trackers().len()).filter(sparse) {
            // Faults of the files are listed by the check.
            if !store.path(tracker, name, next).is_ok_and(|file| is_present(&file)) {
                continue;
            }
            if let Ok(Some(tracked)) = store.load(tracker, name, next, size)
                && let ViewMotion::Tracks(tracks) = tracked.motion
            {
                all.extend(tracks.src.into_iter().zip(tracks.tgt));
            }
        }
        let step = all.len().div_ceil(TRACKS).max(1);
        all.into_iter().step_by(step).collect()
    }
}

/// An enlarged image that is drawn on in the pixels of the image.
struct Canvas {
    size: ImageSize,
    factor: usize,
    data: Vec<u8>,
}

impl Canvas {
    fn new(image: &ImageRgb8, width: usize) -> Self {
        let from = image.size();
        let factor = width.div_ceil(from.width).max(1);
        let size = ImageSize { width: from.width * factor, height: from.height * factor };
        let source = |i: usize| (i / size.width / factor) * from.width + i % size.width / factor;
        // Darker, so that what is drawn stands out.
        let dim = |v: u8| (u16::from(v) * 2 / 3) as u8;
        let data = (0..size.pixels()).flat_map(|i| {
            let p = 3 * source(i);
            [image.data()[p], image.data()[p + 1], image.data()[p + 2]].map(dim)
        });
        Self { size, factor, data: data.collect() }
    }

    fn set(&mut self, x: isize, y: isize, colour: [u8; 3]) {
        let (width, height) = (self.size.width as isize, self.size.height as isize);
        if (0..width).contains(&x) && (0..height).contains(&y) {
            let at = 3 * (y * width + x) as usize;
            self.data[at..at + 3].copy_from_slice(&colour);
        }
    }

    /// Two by two pixels of the canvas.
    fn dot(&mut self, at: [f32; 2], colour: [u8; 3]) {
        let [x, y] = at.map(|v| (v * self.factor as f32).floor().clamp(-1e6, 1e6) as isize);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            self.set(x + dx, y + dy, colour);
        }
    }

    fn line(&mut self, from: [f32; 2], to: [f32; 2], colour: [u8; 3]) {
        let scale = self.factor as f32;
        let (dx, dy) = ((to[0] - from[0]) * scale, (to[1] - from[1]) * scale);
        let steps = dx.abs().max(dy.abs()).clamp(1.0, 1e4).ceil();
        for i in 0..=steps as usize {
            let part = i as f32 / steps;
            let (x, y) = (from[0] * scale + part * dx, from[1] * scale + part * dy);
            self.set(x.floor() as isize, y.floor() as isize, colour);
        }
    }

    /// Foreground pixels with a neighbour that is none.
    fn outline(&mut self, mask: &Mask) {
        let (width, height) = (mask.size().width, mask.size().height);
        for y in 0..self.size.height {
            for x in 0..self.size.width {
                let inside = |x: usize, y: usize| {
                    let (u, v) = (x / self.factor, y / self.factor);
                    u < width && v < height && mask.contains(u, v)
                };
                let edge = inside(x, y)
                    && !(x > 0
                        && y > 0
                        && inside(x - 1, y)
                        && inside(x + 1, y)
                        && inside(x, y - 1)
                        && inside(x, y + 1));
                if edge {
                    self.set(x as isize, y as isize, OUTLINE);
                }
            }
        }
    }

    fn into_image(self) -> ImageRgb8 {
        ImageRgb8::new(self.size, self.data).expect("three values per pixel")
    }
}
