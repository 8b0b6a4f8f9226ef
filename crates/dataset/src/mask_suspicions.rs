//! What masks give away when they are compared: over time, and between views.

use crate::outlines::{Outline, Watched, offsets};
use crate::report::Note;
use ffgs_core::{Camera, Mask};
use ffgs_method::{Capture, Part, Points, Split, ViewAt};
use glam::DVec2;
use rayon::prelude::*;

/// A mask flickers when it covers less than its two neighbours by this factor, or more. A car that enters at full speed stays
/// below 1.5.
const FLICKER: f64 = 2.5;
/// Masks below this part of the image are not compared: they have few pixels.
const TINY: f64 = 0.002;
/// Brightness from one frame to the next may change by this factor before it is told.
const EXPOSURE_STEP: f64 = 1.15;
/// Part of a camera's foreground that no place in space explains, from which it is told.
const UNEXPLAINED: f64 = 0.5;
/// One in so many of the views that see a place may miss it in its mask: something may stand in front.
const HIDDEN_IN: usize = 4;
/// Pixels of a mask that are tried, places along the ray of each, and how far (px, as of [`Mask::widened`]) a mask is widened.
const PIXELS: usize = 150;
const PLACES: usize = 96;
const WIDENED: usize = 3;

/// What is kept of every frame of a training view.
#[derive(Clone, Debug, Default)]
pub(crate) struct ViewHistory {
    /// Foreground pixels; `None` without a mask.
    pub areas: Vec<Option<usize>>,
    /// Mean of the image; 0 when it was not decoded.
    pub brightness: Vec<f64>,
    /// Outlines of the masks.
    pub outlines: Vec<Outline>,
}

/// Notes on the training views; `histories` are theirs.
pub(crate) fn find(capture: &dyn Capture, points: &Points, histories: &[ViewHistory]) -> Vec<Note> {
    let mut notes = Vec::new();
    for (view, history) in histories.iter().enumerate() {
        notes.extend(flicker(capture, view, history));
        notes.extend(exposure_steps(capture, view, history));
    }
    notes.extend(clocks(capture, histories));
    notes.extend(disagreement(capture, points, histories));
    notes
}

fn camera(capture: &dyn Capture, view: usize, frame: usize) -> Option<Camera> {
    capture.camera(ViewAt { split: Split::Train, view, frame }).ok()
}

fn listed(frames: &[usize]) -> String {
    const SHOWN: usize = 5;
    let names: Vec<String> = frames.iter().take(SHOWN).map(ToString::to_string).collect();
    let more = if frames.len() > SHOWN { ", …" } else { "" };
    format!("{}{more}", names.join(", "))
}

fn flicker(capture: &dyn Capture, view: usize, history: &ViewHistory) -> Option<Note> {
    let pixels = camera(capture, view, 0)?.size().pixels() as f64;
    let flickers = |w: &[Option<usize>]| -> Option<bool> {
        let [before, now, after] = [w[0]?, w[1]?, w[2]?].map(|a| (a as f64).max(1.0));
        let (low, high) = (before.min(after), before.max(after).max(TINY * pixels));
        Some((low > TINY * pixels && low > FLICKER * now) || now > FLICKER * high)
    };
    let frames: Vec<usize> = (1..history.areas.len().saturating_sub(1))
        .filter(|t| flickers(&history.areas[t - 1..=t + 1]) == Some(true))
        .collect();
    (!frames.is_empty()).then(|| Note {
        file: capture.part(Part::Masks).join(&capture.views(Split::Train)[view]),
        text: format!(
            "masks flicker: much smaller or larger than before and after in frame {}",
            listed(&frames)
        ),
    })
}

fn exposure_steps(capture: &dyn Capture, view: usize, history: &ViewHistory) -> Option<Note> {
    let step = |t: &usize| {
        let (a, b) = (history.brightness[t - 1], history.brightness[*t]);
        a > 0.0 && b > 0.0 && (a / b).max(b / a) > EXPOSURE_STEP
    };
    let frames: Vec<usize> = (1..history.brightness.len()).filter(step).collect();
    (!frames.is_empty()).then(|| Note {
        file: capture.part(Part::Images).join(&capture.views(Split::Train)[view]),
        text: format!(
            "exposure changes from one frame to the next at frame {}; ffgs run follows it",
            listed(&frames)
        ),
    })
}

/// Fixed cameras whose frames belong to other moments than those of the others.
fn clocks(capture: &dyn Capture, histories: &[ViewHistory]) -> Vec<Note> {
    let (mut views, mut watched) = (Vec::new(), Vec::new());
    for (view, history) in histories.iter().enumerate() {
        if let Some(camera) = camera(capture, view, 0)
            && capture.is_fixed(Split::Train, view).unwrap_or(false)
            && history.outlines.len() == capture.frames()
        {
            views.push(view);
            watched.push(Watched { camera, outlines: history.outlines.clone() });
        }
    }
    let note = |(view, offset): (usize, isize)| {
        let name = &capture.views(Split::Train)[view];
        let (frames, side) = (offset.abs(), if offset > 0 { "later" } else { "earlier" });
        Note {
            file: capture.part(Part::Images).join(name),
            text: format!(
                "not synchronised: the outlines of its masks fit those of the other cameras {frames} frame{} {side} \
                 (ffgs prepare --offset {name}={})",
                if frames == 1 { "" } else { "s" },
                -offset
            ),
        }
    };
    views.into_iter().zip(offsets(&watched)).filter(|(_, offset)| *offset != 0).map(note).collect()
}

