//! `ffgs check --pictures`: a picture per training camera, with what the program believes of its first frame.

use crate::outputs::scoring::write_png;
use crate::plugins::registry::open_capture;
use anyhow::{Context, Result};
use ffgs_core::{ImageRgb8, ImageSize, Mask, ViewMotion, is_present};
use ffgs_method::{Capture, Points, Split, ViewAt};
use ffgs_tracks::TrackStore;
use rayon::prelude::*;
use std::path::Path;

/// Small images are enlarged by a whole factor to at least this width (px).
const WIDTH: usize = 960;
/// Initial points and tracks that are drawn, at most.
const POINTS: usize = 3000;
const TRACKS: usize = 1500;

const OUTLINE: [u8; 3] = [255, 0, 255];
const BACKGROUND: [u8; 3] = [0, 200, 0];
const FOREGROUND: [u8; 3] = [255, 220, 0];
const TRACK: [u8; 3] = [0, 220, 255];
const TRACK_END: [u8; 3] = [255, 60, 0];

/// Writes `CAMERA.png` for every training camera: image, outline of the mask (magenta), initial points (green, those on
/// the foreground yellow), and the sparse and medium tracks to frame 1 (light blue, ending in red). Returns their number.
///
/// # Errors
/// When the capture cannot be read or the folder not be written.
pub(crate) fn write(root: &Path, folder: &Path) -> Result<usize> {
    let capture = open_capture(root)?;
    let store = TrackStore::of(&*capture)?;
    let points = capture.points()?.unwrap_or_default();
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let views = capture.views(Split::Train);
    let one = |view: usize| -> Result<()> {
        let picture = picture(&*capture, store.as_ref(), &points, view)?;
        write_png(&folder.join(format!("{}.png", views[view])), &picture)
    };
    (0..views.len()).into_par_iter().try_for_each(one)?;
    Ok(views.len())
}

fn picture(
    capture: &dyn Capture,
    store: Option<&TrackStore>,
    points: &Points,
    view: usize,
) -> Result<ImageRgb8> {
    let at = ViewAt { split: Split::Train, view, frame: 0 };
    let camera = capture.camera(at)?;
    let mut canvas = Canvas::new(&capture.image(at)?);
    let step = points.len().div_ceil(POINTS).max(1);
    for (position, foreground) in points.positions.iter().zip(&points.foreground).step_by(step) {
        if let Some(seen) = camera.project(position.map(f64::from).into()) {
            let colour = if *foreground { FOREGROUND } else { BACKGROUND };
            canvas.dot([seen.pixel.x as f32, seen.pixel.y as f32], colour);
        }
    }
    if let Some(mask) = capture.mask(at)? {
        canvas.outline(&mask);
    }
    for (src, tgt) in store.map_or_else(|| Ok(Vec::new()), |store| tracks(capture, store, view))? {
        canvas.line(src, tgt, TRACK);
        canvas.dot(tgt, TRACK_END);
    }
    Ok(canvas.into_image())
}

type Track = ([f32; 2], [f32; 2]);

/// Of the trackers that give correspondences, from frame 0 to 1.
fn tracks(capture: &dyn Capture, store: &TrackStore, view: usize) -> Result<Vec<Track>> {
    let mut all = Vec::new();
    if capture.frames() < 2 {
        return Ok(all);
    }
    let name = &capture.views(Split::Train)[view];
    let size = capture.camera(ViewAt { split: Split::Train, view, frame: 0 })?.size();
    for tracker in 0..store.trackers().len() {
        // Faults of the files are listed by the check.
        if !store.path(tracker, name, 1).is_ok_and(|file| is_present(&file)) {
            continue;
        }
        if let Ok(Some(tracked)) = store.load(tracker, name, 1, size)
            && let ViewMotion::Tracks(tracks) = tracked.motion
        {
            all.extend(tracks.src.into_iter().zip(tracks.tgt));
        }
    }
    let step = all.len().div_ceil(TRACKS).max(1);
    Ok(all.into_iter().step_by(step).collect())
}

/// An enlarged image that is drawn on in the pixels of the image.
struct Canvas {
    size: ImageSize,
    factor: usize,
    data: Vec<u8>,
}

impl Canvas {
    fn new(image: &ImageRgb8) -> Self {
        let from = image.size();
        let factor = WIDTH.div_ceil(from.width).max(1);
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
