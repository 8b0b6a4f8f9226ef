//! Motion fields of one view: what its trackers say at every masked pixel, and how far they agree.

use super::{MotionInput, MotionOutcome, add_seconds};
use crate::cli::Init;
use anyhow::Result;
use ffgs_core::{DenseMotion, Mask, ViewMotion};
use ffgs_voronoi::{agreement, densify_view};
use std::time::Instant;

/// Trackers used, as indices into the store.
pub fn selected_trackers(input: &MotionInput, outcome: &mut MotionOutcome) -> Vec<usize> {
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

pub(super) fn motion_fields(
    input: &MotionInput,
    trackers: &[usize],
    view: usize,
    mask: &Mask,
    outcome: &mut MotionOutcome,
) -> Result<Vec<DenseMotion>> {
    let Some(store) = input.tracks else { return Ok(Vec::new()) };
    let camera = &input.views.selected[view].1;
    let mut fields = Vec::with_capacity(trackers.len());
    for &l in trackers {
        let start = Instant::now();
        let loaded = store.load_counted(l, camera, input.frame, mask.size())?;
        add_seconds(&mut outcome.seconds.load, start);
        let start = Instant::now();
        let mut field = DenseMotion::unknown(mask.size());
        let name = &store.trackers()[l].name;
        match loaded {
            None => outcome.skip(format!("{name}: no file for a view"), 1),
            Some((motion, stats)) => {
                outcome.skip(format!("{name}: rows or pixels that are not finite"), stats.dropped);
                match motion {
                    ViewMotion::Dense(dense) => field = dense,
                    ViewMotion::Tracks(set) => densify_view(&input.config.voronoi, &set, mask, &mut field)?,
                }
            }
        }
        add_seconds(&mut outcome.seconds.voronoi, start);
        fields.push(field);
    }
    let start = Instant::now();
    agreement(&mut fields, &input.config.agreement)?;
    add_seconds(&mut outcome.seconds.agreement, start);
    Ok(fields)
}
