//! Static Gaussians that are not drawn in a frame: something that moves covers them, or shows behind them.

use crate::covered::covered;
use crate::denied::denied;
use crate::lanes::union;
use crate::reconstructor::{Reconstructor, State};
use crate::shown::shown;
use anyhow::Result;
use ffgs_core::{Scene, StageLog, TrainingView, stage};
use std::time::Instant;

/// Indices, ascending.
#[derive(Clone, Debug, Default)]
pub(crate) struct LeftOut {
    /// Of all static Gaussians that are not drawn.
    pub all: Vec<u32>,
    /// Of those that stand before what moves.
    pub denied: Vec<u32>,
}

impl Reconstructor<'_> {
    /// The static Gaussians that are not drawn at t.
    pub(crate) fn find_left_out(
        &self,
        scene: &Scene,
        now: &[TrainingView],
        log: &mut StageLog,
    ) -> Result<LeftOut> {
        let start = Instant::now();
        let (marking, moving) = (&self.config.marking, &scene.dynamic.gaussians);
        let mut left_out = LeftOut::default();
        if marking.covering_alpha > 0.0 && self.method.births() && !moving.is_empty() {
            let shown = shown(marking, moving, now);
            let denied = denied(marking, scene, now, &shown);
            let covered = covered(marking, scene, now, &shown)?;
            log.skip("static Gaussians not drawn as what moves covers them", covered.len());
            log.skip("static Gaussians not drawn as they stand before what moves", denied.len());
            left_out = LeftOut { all: union(&covered, &denied), denied };
        }
        log.since(stage::VALIDATION, start);
        Ok(left_out)
    }

    /// In the rounds in which the static layer may change its shape, those that stand before what moves stay out for good.
    pub(crate) fn remove_denied(&self, frame: usize, state: &mut State, denied: &[u32], log: &mut StageLog) {
        if denied.is_empty() || !frame.is_multiple_of(self.config.disocclusion.every) {
            return;
        }
        let places: Vec<usize> = denied.iter().map(|&i| i as usize).collect();
        state.scene.keep(&places);
        state.static_lane.forget();
        log.change("stood before what moves", denied.len());
    }
}
