//! Tests of TrackerSplat on a cloud with exact tracks: motion far beyond the gradient's reach, missing tracks, resumption.

use super::*;
use crate::world::{World, advance, repeats};
use ffgs_core::StageLog;
use ffgs_testkit::conformance;
use ffgs_trainer::{CpuBackend, Epochs, train_layer};
use glam::Vec3;

fn short(iterations: usize) -> Trackersplat<'static> {
    let config = TrackersplatConfig { iterations, ..TrackersplatConfig::default() };
    let train: Box<TrainLayer> = Box::new(|task, schedule, seed| {
        let order = Epochs::new(task.views.len(), seed);
        Ok(train_layer(&CpuBackend, task, schedule, &order, &mut |_| {}).map(drop)?)
    });
    Trackersplat { config, voronoi: VoronoiConfig::default(), train }
}

#[test]
fn a_resumed_run_and_other_threads_give_equal_bytes() {
    repeats(&|| Box::new(short(4)));
}

/// A cloud that moves a third of its own size at once, with exact tracks of its Gaussians.
#[test]
fn a_motion_far_beyond_the_gradient_is_followed() {
    let step = DVec3::new(0.12, 0.08, -0.05);
    let world = conformance::World::new(300, step);
    let order: Vec<usize> = (0..300).collect();
    let mut scene = world.scene(&order);
    let tracks = [world.tracker()];
    let start = scene.dynamic.gaussians.positions();
    world.with_step(1, &tracks, |step| short(0).predict(step, &mut scene, &mut StageLog::default())).unwrap();
    let far = |to: DVec3| {
        let now = scene.dynamic.gaussians.positions();
        let far: Vec<f64> = now.iter().zip(&start).map(|(now, start)| now.distance(*start + to)).collect();
        far.iter().sum::<f64>() / far.len() as f64
    };
    assert!(far(step) < 0.2 * far(DVec3::ZERO), "{} m of {} m", far(step), far(DVec3::ZERO));
}

#[test]
fn without_tracks_nothing_is_moved_and_training_goes_on() {
    let world = World::moving(Vec3::new(0.01, 0.0, 0.0));
    let mut scene = world.scene();
    let before = world.gaussians().means;
    let mut log = StageLog::default();
    world.with_step(1, |step| short(0).predict(step, &mut scene, &mut log)).unwrap();
    assert_eq!(scene.dynamic.gaussians.means, before);
    assert!(log.skips["views without a track"] > 0);
    advance(&world, &mut short(3), 1, &mut scene).unwrap();
    assert_ne!(scene.dynamic.gaussians.means, before);
}
