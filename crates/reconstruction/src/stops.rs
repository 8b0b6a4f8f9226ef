//! What moved and stops: when its masks go, it joins the static layer where the photographs still show it
//! (docs/adr/0062-what-stops-stays.md).

use crate::devices::Devices;
use crate::marking::{STANDS_STILL, add_static};
use crate::reconstructor::{Reconstructor, State};
use anyhow::Result;
use ffgs_core::{Dynamic, Gaussians, ImageRgb8, PlanarImage, Scene, StageLog, TrainingView, stage};
use ffgs_fusion::{GroupsConfig, spatial_objects};
use ffgs_motion::OUTSIDE_MASKS;
use ffgs_trainer::BackgroundConfig;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

/// Fewest Gaussians of an object,
const LEAST: usize = 64;
/// and the least share of the moving layer: less comes and goes as debris.
const LEAST_SHARE: f64 = 0.01;
/// Difference of a channel from which two renders differ at a pixel.
const DIFFERENT: f32 = 0.02;
/// An object stays when the squared error with it is below this share of that without it.
const SHOWN: f64 = 0.4;

impl Reconstructor<'_> {
    /// What left the moving layer, which was `before` at t-1, joins the static one where `now` still shows it.
    pub(crate) fn keep_stopped(
        &self,
        before: &Moving,
        state: &mut State,
        now: &[TrainingView],
        log: &mut StageLog,
    ) -> Result<()> {
        let start = Instant::now();
        let gone = before.gone(&state.scene.dynamic, &self.config.groups);
        let stopped = stand_still(self.devices, &self.config.background, &gone, &mut state.scene, now)?;
        if stopped > 0 {
            state.static_lane.forget();
        }
        log.recount(OUTSIDE_MASKS, STANDS_STILL, stopped);
        log.since(stage::VALIDATION, start);
        Ok(())
    }
}

/// The moving layer before its motion to t.
pub(crate) struct Moving {
    gaussians: Gaussians,
    ids: Vec<u32>,
}

impl Moving {
    /// That of a scene which is about to be moved.
    pub(crate) fn of(dynamic: &Dynamic) -> Self {
        Self { gaussians: dynamic.gaussians.clone(), ids: dynamic.ids.clone() }
    }

    /// The objects that are in `dynamic` no more, where they were at t-1.
    fn gone(&self, dynamic: &Dynamic, groups: &GroupsConfig) -> Vec<Gaussians> {
        let present: BTreeSet<u32> = dynamic.ids.iter().copied().collect();
        let gone: Vec<usize> = (0..self.ids.len()).filter(|&i| !present.contains(&self.ids[i])).collect();
        let least = LEAST.max((LEAST_SHARE * self.ids.len() as f64) as usize);
        if gone.len() < least {
            return Vec::new();
        }
        let gone = self.gaussians.select(&gone);
        let mut objects: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (i, object) in spatial_objects(&gone.positions(), groups).into_iter().enumerate() {
            objects.entry(object).or_default().push(i);
        }
        objects.values().filter(|object| object.len() >= least).map(|object| gone.select(object)).collect()
    }
}

/// Adds to the static layer those objects of `gone` that `views`, of t, show where they were. Returns the number of Gaussians.
///
/// # Errors
/// When the device fails.
fn stand_still(
    devices: Devices,
    background: &BackgroundConfig,
    gone: &[Gaussians],
    scene: &mut Scene,
    views: &[TrainingView],
) -> Result<usize> {
    let mut count = 0;
    for object in gone {
        if is_shown(devices, scene, object, views)? {
            count += object.len();
            add_static(background, scene, object);
        }
    }
    Ok(count)
}

/// Whether the photographs are explained better with the object than without it.
fn is_shown(devices: Devices, scene: &Scene, object: &Gaussians, views: &[TrainingView]) -> Result<bool> {
    let places = object.positions();
    let seen = |view: &&TrainingView| places.iter().any(|place| view.camera.pixel_of(*place).is_some());
    let mut errors = [0.0; 2];
    let mut together = Gaussians::clone(&scene.static_layer);
    together.extend(object);
    let joined = Scene { static_layer: Arc::new(together), ..scene.clone() };
    for view in views.iter().filter(seen) {
        let render = |scene| Ok::<_, anyhow::Error>(devices.render(scene, &[view.camera])?.swap_remove(0));
        add_errors(&mut errors, [&render(&joined)?, &render(scene)?], &view.image);
    }
    let [with, without] = errors;
    Ok(with < SHOWN * without)
}

/// Adds the squared errors of both renders at the pixels where they differ.
fn add_errors(errors: &mut [f64; 2], renders: [&PlanarImage; 2], photograph: &ImageRgb8) {
    for p in 0..photograph.size().pixels() {
        let [a, b] = renders.map(|render| render.pixel(p));
        if (0..3).any(|c| (a[c] - b[c]).abs() > DIFFERENT) {
            let shown = photograph.pixel(p);
            for (error, render) in errors.iter_mut().zip([a, b]) {
                *error += (0..3).map(|c| f64::from(render[c] - shown[c]).powi(2)).sum::<f64>();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{ball, photographs, scene, without_masks};
    use glam::Vec3;

    #[test]
    fn what_stops_joins_the_static_layer_and_what_left_does_not() {
        let (stops, leaves) = (ball(Vec3::new(1.2, -1.5, 0.0)), ball(Vec3::new(-1.5, 1.5, 0.0)));
        let mut both = stops.clone();
        both.extend(&leaves);
        let mut now = scene(&both);
        let before = Moving::of(&now.dynamic);
        let views = without_masks(photographs(&stops));
        let found = |now: &mut Scene| {
            let gone = before.gone(&now.dynamic, &GroupsConfig::default());
            stand_still(Devices(&[]), &BackgroundConfig::default(), &gone, now, &views).unwrap()
        };
        assert_eq!(found(&mut now), 0, "all are in the moving layer");
        now.dynamic.keep(&[]);
        let gone = before.gone(&now.dynamic, &GroupsConfig::default());
        assert_eq!(gone.iter().map(Gaussians::len).collect::<Vec<_>>(), [stops.len(), leaves.len()]);
        assert_eq!(found(&mut now), stops.len());
        assert_eq!(now.static_layer.means, stops.means);
        assert_eq!(now.hidden.len(), 0, "a column that is not there stays so");
    }
}
