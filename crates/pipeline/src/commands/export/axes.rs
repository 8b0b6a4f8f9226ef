//! What every export asks of a run: its frames, and how its capture stands in the world.

use crate::job::request::FrameRange;
use crate::outputs::finished_run::FinishedRun;
use anyhow::{Result, ensure};
use ffgs_core::{counted, up};
use ffgs_method::{Capture, Split, ViewAt};
use glam::{DVec3, Vec3};

/// The finished frames in a range.
pub(crate) fn chosen(run: &FinishedRun, range: Option<FrameRange>) -> Result<Vec<usize>> {
    let frames = inside(&run.frames, range);
    ensure!(!frames.is_empty(), "--frames: none of them is finished; this run has {:?}", run.frames);
    Ok(frames)
}

/// Says how many finished frames in a range cannot be exported.
pub(crate) fn tell_of_thinned(run: &FinishedRun, range: Option<FrameRange>) {
    let missing = inside(&run.thinned, range).len();
    if missing > 0 {
        let frames = counted(missing, "frame");
        tracing::warn!("left out: {frames} whose Gaussians were not kept (--keep of the run)");
    }
}

fn inside(frames: &[usize], range: Option<FrameRange>) -> Vec<usize> {
    let range = range.unwrap_or_default();
    let inside = |f: &usize| *f >= range.start && range.end.is_none_or(|end| *f < end);
    frames.iter().copied().filter(inside).collect()
}

/// How a capture stands in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axes {
    /// Against gravity, as far as the cameras tell.
    pub up: Vec3,
    /// Where the first training camera looks, at right angles to `up`.
    pub forward: Vec3,
}

impl Axes {
    /// Of the training cameras of a frame.
    pub(crate) fn of(capture: &dyn Capture, frame: usize) -> Result<Self> {
        let views = capture.views(Split::Train).len();
        let cameras = (0..views)
            .map(|view| capture.camera(ViewAt { split: Split::Train, view, frame }))
            .collect::<Result<Vec<_>, _>>()?;
        let up = up(&cameras);
        let ahead = cameras.first().map_or(DVec3::X, |c| c.rotation().row(2));
        let forward = ahead.reject_from_normalized(up).normalize_or(up.any_orthonormal_vector());
        Ok(Self { up: up.as_vec3(), forward: forward.as_vec3() })
    }
}
