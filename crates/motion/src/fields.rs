//! Motion fields of one view: what its trackers say at every masked pixel, and how far they agree.

use crate::MotionInput;
use anyhow::Result;
use ffgs_core::{DenseMotion, Mask, StageLog, ViewMotion};
use ffgs_method::{TrackSource, Tracked};
use ffgs_voronoi::{agreement, densify_view};
use rayon::prelude::*;

/// What one tracker has of one view.
pub(crate) struct Loaded<'a> {
    tracker: &'a str,
    tracked: Option<Tracked>,
}

/// Counts what a tracker lacks; its motion.
pub(crate) fn count(log: &mut StageLog, Loaded { tracker, tracked }: Loaded) -> Option<ViewMotion> {
    let Some(Tracked { motion, dropped, .. }) = tracked else {
        log.skip(format!("{tracker}: no file for a view"), 1);
        return None;
    };
    log.skip(format!("{tracker}: rows or pixels that are not finite"), dropped);
    Some(motion)
}

/// Asks every tracker about a view.
pub(crate) fn load<'a>(input: &MotionInput<'a>, view: usize) -> Result<Vec<Loaded<'a>>> {
    let step = input.step.of_view(view);
    let one =
        |source: &&'a dyn TrackSource| Ok(Loaded { tracker: source.name(), tracked: source.motion(&step)? });
    input.trackers.par_iter().map(one).collect()
}

/// One motion field per tracker over the masked pixels; unknown where it has no motion.
pub(crate) fn densify_tracks(
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
pub(crate) fn agree(input: &MotionInput, mask: &Mask, fields: &mut [DenseMotion]) -> Result<()> {
    Ok(agreement(fields, Some(mask), &input.config.agreement)?)
}
