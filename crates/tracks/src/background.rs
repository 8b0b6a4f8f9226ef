//! Cameras that have one pose in all frames, but whose background moves.

use crate::store::TrackStore;
use ffgs_core::ViewMotion;
use ffgs_method::{Capture, Split, ViewAt};
use rayon::prelude::*;

/// Fewer tracks on the background tell nothing.
const LEAST_TRACKS: usize = 20;
/// Motion (px per frame) from which it is told, on any size of image, as trackers err by parts of a pixel. On captures with noise, night and rain, the
/// median of what stands still is up to 0.6.
const MOVES_PX: f32 = 1.5;
/// How far (px, as of [`Mask::widened`](ffgs_core::Mask::widened)) around a mask tracks may still be those of the moving thing.
const AROUND: usize = 5;
/// Steps that are looked at, spread over the frames.
const STEPS: usize = 5;

/// A fixed camera whose picture moves.
#[derive(Clone, Debug, PartialEq)]
pub struct MovingBackground {
    /// Name of the camera.
    pub camera: String,
    /// Median length of the tracks outside the masks (px per frame).
    pub pixels: f32,
}

/// The training cameras whose pose stays, while more than half of the tracks outside the masks move. Without masks all
/// tracks count, so an object that fills most of an image is taken for a background.
pub fn moving_backgrounds(store: &TrackStore, capture: &dyn Capture) -> Vec<MovingBackground> {
    let views = capture.views(Split::Train);
    let judge = |view: usize| {
        if !capture.is_fixed(Split::Train, view).unwrap_or(false) {
            return None;
        }
        let mut lengths: Vec<f32> = steps(capture.frames())
            .into_iter()
            .flat_map(|frame| background_lengths(store, capture, view, frame))
            .collect();
        let middle = lengths.len() / 2;
        if lengths.len() < LEAST_TRACKS {
            return None;
        }
        let pixels = *lengths.select_nth_unstable_by(middle, f32::total_cmp).1;
        (pixels > MOVES_PX).then(|| MovingBackground { camera: views[view].clone(), pixels })
    };
    (0..views.len()).into_par_iter().filter_map(judge).collect()
}

fn steps(frames: usize) -> Vec<usize> {
    let count = STEPS.min(frames.saturating_sub(1));
    (0..count).map(|i| 1 + i * (frames - 1) / count).collect()
}

/// Lengths of the tracks of all sparse and medium trackers that start outside the mask.
fn background_lengths(store: &TrackStore, capture: &dyn Capture, view: usize, frame: usize) -> Vec<f32> {
    let at = |frame| ViewAt { split: Split::Train, view, frame };
    let Ok(camera) = capture.camera(at(frame)) else { return Vec::new() };
    let mask = capture.mask(at(frame - 1)).ok().flatten().map(|m| m.widened(AROUND));
    let size = camera.size();
    let is_background = |p: [f32; 2]| {
        let inside = p[0] >= 0.0 && p[1] >= 0.0 && p[0] < size.width as f32 && p[1] < size.height as f32;
        inside && mask.as_ref().is_none_or(|m| !m.contains(p[0] as usize, p[1] as usize))
    };
    let mut lengths = Vec::new();
    for tracker in 0..store.trackers().len() {
        let loaded = store.load(tracker, &capture.views(Split::Train)[view], frame, size);
        let Ok(Some(tracked)) = loaded else { continue };
        let ViewMotion::Tracks(tracks) = tracked.motion else { continue };
        let ends = tracks.src.iter().zip(&tracks.tgt).filter(|(src, _)| is_background(**src));
        lengths.extend(ends.map(|(src, tgt)| (tgt[0] - src[0]).hypot(tgt[1] - src[1])));
    }
    lengths
}
