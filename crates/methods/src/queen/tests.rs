//! Tests of QUEEN on a rigid cloud: what it follows, which gates open, and what a stored frame decodes to.

use super::*;
use crate::world::{World, advance, repeats};
use glam::Vec3;

/// Few steps, with everything that a frame does.
fn short() -> QueenConfig {
    QueenConfig {
        epochs: 3,
        densify_from: 1,
        densify_every: 2,
        grow_gradient: 1e-5,
        ..QueenConfig::default()
    }
}

fn moved(config: QueenConfig, step: Vec3, frames: usize) -> (World, Queen, Scene) {
    let world = World::moving(step);
    let (mut method, mut scene) = (Queen::new(config), world.scene());
    (1..=frames).for_each(|frame| advance(&world, &mut method, frame, &mut scene).unwrap());
    (world, method, scene)
}

#[test]
fn a_resumed_run_and_other_threads_give_equal_bytes() {
    repeats(&|| Box::new(Queen::new(short())));
}

/// Half of the gates start shut, and more shut in time; what is displaced goes along with the body. Gates weigh as in a scene of 90 000
/// Gaussians, as the weight is of a mean.
#[test]
fn what_is_displaced_follows_a_slow_rigid_motion() {
    let config = QueenConfig { grow_gradient: 1e9, gate_weight: 2.5e-5, ..QueenConfig::default() };
    let far = Vec3::new(0.03, 0.015, 0.0);
    let (world, _, scene) = moved(config, far, 1);
    let (before, now) = (world.gaussians(), &scene.dynamic.gaussians);
    let step = |i: usize| Vec3::from(now.means[i]) - Vec3::from(before.means[i]);
    let displaced: Vec<Vec3> = (0..crate::world::BODY).map(step).filter(|step| *step != Vec3::ZERO).collect();
    let count = displaced.len() as f32;
    let along = displaced.iter().map(|step| step.dot(far)).sum::<f32>() / (count * far.length_squared());
    assert!(count > 20.0 && along > 0.4, "{along} of the motion, by {count} Gaussians");
}

#[test]
fn without_training_nothing_changes_and_a_frame_takes_few_bytes() {
    let config = QueenConfig { epochs: 0, ..QueenConfig::default() };
    let (world, method, scene) = moved(config, Vec3::new(0.01, 0.0, 0.0), 1);
    assert_eq!(scene.dynamic.gaussians, world.gaussians());
    assert!(method.file.len() < 600, "{} bytes", method.file.len());
}

#[test]
fn files_decode_to_exactly_what_is_rendered() {
    let world = World::moving(Vec3::new(0.02, 0.0, 0.01));
    let (mut method, mut scene) = (Queen::new(short()), world.scene());
    let mut before = world.gaussians();
    for frame in 1..=3 {
        let ids = scene.dynamic.ids.len();
        advance(&world, &mut method, frame, &mut scene).unwrap();
        assert_eq!(
            read_queen_frame(&method.file, &before).unwrap(),
            scene.dynamic.gaussians,
            "frame {frame}"
        );
        assert!(frame > 1 || scene.dynamic.ids.len() > ids, "nothing was added");
        before = scene.dynamic.gaussians.clone();
    }
    let folder = std::env::temp_dir().join(format!("ffgs-queen-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let stored = method.store(&scene, &folder).unwrap();
    assert_eq!(std::fs::read(&stored[0]).unwrap(), method.file);
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(read_queen_frame(&method.file[..100], &before).is_err(), "half a file");
    assert!(read_queen_frame(&method.file, &world.gaussians().select(&[0, 1])).is_err(), "another frame");
    assert!(read_queen_frame(b"ffqueen1", &before).is_err());
}

#[test]
fn most_of_what_stands_still_is_not_displaced() {
    let config = QueenConfig { grow_gradient: 1e9, ..QueenConfig::default() };
    let (world, _, scene) = moved(config, Vec3::new(0.03, 0.0, 0.0), 1);
    let (now, before) = (&scene.dynamic.gaussians.means, world.gaussians().means);
    let share = |range: std::ops::Range<usize>| {
        let count = range.len();
        range.filter(|&i| now[i] == before[i]).count() as f32 / count as f32
    };
    let (body, backdrop) = (share(0..crate::world::BODY), share(crate::world::BODY..now.len()));
    assert!(backdrop > body && backdrop > 0.6, "{body} of the body and {backdrop} of the backdrop stay");
}

#[test]
fn a_training_that_diverges_says_so() {
    let world = World::moving(Vec3::new(0.01, 0.0, 0.0));
    let mut scene = world.scene();
    scene.dynamic.gaussians.sh[0] = [f32::MAX; 3];
    let error = advance(&world, &mut Queen::new(short()), 1, &mut scene).unwrap_err().to_string();
    assert!(error.contains("diverged") && error.contains("rates"), "{error}");
}
