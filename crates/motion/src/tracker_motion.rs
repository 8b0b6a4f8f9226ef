//! The paper's method: the sequence from observations to the fused, validated and grown dynamic layer.

use crate::alignment::{align_groups, departure_odds};
use crate::fuse::{FusionColumns, apply};
use crate::{MotionConfig, MotionInput, growth, observe, on_gpu, triangulate, validate, withdraw};
use anyhow::Result;
use ffgs_core::{Camera, Dynamic, Estimates, Observations, Scene, StageLog, stage};
use ffgs_fusion::{Fused, InformationFuser};
use ffgs_method::{MotionMethod, Step, TrackSource};
use ffgs_rasterizer_gpu::SceneDevice;
use glam::DVec3;
use std::time::Instant;

/// Moves the dynamic layer by what the trackers saw: by all of them fused, or by one alone.
pub struct TrackerMotion<'a> {
    /// Settings of the stages.
    pub config: MotionConfig,
    /// The one tracker that is used, by name; `None` = all.
    pub only: Option<String>,
    /// Where motion fields and association are computed; `None` = the CPU.
    pub gpu: Option<&'a SceneDevice>,
}

impl MotionMethod for TrackerMotion<'_> {
    /// Moves the layer from t - 1 to t, removes what left the masks, and splits where the position is uncertain.
    fn predict(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<()> {
        let Scene { static_layer, dynamic, .. } = scene;
        if dynamic.gaussians.is_empty() {
            return Ok(());
        }
        let previous = dynamic.gaussians.positions();
        let input = MotionInput {
            config: &self.config,
            step: *step,
            trackers: self.trackers(step, log),
            static_layer,
            previous: &previous,
            gpu: self.gpu,
        };
        let mut observations = match on_gpu::device(&input, log) {
            Some(gpu) => on_gpu::observe(gpu, &input, &dynamic.gaussians, log)?,
            None => observe(&input, &dynamic.gaussians, log, &mut |_, _| {})?,
        };
        move_by(&input, &mut observations, dynamic, log)?;
        validate::validate_positions(&input, dynamic, log)?;
        growth::grow(&input, dynamic, log);
        Ok(())
    }

    fn births(&self) -> bool {
        true
    }
}

impl TrackerMotion<'_> {
    fn trackers<'a>(&self, step: &Step<'a>, log: &mut StageLog) -> Vec<&'a dyn TrackSource> {
        if step.tracks.is_empty() {
            log.warn("the capture has no tracks/tracks.json: nothing moves the dynamic layer");
        }
        let used = |source: &&dyn TrackSource| self.only.as_deref().is_none_or(|only| only == source.name());
        step.tracks.iter().map(AsRef::as_ref).filter(used).collect()
    }
}

/// Lines 20 to 34: from what the trackers saw to the places at t. Returns every tracker's estimates.
///
/// # Errors
/// When a file cannot be read or holds no motion, or the device fails.
pub fn move_by(
    input: &MotionInput,
    observations: &mut [Observations],
    dynamic: &mut Dynamic,
    log: &mut StageLog,
) -> Result<Vec<Estimates>> {
    if input.config.association.withdraw_unseen {
        let expected = expected_places(input, observations, dynamic, log)?;
        let cameras: Vec<Camera> = input.step.now.iter().map(|view| view.camera).collect();
        let withdrawn = withdraw::withdraw(&cameras, &expected, observations);
        log.skip("observations dropped: the predicted position lies outside the image", withdrawn);
    }
    let estimates = triangulate::triangulate(input, observations, log)?;
    let fused = fuse(input, observations, &estimates, dynamic, log)?;
    apply(input, fused, dynamic, log);
    Ok(estimates)
}

/// Lines 25 to 34: predict, align the rigid groups with the photographs, ask them whether cells depart, update.
fn fuse(
    input: &MotionInput,
    observations: &[Observations],
    estimates: &[Estimates],
    dynamic: &Dynamic,
    log: &mut StageLog,
) -> Result<Fused> {
    let predicting = Instant::now();
    let fuser = InformationFuser { config: input.config.fusion };
    let columns = FusionColumns::new(input, dynamic);
    let fusion = columns.input(input, observations, estimates, dynamic);
    let mut prediction = fuser.predict(&fusion)?;
    if input.config.alignment.steps > 0 {
        let together = prediction.groups.found.len();
        prediction.groups.separate(input.previous, input.config.fusion.groups.apart);
        tracing::debug!("{together} rigid groups, {} that lie apart", prediction.groups.found.len());
    }
    log.since(stage::FUSION, predicting);
    align_groups(input, dynamic, &mut prediction.groups, log);
    let comparing = Instant::now();
    let mut departures = prediction.departures();
    let offsets = departures.offsets();
    log.since(stage::FUSION, comparing);
    departures.odds = departure_odds(input, &dynamic.gaussians, &prediction.groups, &offsets, log);
    let updating = Instant::now();
    let fused = fuser.update(prediction, &departures)?;
    log.since(stage::FUSION, updating);
    Ok(fused)
}

/// Where the last steps lead; without any, where all observations together do.
fn expected_places(
    input: &MotionInput,
    observations: &[Observations],
    dynamic: &Dynamic,
    log: &mut StageLog,
) -> Result<Vec<DVec3>> {
    if let Some(steps) = dynamic.known_steps() {
        return Ok(input.previous.iter().zip(steps).map(|(place, step)| *place + *step).collect());
    }
    // A rehearsal: what it skips is not counted, the time it takes is.
    let mut rehearsal = StageLog::default();
    let estimates = triangulate::triangulate(input, observations, &mut rehearsal)?;
    let start = Instant::now();
    let columns = FusionColumns::new(input, dynamic);
    let fusion = columns.input(input, observations, &estimates, dynamic);
    let fused = InformationFuser { config: input.config.fusion }.fuse(&fusion)?;
    rehearsal.since(stage::FUSION, start);
    rehearsal.seconds.iter().for_each(|(stage, &seconds)| log.add_seconds(stage, seconds));
    Ok(fused.means)
}