/// Cameras most of whose foreground meets no place that the other masks agree on: outside of their visual hull.
fn disagreement(capture: &dyn Capture, points: &Points, histories: &[ViewHistory]) -> Vec<Note> {
    let frames = capture.frames();
    let mut sums = vec![(0.0, 0_usize); histories.len()];
    let mut tried = vec![0, frames / 2, frames.saturating_sub(1)];
    tried.dedup();
    for frame in tried {
        for (sum, part) in sums.iter_mut().zip(unexplained(capture, points, histories.len(), frame)) {
            if let Some(part) = part {
                *sum = (sum.0 + part, sum.1 + 1);
            }
        }
    }
    let note = |(view, part): (usize, f64)| Note {
        file: capture.part(Part::Masks).join(&capture.views(Split::Train)[view]),
        text: format!(
            "{:.0} % of the foreground lies where the masks of the other cameras have none \
             (wrong masks, a wrong pose, or images that are upside down)",
            part * 100.0
        ),
    };
    let means = sums.into_iter().map(|(sum, count)| sum / count.max(1) as f64).enumerate();
    means.filter(|(_, part)| *part > UNEXPLAINED).map(note).collect()
}

struct Seen {
    camera: Camera,
    mask: Mask,
    wide: Mask,
}

/// Per view the part of its foreground that no place explains; `None` where nothing can be said.
fn unexplained(capture: &dyn Capture, points: &Points, views: usize, frame: usize) -> Vec<Option<f64>> {
    let load = |view| {
        let at = ViewAt { split: Split::Train, view, frame };
        let (camera, mask) = (capture.camera(at).ok()?, capture.mask(at).ok()??);
        let wide = mask.widened(WIDENED);
        Some(Seen { camera, mask, wide })
    };
    let seen: Vec<Option<Seen>> = (0..views).into_par_iter().map(load).collect();
    (0..views).into_par_iter().map(|view| unexplained_part(&seen, view, points)).collect()
}

fn unexplained_part(all: &[Option<Seen>], view: usize, points: &Points) -> Option<f64> {
    let own = all[view].as_ref()?;
    let (near, far) = distances(&own.camera, points)?;
    let width = own.mask.size().width;
    let foreground: Vec<usize> = (0..own.mask.data().len()).filter(|i| own.mask.data()[*i] != 0).collect();
    let (mut explained, mut judged) = (0_usize, 0_usize);
    for i in foreground.iter().step_by(foreground.len().div_ceil(PIXELS).max(1)) {
        let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let ray = own.camera.ray(pixel).normalize();
        let place = |k: usize| {
            let distance = near * (far / near).powf((k as f64 + 0.5) / PLACES as f64);
            own.camera.center() + ray * distance
        };
        let votes = (0..PLACES).filter_map(|k| agrees(all, view, place(k)));
        if let Some(best) = votes.max() {
            judged += 1;
            explained += usize::from(best);
        }
    }
    (judged > 0).then(|| 1.0 - explained as f64 / judged as f64)
}

/// Whether the other views have foreground at a place; `None` when fewer than two see it.
fn agrees(all: &[Option<Seen>], view: usize, place: glam::DVec3) -> Option<bool> {
    let others = all.iter().enumerate().filter(|(v, _)| *v != view).filter_map(|(_, s)| s.as_ref());
    let votes = others.filter_map(|s| s.camera.pixel_of(place).map(|(x, y)| s.wide.contains(x, y)));
    let (mut seen, mut inside) = (0, 0);
    for vote in votes {
        seen += 1;
        inside += usize::from(vote);
    }
    (seen >= 2).then(|| inside + seen / HIDDEN_IN >= seen && inside > 0)
}

/// Distances of the scene from a camera: where the initial points are, and half and twice that.
fn distances(camera: &Camera, points: &Points) -> Option<(f64, f64)> {
    let step = points.len().div_ceil(2000).max(1);
    let mut all: Vec<f64> = points
        .positions
        .iter()
        .step_by(step)
        .filter_map(|p| {
            let p = p.map(f64::from).into();
            camera.pixel_of(p).map(|_| camera.center().distance(p))
        })
        .collect();
    all.sort_by(f64::total_cmp);
    let (near, far) = (*all.get(all.len() / 50)?, *all.get(all.len() - 1 - all.len() / 50)?);
    (near > 0.0).then_some((0.5 * near, 2.0 * far))
}
