//! Motion fields of one view: what its trackers say at every masked pixel, and how far they agree.

use super::{MotionInput, MotionOutcome};
use crate::cli::Init;
use anyhow::Result;
use ffgs_core::{DenseMotion, Mask, ViewMotion};
use ffgs_tracks::LoadStats;
use ffgs_voronoi::{agreement, densify_view};
use rayon::prelude::*;

/// Trackers used, as indices into the store.
pub(super) fn selected_trackers(input: &MotionInput, outcome: &mut MotionOutcome) -> Vec<usize> {
    let Some(store) = input.tracks else {
        outcome
            .warnings
            .push("the capture has no tracks/tracks.json: nothing moves the dynamic layer".into());
        return Vec::new();
    };
    let named = |name: &str| match input.init {
        Init::Fused => true,
        Init::None => false,
        Init::Tracker(only) => only == name,
    };
    (0..store.trackers().len()).filter(|&l| named(&store.trackers()[l].name)).collect()
}

/// One tracker's file of one view.
pub(super) struct Loaded<'a> {
    tracker: &'a str,
    /// `None` when there is no file.
    motion: Option<(ViewMotion, LoadStats)>,
}

impl MotionOutcome {
    /// Counts what a file lacks; its motion.
    pub(super) fn count(&mut self, file: Loaded) -> Option<ViewMotion> {
        let name = file.tracker;
        let Some((motion, stats)) = file.motion else {
            self.skip(format!("{name}: no file for a view"), 1);
            return None;
        };
        self.skip(format!("{name}: rows or pixels that are not finite"), stats.dropped);
        Some(motion)
    }
}

/// Reads the trackers' files of a view.
pub(super) fn load<'a>(input: &MotionInput<'a>, trackers: &[usize], view: usize) -> Result<Vec<Loaded<'a>>> {
    let Some(store) = input.tracks else { return Ok(Vec::new()) };
    let (camera, size) = (&input.views.selected[view].1, input.before[view].mask.size());
    let one = |&l: &usize| {
        let motion = store.load_counted(l, camera, input.frame, size)?;
        Ok(Loaded { tracker: &store.trackers()[l].name, motion })
    };
    trackers.par_iter().map(one).collect()
}

/// A field a tracker over the masked pixels; unknown where it has no motion.
pub(super) fn densify_tracks(
    input: &MotionInput,
    mask: &Mask,
    motions: Vec<Option<ViewMotion>>,
) -> Result<Vec<DenseMotion>> {
    let field = |motion: Option<ViewMotion>| {
        Ok(match motion {
            Some(ViewMotion::Dense(dense)) => dense,
            Some(ViewMotion::Tracks(set)) => densify_view(&input.config.voronoi, &set, mask)?,
            None => DenseMotion::unknown(mask.size()),
        })
    };
    motions.into_par_iter().map(field).collect()
}

/// Scales the confidences by how far the trackers agree.
pub(super) fn agree(input: &MotionInput, mask: &Mask, fields: &mut [DenseMotion]) -> Result<()> {
    Ok(agreement(fields, Some(mask), &input.config.agreement)?)
}
