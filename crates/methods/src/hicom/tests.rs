//! Tests of HiCoM on a rigid cloud: what it follows, where its reach ends, and what a stored frame decodes to.

use super::*;
use crate::two_stages::Nodes;
use crate::world::{World, advance, repeats};
use ffgs_arrays::NpzFile;
use ffgs_core::StageLog;
use glam::Vec3;

fn method(config: HicomConfig) -> TwoStages<Grids> {
    TwoStages::new(config)
}

/// Few steps, with everything that a frame does.
fn short() -> HicomConfig {
    let mut config = HicomConfig { gaussians_per_cell: 2, ..HicomConfig::default() };
    config.motion.iterations = 6;
    config.added = AddedConfig { iterations: 6, densify_every: 4, grow_gradient: 1e-6, ..config.added };
    config
}

#[test]
fn a_resumed_run_and_other_threads_give_equal_bytes() {
    repeats(&|| Box::new(method(short())));
}

/// 1.1 cm is a fifth of the reach of one level: 100 steps of 5e-4 m.
#[test]
fn a_slow_rigid_motion_is_followed() {
    let world = World::moving(Vec3::new(0.01, 0.005, 0.0));
    let mut config = HicomConfig::default();
    config.added.grow_gradient = 1e9;
    let (mut method, mut scene) = (method(config), world.scene());
    let [.., still] = world.errors(&scene, 1);
    advance(&world, &mut method, 1, &mut scene).unwrap();
    let [.., found] = world.errors(&scene, 1);
    assert!(found < 0.35 * still, "{found} m of {still} m");
}

#[test]
fn a_motion_beyond_reach_is_not() {
    let world = World::moving(Vec3::new(0.5, 0.0, 0.0));
    let (mut method, mut scene) = (method(HicomConfig::default()), world.scene());
    advance(&world, &mut method, 1, &mut scene).unwrap();
    // Three levels of 100 steps of 5e-4 m.
    assert!(world.errors(&scene, 1)[1] > 0.5 - 3.0 * 100.0 * 5e-4);
}

#[test]
fn what_was_added_is_paid_for_in_the_next_frame() {
    let world = World::moving(Vec3::new(0.01, 0.0, 0.0));
    let (mut method, mut scene) = (method(short()), world.scene());
    let first = scene.joint().len();
    advance(&world, &mut method, 1, &mut scene).unwrap();
    assert!(method.added > 0 && scene.dynamic.gaussians.len() == first + method.added);
    world.with_step(2, |step| method.predict(step, &mut scene, &mut StageLog::default())).unwrap();
    assert_eq!(scene.dynamic.gaussians.len(), first);
    assert_eq!(scene.dynamic.ids.len(), first);
}

#[test]
fn a_training_that_diverges_says_so() {
    let world = World::moving(Vec3::new(0.01, 0.0, 0.0));
    let mut scene = world.scene();
    scene.dynamic.gaussians.sh[0] = [f32::MAX; 3];
    let error = advance(&world, &mut method(short()), 1, &mut scene).unwrap_err().to_string();
    assert!(error.contains("diverged") && error.contains("rates"), "{error}");
}

/// What a receiver does with a file: the last frame's Gaussians, merged, follow the deltas; the added ones come behind them.
#[test]
fn a_stored_frame_is_what_is_rendered() {
    let world = World::moving(Vec3::new(0.01, 0.0, 0.0));
    let (mut method, mut scene) = (method(short()), world.scene());
    let folder = std::env::temp_dir().join(format!("ffgs-hicom-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    assert!(method.store(&scene, &folder).unwrap().is_empty(), "nothing was trained yet");
    advance(&world, &mut method, 1, &mut scene).unwrap();
    world.with_step(2, |step| {
        method.predict(step, &mut scene, &mut StageLog::default()).unwrap();
        let base = scene.dynamic.gaussians.clone();
        method.finetune(step, &mut scene, &mut StageLog::default()).unwrap();
        let stored = method.store(&scene, &folder).unwrap();
        let file = NpzFile::open(&stored[0]).unwrap();
        let deltas = file.f32("deltas").unwrap();
        let mut received = base.clone();
        let (deformation, _) = method.nodes.as_mut().unwrap().deformation(&base.means).unwrap();
        deformation.apply(&deltas.data, &base, &mut received);
        let now = &scene.dynamic.gaussians;
        let (kept, added) = (base.len(), now.len() - base.len());
        assert_eq!((&received.means[..], &received.quats[..]), (&now.means[..kept], &now.quats[..kept]));
        assert_eq!(received.sh, now.sh[..received.sh.len()]);
        assert!(added > 0 && added == method.added);
        assert_eq!(file.f32("means").unwrap().data, now.means[kept..].as_flattened());
        assert_eq!(file.f32("opacity_logits").unwrap().data, now.opacity_logits[kept..]);
    });
    std::fs::remove_dir_all(&folder).unwrap();
}
