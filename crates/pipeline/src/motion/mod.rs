//! Motion initialisation of one frame: Algorithm 1, lines 3 to 42, a file for each stage.

mod densify;
mod fields;
mod fuse;
mod observe;
mod on_gpu;
mod triangulate;
mod validate;
mod withdraw;

pub use fuse::pixel_sizes;
pub use observe::observe;

use crate::cli::Init;
use crate::config::Config;
use crate::frame::TrainViews;
use anyhow::Result;
use ffgs_core::{Camera, Dynamic, Estimates, Gaussians, Observations, TrainingView};
use ffgs_gpu::Gpu;
use ffgs_report::StageSeconds;
use ffgs_tracks::TrackStore;
use glam::DVec3;
use std::collections::BTreeMap;
use std::time::Instant;

/// What a frame's initialisation needs besides the layer itself.
pub struct MotionInput<'a> {
    /// Configuration.
    pub config: &'a Config,
    /// Trackers.
    pub init: &'a Init,
    /// Track files; `None` when the capture has none.
    pub tracks: Option<&'a TrackStore>,
    /// Views used.
    pub views: &'a TrainViews,
    /// Training views at t - 1.
    pub before: &'a [TrainingView],
    /// Training views at t.
    pub now: &'a [TrainingView],
    /// t.
    pub frame: usize,
    /// The static layer, which hides parts of the dynamic one.
    pub static_layer: &'a Gaussians,
    /// Where motion fields and association are computed; `None` = the CPU.
    pub gpu: Option<&'a Gpu>,
}

/// Counts and pictures' data of one frame's initialisation.
#[derive(Clone, Debug, Default)]
pub struct MotionOutcome {
    /// Seconds a stage.
    pub seconds: StageSeconds,
    /// Counted skips: what, how often.
    pub skips: BTreeMap<String, u64>,
    /// Warnings.
    pub warnings: Vec<String>,
    /// Positions at t - 1 of the Gaussians that are left (m).
    pub previous: Vec<DVec3>,
}

impl MotionOutcome {
    fn skip(&mut self, what: String, count: usize) {
        if count > 0 {
            *self.skips.entry(what).or_default() += count as u64;
        }
    }
}

fn add_seconds(total: &mut Option<f64>, since: Instant) {
    *total = Some(total.unwrap_or(0.0) + since.elapsed().as_secs_f64());
}

/// Moves `dynamic` from t - 1 to t, removes what left the masks, and splits where the position is uncertain.
pub fn initialise(input: &MotionInput, dynamic: &mut Dynamic) -> Result<MotionOutcome> {
    let mut outcome = MotionOutcome { previous: dynamic.gaussians.positions(), ..MotionOutcome::default() };
    if *input.init == Init::None || dynamic.gaussians.is_empty() {
        return Ok(outcome);
    }
    let mut observations = match on_gpu::device(input, &mut outcome) {
        Some(gpu) => on_gpu::observe(gpu, input, &dynamic.gaussians, &mut outcome)?,
        None => observe(input, &dynamic.gaussians, &mut outcome, &mut |_, _| {})?,
    };
    move_by(input, &mut observations, dynamic, &mut outcome)?;
    validate::validate_positions(input, dynamic, &mut outcome)?;
    densify::densify(input, dynamic, &mut outcome);
    Ok(outcome)
}

/// Lines 20 to 34: from what the trackers saw to the places at t. Returns every tracker's estimates.
pub fn move_by(
    input: &MotionInput,
    observations: &mut [Observations],
    dynamic: &mut Dynamic,
    outcome: &mut MotionOutcome,
) -> Result<Vec<Estimates>> {
    if input.config.association.withdraw_unseen {
        let expected = expected_places(input, observations, dynamic, outcome)?;
        let cameras: Vec<Camera> = input.now.iter().map(|view| view.camera).collect();
        let withdrawn = withdraw::withdraw(&cameras, &expected, observations);
        outcome.skip("observations withdrawn: the place at t lies outside the image".into(), withdrawn);
    }
    let estimates = triangulate::triangulate(input, observations, outcome)?;
    let fused = fuse::fuse(input, &estimates, dynamic, outcome)?;
    fuse::apply(input, fused, dynamic, outcome);
    Ok(estimates)
}

/// Where the last steps lead; without any, where all observations together do.
fn expected_places(
    input: &MotionInput,
    observations: &[Observations],
    dynamic: &Dynamic,
    outcome: &mut MotionOutcome,
) -> Result<Vec<DVec3>> {
    if let Some(steps) = dynamic.known_steps() {
        return Ok(outcome.previous.iter().zip(steps).map(|(place, step)| *place + *step).collect());
    }
    // A rehearsal: what it skips is not counted, what it takes is.
    let mut rehearsal = MotionOutcome { previous: outcome.previous.clone(), ..MotionOutcome::default() };
    std::mem::swap(&mut rehearsal.seconds, &mut outcome.seconds);
    let estimates = triangulate::triangulate(input, observations, &mut rehearsal)?;
    let fused = fuse::fuse(input, &estimates, dynamic, &mut rehearsal)?;
    outcome.seconds = rehearsal.seconds;
    Ok(fused.means)
}
