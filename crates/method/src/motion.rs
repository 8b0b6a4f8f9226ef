//! Methods: how the scene of t-1 becomes that of t.

use crate::{Capture, TrackSource, ViewStep};
use anyhow::Result;
use ffgs_core::{Scene, StageLog, TrainingView};
use std::path::{Path, PathBuf};

/// Carries a scene from frame to frame. It owns what it must remember, and may train in its own way.
///
/// The order of calls: [`begin`](Self::begin) once with the first frame, then for every further frame
/// [`predict`](Self::predict), [`finetune`](Self::finetune), [`store`](Self::store), [`save`](Self::save). A run that
/// was stopped calls [`restore`](Self::restore) instead of `begin`, and must end with the same result.
pub trait MotionMethod: Send {
    /// Takes note of the first frame.
    ///
    /// # Errors
    /// When the scene cannot be handled.
    fn begin(&mut self, first: &Scene) -> Result<()> {
        let _ = first;
        Ok(())
    }

    /// Where the scene is at t, as far as it is known before training: moves, adds and removes Gaussians. The PSNR
    /// after it measures the motion initialisation. `scene.dynamic.steps` says how far each Gaussian came.
    ///
    /// # Errors
    /// When the input as a whole cannot be used. A Gaussian or view that fails is counted in `log`.
    fn predict(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<()>;

    /// Whether, before the lanes of the trainer begin, moving Gaussians are to be born where the masks are not explained.
    fn births(&self) -> bool {
        false
    }

    /// Whether its own training computes on the CPU whatever the device: its parameters are not those of Gaussians, or its loss is
    /// not photometric alone (docs/adr/0036).
    fn trains_on_cpu(&self) -> bool {
        false
    }

    /// Fits the scene to the photographs of t, with own losses and an own schedule. By default the method leaves that to
    /// the lanes of the trainer.
    ///
    /// # Errors
    /// As [`predict`](Self::predict).
    fn finetune(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<Finetuning> {
        let _ = (step, scene, log);
        Ok(Finetuning::ByLanes)
    }

    /// Writes the frame in the method's own form, where it has one that is smaller than the splats; the files count as
    /// the frame's storage.
    ///
    /// # Errors
    /// When a file cannot be written.
    fn store(&self, scene: &Scene, folder: &Path) -> Result<Vec<PathBuf>> {
        let _ = (scene, folder);
        Ok(Vec::new())
    }

    /// All that the next frame needs beside the scene, in a form that [`restore`](Self::restore) reads; empty = nothing.
    fn save(&self) -> Vec<u8> {
        Vec::new()
    }

    /// Takes back what [`save`](Self::save) gave after the last finished frame, whose scene is `scene`.
    ///
    /// # Errors
    /// When the bytes are not of this method.
    fn restore(&mut self, state: &[u8], scene: &Scene) -> Result<()> {
        let _ = (state, scene);
        Ok(())
    }
}

/// What fits the scene to the photographs of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finetuning {
    /// The lanes of the trainer, from where the prediction ended.
    ByLanes,
    /// The method has done it.
    Done,
}

/// One step in time, from t-1 to t. Views keep their order over the run.
#[derive(Clone, Copy)]
pub struct Step<'a> {
    /// t, at least 1.
    pub frame: usize,
    /// Seed of the run.
    pub seed: u64,
    /// The capture.
    pub capture: &'a dyn Capture,
    /// Training views used, as indices into the capture's training split.
    pub views: &'a [usize],
    /// These views at t-1.
    pub before: &'a [TrainingView],
    /// These views at t.
    pub now: &'a [TrainingView],
    /// The views at t-1 and at t, their pixels as large as the splats of the moving layer allow ([`TrainingView::all_reduced`],
    /// docs/adr/0054): for comparisons with that layer.
    pub reduced: [&'a [TrainingView]; 2],
    /// The capture's trackers.
    pub tracks: &'a [Box<dyn TrackSource>],
}

impl<'a> Step<'a> {
    /// What a tracker is asked about the `i`-th view used.
    pub fn of_view(&self, i: usize) -> ViewStep<'a> {
        let size = self.before[i].camera.size();
        ViewStep { capture: self.capture, view: self.views[i], frame: self.frame, size }
    }
}
