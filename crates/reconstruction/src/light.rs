//! Light and exposures that change from frame to frame: what all cameras see changes the scene, what one camera sees is its exposure
//! (docs/adr/0090-exposures-and-light-are-followed.md).

use crate::reconstructor::{Reconstructor, State};
use anyhow::Result;
use ffgs_core::{Exposure, StageLog, TrainingView, stage, upper_median};
use ffgs_method::{Split, ViewAt};
use ffgs_trainer::{PhotographExposure, photograph_exposures};
use std::time::Instant;

/// Standard errors that an offset must have to be one of the whole picture.
const SIGNIFICANT: f64 = 3.0;
/// Share of the cameras whose change is that of the light,
const MOST: f64 = 0.75;
/// and how far from the middle one each of these may be, as a share of it.
const ALIKE: f64 = 0.25;

impl Reconstructor<'_> {
    /// Brings the scene and the photographs `now` of a frame together: the scene takes the change of light that most cameras see, and from the
    /// photographs the exposures of their cameras are removed, with what these changed since the first frame.
    ///
    /// # Errors
    /// When a camera cannot be read.
    pub(crate) fn follow_light(
        &self,
        frame: usize,
        state: &mut State,
        now: &mut [TrainingView],
        log: &mut StageLog,
    ) -> Result<()> {
        let shot = |&view: &usize| ViewAt { split: Split::Train, view, frame };
        let shots: Vec<ViewAt> = self.views.iter().map(shot).collect();
        let least = f64::from(self.config.background.exposure_change);
        if least > 0.0 && self.method.births() && !state.scene.static_layer.is_empty() {
            let start = Instant::now();
            let Changes { light, cameras } = Changes::of(&self.measure(state, &shots, now)?, least);
            if let Some(light) = light {
                tracing::info!("frame {frame}: the light changes by {:.3?} (log odds)", light.offsets);
                state.scene.relight(light);
                log.skip("changes of light that the scene followed", 1);
            }
            let names = shots.iter().map(|at| self.capture.views(at.split)[at.view].clone());
            state.exposures = state.exposures.changed(names.zip(cameras));
            log.skip("changes of exposure removed from photographs", state.exposures.changes());
            log.since(stage::EXPOSURES, start);
        }
        state.exposures.remove(self.capture, &shots, now)
    }

    /// What the photographs `now`, taken at `shots`, say of their exposures.
    fn measure(&self, state: &State, shots: &[ViewAt], now: &[TrainingView]) -> Result<Vec<OfCamera>> {
        let State { scene, exposures, .. } = state;
        let (usual, dilation) = (exposures.usual(), self.config.background.mask_dilation);
        let found = photograph_exposures(&scene.static_layer, &scene.sky, now, dilation);
        let furthest =
            found.iter().flatten().flat_map(|m| m.offsets).fold(0.0, |most: f64, o| most.max(o.abs()));
        tracing::debug!("photographs differ from the scene's exposure by {furthest:.3} (log odds) at most");
        let of_camera = |(found, &at): (Option<PhotographExposure>, &ViewAt)| {
            let usual = usual.of(self.capture, at)?.offsets;
            let before = minus(exposures.of(self.capture, at)?.offsets, usual);
            let now = found.map(|m| PhotographExposure { offsets: minus(m.offsets, usual), ..m });
            Ok(OfCamera { before, now })
        };
        found.into_iter().zip(shots).map(of_camera).collect()
    }
}

/// How the exposure of a camera differs from that of the first frame (log odds).
#[derive(Clone, Copy, Debug)]
struct OfCamera {
    /// In the frame before.
    before: [f64; 3],
    /// In this one, where its photograph tells.
    now: Option<PhotographExposure>,
}

impl OfCamera {
    /// Its exposure when the light changes by `light`; changes below `least` are none. Where the photograph does not tell, it is what it was.
    fn exposure(&self, light: [f64; 3], least: f64) -> [f64; 3] {
        let Some(PhotographExposure { offsets, errors }) = self.now else { return self.before };
        let (change, errors) = (minus(offsets, light), errors.map(|error| SIGNIFICANT * error));
        if (0..3).any(|c| change[c].abs() > least.max(errors[c])) {
            return change.map(|offset| (offset * 1e4).round() / 1e4);
        }
        if errors.iter().all(|error| *error < least) { [0.0; 3] } else { self.before }
    }
}

