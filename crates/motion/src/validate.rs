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
    let mut silhouettes = Silhouettes::new(&cameras, &masks, marking.dilation, marking.validation_slack())?;
    if marking.second_chance {
        let dropped = silhouettes.drop_flickering(means)?;
        log.skip("masks ignored: they miss objects that all other views show", dropped);
    }
    Ok(silhouettes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MotionConfig, join};
    use ffgs_core::{Camera, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, TrainingView};
    use ffgs_dataset::Dynamic3dGaussians;
    use ffgs_method::{CaptureFormat, Step};
    use ffgs_testkit::look_at;
    use std::path::Path;
    use std::sync::Arc;

    const SIZE: ImageSize = ImageSize { width: 96, height: 72 };
    const TRUNK: usize = 96;
    const HAND: DVec3 = DVec3::new(0.0, 0.0, 0.8);

    /// A trunk around the origin and a hand of four Gaussians above it.
    fn body() -> Gaussians {
        let trunk = (0..TRUNK).map(|i| {
            let (sin, cos) = (2.4 * i as f64).sin_cos();
            DVec3::new(0.3 * cos, 0.3 * sin, 0.006 * i as f64 - 0.3)
        });
        let hand = (0..4).map(|i| HAND + DVec3::new(0.01 * f64::from(i), 0.0, 0.0));
        let places: Vec<DVec3> = trunk.chain(hand).collect();
        let mut body = Gaussians::zeros(places.len(), 0);
        body.means.iter_mut().zip(&places).for_each(|(mean, place)| *mean = place.as_vec3().to_array());
        body
    }

    /// What four cameras around the body show; the masks of the first `lacking` have a hole where the hand is.
    fn views(lacking: usize) -> Vec<TrainingView> {
        let view = |v: usize| {
            let (sin, cos) = (v as f64 * std::f64::consts::FRAC_PI_2).sin_cos();
            let pose = look_at(DVec3::new(5.0 * cos, 5.0 * sin, 0.6), DVec3::ZERO);
            let camera =
                Camera::new(Intrinsics { fx: 90.0, fy: 90.0, cx: 48.0, cy: 36.0 }, pose, SIZE).unwrap();
            let (x, y) = camera.pixel_of(HAND).unwrap();
            let hole = |i: usize| (i % SIZE.width).abs_diff(x).max((i / SIZE.width).abs_diff(y)) < 5;
            let mask = (0..SIZE.pixels()).map(|i| u8::from(v >= lacking || !hole(i))).collect();
            let image = ImageRgb8::new(SIZE, vec![0; 3 * SIZE.pixels()]).unwrap();
            TrainingView { camera, image, mask: Mask::new(SIZE, mask).unwrap() }
        };
        (0..4).map(view).collect()
    }

    /// Gaussians that are left of the body, which stands still.
    fn left(config: &MotionConfig, lacking: usize) -> usize {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let (capture, views) = (Dynamic3dGaussians.open(&path).unwrap(), views(lacking));
        let mut dynamic = Dynamic { gaussians: Gaussians::zeros(0, 0), ..Dynamic::default() };
        join(&mut dynamic, &body(), &views);
        let previous = dynamic.gaussians.positions();
        let step = Step {
            frame: 1,
            seed: 1,
            capture: &*capture,
            views: &[0, 1, 2, 3],
            before: &views,
            now: &views,
            reduced: [&views, &views],
            tracks: &[],
        };
        let static_layer = Arc::new(Gaussians::zeros(0, 0));
        let input = MotionInput {
            config,
            step,
            trackers: Vec::new(),
            static_layer: &static_layer,
            previous: &previous,
            gpu: None,
        };
        validate_positions(&input, &mut dynamic, &mut StageLog::default()).unwrap();
        dynamic.gaussians.len()
    }

    /// Masks of filmed people have holes.
    #[test]
    fn what_moves_stays_until_most_masks_lack_it() {
        let config = MotionConfig::default();
        assert_eq!([0, 1, 2, 3, 4].map(|lacking| left(&config, lacking)), [100, 100, 100, 96, 96]);
        let mut strict = config;
        strict.marking.validation_share = strict.marking.slack_share;
        assert_eq!([0, 2].map(|lacking| left(&strict, lacking)), [100, 96]);
        assert_eq!([2, 3].map(|lacking| left(&MotionConfig::literal(), lacking)), [100, 96]);
    }
}
