//! Validation: Gaussians outside the masks at t are placed once more, then removed (Algorithm 1, lines 35 to 40).

use crate::MotionInput;
use anyhow::Result;
use ffgs_core::{Dynamic, StageLog, stage};
use ffgs_fusion::{Silhouettes, second_chance, spatial_objects};
use glam::DVec3;
use std::collections::BTreeMap;
use std::time::Instant;

/// What Gaussians are counted as that validation removes because the masks do not hold them.
pub const OUTSIDE_MASKS: &str = "removed: outside the masks";

/// Lines 35 to 40: Gaussians outside the masks are removed; with `marking.second_chance` when their neighbours' motion does not
/// bring them inside either.
pub(crate) fn validate_positions(
    input: &MotionInput,
    dynamic: &mut Dynamic,
    log: &mut StageLog,
) -> Result<()> {
    let start = Instant::now();
    let mut means = dynamic.gaussians.positions();
    let silhouettes = silhouettes(input, &means, log)?;
    let mut valid = silhouettes.hold(&means)?;
    if input.config.marking.second_chance {
        second_chance(input.previous, &mut means, &mut dynamic.covariances, &valid)?;
        // Only those that moved are looked at again.
        let moved: Vec<usize> = (0..means.len()).filter(|&i| !valid[i]).collect();
        let again = silhouettes.hold(&moved.iter().map(|&i| means[i]).collect::<Vec<_>>())?;
        moved.iter().zip(again).for_each(|(&i, now)| valid[i] = now);
    }
    let shown = silhouettes.shown(&means);
    let wait = doubts(input, dynamic, &valid, &shown, log);
    let kept: Vec<usize> = (0..means.len()).filter(|&i| valid[i] || wait[i] && shown[i]).collect();
    let unseen = shown.iter().filter(|shown| !**shown).count();
    log.change("removed: in no image", unseen);
    log.change(OUTSIDE_MASKS, means.len() - kept.len() - unseen);
    for (target, mean) in dynamic.gaussians.means.iter_mut().zip(&means) {
        *target = mean.as_vec3().to_array();
    }
    dynamic.steps = means.iter().zip(input.previous).map(|(now, before)| *now - *before).collect();
    dynamic.keep(&kept);
    dynamic.growth_limit = dynamic.growth_limit.saturating_sub(unseen);
    log.since(stage::VALIDATION, start);
    Ok(())
}

/// Objects with a smaller share of the layer are not asked for by themselves: debris comes and goes.
const DEBRIS: f64 = 0.05;

/// (N) whether those outside the masks stay for now: one frame's masks may be wrong, so many of an object go only when
/// the next frame agrees.
fn doubts(
    input: &MotionInput,
    dynamic: &mut Dynamic,
    valid: &[bool],
    shown: &[bool],
    log: &mut StageLog,
) -> Vec<bool> {
    let objects = spatial_objects(input.previous, &input.config.fusion.groups);
    let mut counts: BTreeMap<u32, [usize; 2]> = BTreeMap::new();
    for (i, object) in objects.iter().enumerate() {
        let [lost, all] = counts.entry(*object).or_default();
        *lost += usize::from(!valid[i] && shown[i]);
        *all += 1;
    }
    let large = DEBRIS * valid.len() as f64;
    counts.retain(|_, [lost, all]| {
        *lost as f64 > input.config.marking.loss_warning * *all as f64 && *all as f64 >= large
    });
    let wait = !counts.is_empty() && !dynamic.masks_doubted && input.config.marking.second_chance;
    dynamic.masks_doubted = wait;
    let what = if wait { "stay until the next frame agrees" } else { "go" };
    for [lost, all] in counts.values() {
        log.warn(format!("{lost} of {all} dynamic Gaussians of an object left the masks: they {what}"));
    }
    objects.iter().map(|object| wait && counts.contains_key(object)).collect()
}

/// The masks at t; those that lack what all others hold have no say.
fn silhouettes(input: &MotionInput, means: &[DVec3], log: &mut StageLog) -> Result<Silhouettes> {
    let marking = &input.config.marking;
    let views = input.step.now.iter();
    let (cameras, masks): (Vec<_>, Vec<_>) = views.map(|v| (v.camera, v.mask.clone())).unzip();
    let mut silhouettes = Silhouettes::new(&cameras, &masks, marking.dilation, marking.slack())?;
    if marking.second_chance {
        let dropped = silhouettes.drop_flickering(means)?;
        log.skip("masks ignored: they miss objects that all other views show", dropped);
    }
    Ok(silhouettes)
}
