//! Tests of Dynamic 3D Gaussians on a rigid cloud: what it follows, what it leaves alone, and resumption.

use super::*;
use crate::world::{World, advance, repeats};

fn short() -> Dynamic3dgsConfig {
    Dynamic3dgsConfig { iterations: 6, neighbours: 5, neighbour_decay: 1.0, ..Dynamic3dgsConfig::default() }
}

#[test]
fn a_resumed_run_and_other_threads_give_equal_bytes() {
    repeats(&|| Box::new(Dynamic3dgs::new(short())));
}

/// Two frames of one velocity: after the first the prediction alone leads there.
#[test]
fn a_slow_rigid_motion_is_followed_and_then_foreseen() {
    let world = World::moving(Vec3::new(0.03, 0.015, 0.0));
    let config = Dynamic3dgsConfig { iterations: 100, neighbour_decay: 10.0, ..short() };
    let (mut method, mut scene) = (Dynamic3dgs::new(config), world.scene());
    method.begin(&scene).unwrap();
    let [still, _] = world.errors(&scene, 1);
    advance(&world, &mut method, 1, &mut scene).unwrap();
    let [found, _] = world.errors(&scene, 1);
    assert!(found < 0.3 * still, "{found} m of {still} m");
    let [unforeseen, _] = world.errors(&scene, 2);
    world.with_step(2, |step| method.predict(step, &mut scene, &mut StageLog::default())).unwrap();
    let [foreseen, _] = world.errors(&scene, 2);
    assert!(foreseen < 0.5 * unforeseen, "{foreseen} m of {unforeseen} m");
}

#[test]
fn the_background_stays_and_sizes_and_opacities_are_frozen() {
    let world = World::moving(Vec3::new(0.03, 0.0, 0.0));
    let (mut method, mut scene) = (Dynamic3dgs::new(short()), world.scene());
    method.begin(&scene).unwrap();
    let before = world.gaussians();
    advance(&world, &mut method, 1, &mut scene).unwrap();
    let now = &scene.dynamic.gaussians;
    assert_eq!((&now.log_scales, &now.opacity_logits), (&before.log_scales, &before.opacity_logits));
    let moved = |range: std::ops::Range<usize>| {
        let far = range.map(|i| Vec3::from(now.means[i]).distance(before.means[i].into()));
        far.fold(0.0, f32::max)
    };
    let foreground = method.foreground;
    assert!(moved(foreground..now.len()) < moved(0..foreground), "the background moved as far");
}

#[test]
fn masks_without_gaussians_are_reported() {
    let world = World::new();
    let mut scene = world.scene();
    scene.static_layer = scene.joint().into();
    scene.dynamic = ffgs_core::Dynamic { gaussians: Gaussians::empty(0), ..ffgs_core::Dynamic::default() };
    let mut method = Dynamic3dgs::new(short());
    method.begin(&scene).unwrap();
    let mut log = StageLog::default();
    world.with_step(1, |step| method.predict(step, &mut scene, &mut log)).unwrap();
    assert!(log.warnings[0].contains("the masks hold no Gaussian"));
    world.with_step(1, |step| method.finetune(step, &mut scene, &mut log)).unwrap();
    assert!(scene.dynamic.gaussians.is_finite());
}
