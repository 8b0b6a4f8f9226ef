//! What moving things hid from the static layer so far, and its training where it comes to light
//! (docs/adr/0042-disoccluded-gaussians-are-trained.md).

use crate::marking::cameras_and_masks;
use crate::reconstructor::{Reconstructor, State};
use crate::reduced::Reduced;
use anyhow::Result;
use ffgs_core::{Gaussians, Mask, Scene, StageLog, TrainingView, stage};
use ffgs_fusion::{ViewCounts, count_views};
use ffgs_trainer::{Disoccluded, DisocclusionConfig, Progress};
use std::time::Instant;

/// With at most one in so many of the views that could see it open, a Gaussian counts as hidden.
const HIDDEN_ONE_IN: u32 = 3;
/// With one in so many open, it is trained for its last rounds.
const OPEN_ONE_IN: u32 = 2;
/// Fewest open views that fix a place.
const LEAST_OPEN: u32 = 2;

/// In how many views each Gaussian could be seen, and in how many of them it lies in a mask widened by `dilation`.
fn counts(layer: &Gaussians, views: &[TrainingView], dilation: usize) -> Result<Vec<ViewCounts>> {
    let (cameras, masks) = cameras_and_masks(views);
    let masks: Vec<Mask> = masks.iter().map(|mask| mask.widened(dilation)).collect();
    Ok(count_views(&layer.positions(), &cameras, &masks)?)
}

/// Per static Gaussian the rounds in which it is to be trained: `config.rounds` for those that `views`, all that frame 0
/// has, mostly saw covered by something that moves.
pub(crate) fn hidden(
    config: &DisocclusionConfig,
    layer: &Gaussians,
    views: &[TrainingView],
    dilation: usize,
) -> Result<Vec<u8>> {
    let rounds = config.rounds.min(usize::from(u8::MAX)) as u8;
    let is_hidden = |c: &ViewCounts| {
        let open = c.seen - c.inside;
        c.inside > 0 && (open < LEAST_OPEN || open * HIDDEN_ONE_IN <= c.seen)
    };
    let hidden = counts(layer, views, dilation)?;
    Ok(hidden.iter().map(|c| if is_hidden(c) { rounds } else { 0 }).collect())
}

impl Reconstructor<'_> {
    /// Notes which static Gaussians moving things hide in a first frame, where that is not known yet. `views` are all that it was trained on.
    pub(crate) fn find_hidden(&self, scene: &mut Scene, views: &[TrainingView]) -> Result<()> {
        if scene.hidden.is_empty() {
            let (config, dilation) = (&self.config.disocclusion, self.config.marking.dilation);
            scene.hidden = hidden(config, &scene.static_layer, views, dilation)?;
        }
        Ok(())
    }

    /// Every so many frames, trains the static Gaussians that were hidden and that `views`, of t, now see.
    pub(crate) fn train_disoccluded(
        &self,
        frame: usize,
        state: &mut State,
        views: &[TrainingView],
        log: &mut StageLog,
    ) -> Result<()> {
        let start = Instant::now();
        let config = &self.config.disocclusion;
        if !frame.is_multiple_of(config.every) {
            return Ok(());
        }
        let report = self.monitor.begin(stage::DISOCCLUSION, config.iterations);
        let hidden = |scene: &Scene| scene.hidden.iter().any(|&rounds| rounds > 0);
        if config.iterations > 0 && hidden(&state.scene) {
            let count = self.train_open(frame, state, views, &mut |p| report(p))?;
            tracing::debug!("frame {frame}: {count} static Gaussians come to light");
        }
        log.since(stage::DISOCCLUSION, start);
        Ok(())
    }

    /// Trains what was hidden and is in the open at t. Returns how many Gaussians that were.
    fn train_open(
        &self,
        frame: usize,
        state: &mut State,
        views: &[TrainingView],
        report: &mut dyn FnMut(Progress),
    ) -> Result<usize> {
        let State { scene, static_lane, .. } = state;
        let counts = counts(&scene.static_layer, views, self.config.marking.dilation)?;
        let open = |i: usize| counts[i].seen - counts[i].inside;
        let in_the_open =
            |i: &usize| scene.hidden[*i] > 0 && open(*i) >= LEAST_OPEN.min(counts[*i].seen).max(1);
        let gaussians: Vec<usize> = (0..counts.len()).filter(in_the_open).collect();
        let found = scene.static_layer.select(&gaussians);
        let views = &Reduced::new(views, self.config.resolution.static_layer(&found, views)).views;
        let what =
            Disoccluded { gaussians: &gaussians, moving: &scene.dynamic.gaussians, views, sky: &scene.sky };
        let (config, seed) = (&self.config.disocclusion, self.seed(frame));
        if self.devices.disoccluded(config, what, &mut scene.static_layer, seed, report)? {
            static_lane.forget();
            scene.keep(&gaussians);
        }
        for &i in &gaussians {
            scene.hidden[i] -= u8::from(open(i) * OPEN_ONE_IN >= counts[i].seen);
        }
        Ok(gaussians.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics};
    use glam::{DMat4, DVec3};

    const SIZE: ImageSize = ImageSize { width: 40, height: 30 };

    /// `count` cameras side by side; the first `covered` of them have the left half of the image in their masks.
    fn views(count: usize, covered: usize) -> Vec<TrainingView> {
        let view = |v: usize| {
            let intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 20.0, cy: 15.0 };
            let pose = DMat4::from_translation(DVec3::new(0.01 * v as f64, 0.0, 0.0));
            let left = (0..SIZE.pixels()).map(|p| u8::from(v < covered && p % SIZE.width < 20)).collect();
            let image = ImageRgb8::new(SIZE, vec![0; 3 * SIZE.pixels()]).unwrap();
            let camera = Camera::new(intrinsics, pose, SIZE).unwrap();
            TrainingView { camera, image, mask: Mask::new(SIZE, left).unwrap() }
        };
        (0..count).map(view).collect()
    }

    #[test]
    fn hidden_is_what_most_views_have_in_their_masks() {
        let mut layer = Gaussians::zeros(3, 0);
        layer.means = vec![[-1.0, 0.0, 4.0], [1.0, 0.0, 4.0], [0.0, 0.0, -4.0]];
        let config = DisocclusionConfig { rounds: 3, ..DisocclusionConfig::default() };
        let found = |covered| hidden(&config, &layer, &views(6, covered), 0).unwrap();
        assert_eq!(found(6), [3, 0, 0], "the left one; the last is seen by nobody");
        assert_eq!(found(4), [3, 0, 0], "two of six views see it");
        assert_eq!(found(3), [0, 0, 0], "half of them do");
        assert_eq!(found(0), [0, 0, 0]);
    }
}
