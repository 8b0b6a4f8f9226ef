//! Motion fields, agreement and association: what the trackers say of every Gaussian (Algorithm 1, lines 3 to 19).

use crate::MotionInput;
use crate::fields::{agree, count, densify_tracks, load};
use anyhow::Result;
use ffgs_core::{DenseMotion, Gaussians, Observations, StageLog, TrainingView, stage};
use ffgs_rasterizer::{Association, AssociationScene, AssociationScratch, Observed};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Bytes that the motion fields of views in flight may take together; one view is always allowed.
const FIELD_BYTES: usize = 1 << 30;

/// Lines 3 to 19: motion fields, agreement, association. Views are worked on in parallel, so many at once as
/// `FIELD_BYTES` hold, so that memory does not grow with their number. `inspect` sees each view's index and fields.
///
/// # Errors
/// When a file cannot be read or holds no motion, or the device fails.
pub fn observe(
    input: &MotionInput,
    gaussians: &Gaussians,
    log: &mut StageLog,
    inspect: &mut dyn FnMut(usize, &[DenseMotion]),
) -> Result<Vec<Observations>> {
    let unobserved = || Observations::unobserved(input.step.before.len(), gaussians.len());
    let mut observations: Vec<_> = input.trackers.iter().map(|_| unobserved()).collect();
    let mut rows = rows(&mut observations);
    let scene = AssociationScene::new(&[gaussians, input.static_layer], input.previous);
    let scratch = Mutex::new(Vec::new());
    let views: Vec<usize> =
        (0..input.step.before.len()).filter(|&v| input.step.before[v].mask.count() > 0).collect();
    for group in views.chunks(views_at_once(input)) {
        let fields = motion_fields(input, group, log)?;
        group.iter().zip(&fields).for_each(|(&v, fields)| inspect(v, fields));
        let start = Instant::now();
        let rows: Vec<Vec<Observed>> = group.iter().map(|&v| std::mem::take(&mut rows[v])).collect();
        group.par_iter().zip(&fields).zip(rows).for_each(|((&v, fields), mut rows)| {
            with_scratch(&scratch, |scratch| {
                let association = association(input, &input.step.before[v], fields);
                association.observe(&scene, &mut rows, scratch);
            });
        });
        log.since(stage::ASSOCIATION, start);
    }
    Ok(observations)
}

fn association<'a>(
    input: &MotionInput,
    view: &'a TrainingView,
    fields: &'a [DenseMotion],
) -> Association<'a> {
    let config = &input.config.association;
    Association {
        camera: &view.camera,
        mask: &view.mask,
        fields,
        flow_floor_px: config.flow_floor_px,
        min_coverage: config.min_coverage,
        min_hits: config.min_hits,
        min_transmittance: config.min_transmittance,
        contributors: config.contributors,
        normalise: config.normalise,
    }
}

/// (V) of (L): where each view writes.
pub(crate) fn rows(observations: &mut [Observations]) -> Vec<Vec<Observed<'_>>> {
    let views = observations.first().map_or(0, |o| o.views);
    let mut rows: Vec<Vec<Observed>> = (0..views).map(|_| Vec::new()).collect();
    for observation in observations {
        let n = observation.gaussians.max(1);
        let columns = observation.targets.chunks_mut(n).zip(observation.weights.chunks_mut(n));
        rows.iter_mut()
            .zip(columns)
            .for_each(|(row, (targets, weights))| row.push(Observed { targets, weights }));
    }
    rows
}

/// Views whose motion fields are in memory together.
pub(crate) fn views_at_once(input: &MotionInput) -> usize {
    let pixels = input.step.before.iter().map(|v| v.mask.size().pixels()).max().unwrap_or(1);
    let bytes = pixels * input.trackers.len().max(1) * size_of::<[f32; 4]>();
    (FIELD_BYTES / bytes).max(1)
}

/// Motion fields of each view of a group, one per tracker. The steps run one after the other for all views, so that the times of the stages add up.
fn motion_fields(input: &MotionInput, group: &[usize], log: &mut StageLog) -> Result<Vec<Vec<DenseMotion>>> {
    let start = Instant::now();
    let loaded: Vec<_> = group.par_iter().map(|&v| load(input, v)).collect::<Result<_>>()?;
    log.since(stage::LOAD, start);
    let start = Instant::now();
    let motions = loaded.into_iter().map(|view| view.into_iter().map(|loaded| count(log, loaded)).collect());
    let motions: Vec<Vec<_>> = motions.collect();
    let mut fields: Vec<Vec<DenseMotion>> = (group.par_iter().zip(motions))
        .map(|(&v, motions)| densify_tracks(input, &input.step.before[v].mask, motions))
        .collect::<Result<_>>()?;
    log.since(stage::VORONOI, start);
    let start = Instant::now();
    (group.par_iter().zip(&mut fields))
        .try_for_each(|(&v, fields)| agree(input, &input.step.before[v].mask, fields))?;
    log.since(stage::AGREEMENT, start);
    Ok(fields)
}

/// Runs `work` with memory that an earlier view has finished with, if any.
fn with_scratch(free: &Mutex<Vec<AssociationScratch>>, work: impl FnOnce(&mut AssociationScratch)) {
    let lock = || free.lock().unwrap_or_else(PoisonError::into_inner);
    let mut scratch = lock().pop().unwrap_or_default();
    work(&mut scratch);
    lock().push(scratch);
}