/// What changes in a frame (log odds).
#[derive(Debug, PartialEq)]
struct Changes {
    /// For all cameras.
    light: Option<Exposure>,
    /// Of each camera, from the first frame on; zeros where nothing does.
    cameras: Vec<[f64; 3]>,
}

impl Changes {
    /// Changes below `least` are none.
    fn of(cameras: &[OfCamera], least: f64) -> Self {
        let step = |camera: &OfCamera| Some(minus(camera.now?.offsets, camera.before));
        let steps: Vec<[f64; 3]> = cameras.iter().filter_map(step).collect();
        let most = (MOST * cameras.len() as f64).ceil() as usize;
        let light = common(&steps, most, least);
        let of_light = light.map_or([0.0; 3], |light| light.offsets);
        Self { light, cameras: cameras.iter().map(|camera| camera.exposure(of_light, least)).collect() }
    }
}

/// The step that `most` cameras take, if there is one.
fn common(steps: &[[f64; 3]], most: usize, least: f64) -> Option<Exposure> {
    let grey = |step: &[f64; 3]| step.iter().sum::<f64>() / 3.0;
    let middle = upper_median(steps.iter().map(grey)).unwrap_or(0.0);
    let alike = steps.iter().filter(|step| (grey(step) - middle).abs() < ALIKE * middle.abs()).count();
    if middle.abs() < least || alike < most {
        return None;
    }
    let of_channel = |c: usize| upper_median(steps.iter().map(|step| step[c])).unwrap_or(0.0);
    Some(Exposure { offsets: [0, 1, 2].map(of_channel) })
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|c| a[c] - b[c])
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: f64 = 0.05;

    fn camera(before: f64, now: f64, error: f64) -> OfCamera {
        let now = PhotographExposure { offsets: [now; 3], errors: [error; 3] };
        OfCamera { before: [before; 3], now: Some(now) }
    }

    fn first_changes(now: &[f64]) -> Changes {
        Changes::of(&now.iter().map(|&now| camera(0.0, now, 0.002)).collect::<Vec<_>>(), LEAST)
    }

    #[test]
    fn what_all_cameras_see_is_light_and_what_one_sees_is_its_exposure() {
        let found = first_changes(&[-0.2, -0.21, -0.19, -0.2, 0.3]);
        assert_eq!(found.light, Some(Exposure { offsets: [-0.2; 3] }));
        assert_eq!(found.cameras, [[0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3], [0.5; 3]]);
    }

    #[test]
    fn cameras_that_change_each_in_its_own_way_leave_the_light() {
        let found = first_changes(&[0.3, -0.2, 0.1, 0.02, -0.4]);
        assert_eq!(found.light, None);
        let expected = [0.3, -0.2, 0.1, 0.0, -0.4].map(|offset| [offset; 3]);
        assert_eq!(found.cameras, expected, "the fourth changes too little");
    }

    /// By now they are alike by chance, but the last step of each was another one.
    #[test]
    fn the_light_is_a_step_of_one_frame() {
        let cameras = [camera(0.1, 0.3, 0.0), camera(0.3, 0.31, 0.0), camera(0.5, 0.29, 0.0)];
        let found = Changes::of(&cameras, LEAST);
        assert_eq!((found.light, found.cameras), (None, vec![[0.3; 3], [0.31; 3], [0.29; 3]]));
        let cameras = [camera(0.1, 0.4, 0.0), camera(-0.3, 0.0, 0.0)];
        let found = Changes::of(&cameras, LEAST);
        let light = found.light.unwrap().offsets[0];
        assert!((light - 0.3).abs() < 1e-12);
        assert_eq!(found.cameras, [[0.1; 3], [-0.3; 3]], "each keeps its own");
    }

    #[test]
    fn small_and_uncertain_changes_are_none_and_what_was_known_stays() {
        let nothing = |count: usize| Changes { light: None, cameras: vec![[0.0; 3]; count] };
        assert_eq!(first_changes(&[0.03; 4]), nothing(4));
        assert_eq!(first_changes(&[]), nothing(0));
        let unknown = OfCamera { before: [0.2; 3], now: None };
        let of = |camera| Changes::of(&[camera, unknown], LEAST).cameras[0];
        assert_eq!(of(unknown), [0.2; 3]);
        assert_eq!(of(camera(0.2, -0.3, 0.2)), [0.2; 3], "it cannot tell");
        assert_eq!(of(camera(0.2, 0.01, 0.001)), [0.0; 3], "it is as in the first frame again");
    }
}
