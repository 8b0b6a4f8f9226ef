//! A method of your own: everything falls. The suite that all methods must pass finds that it moves what stands still.

use anyhow::Result;
use ffgs_core::{Scene, StageLog};
use ffgs_method::{MotionMethod, Step};
use ffgs_testkit::conformance::{World, motion_method};
use glam::DVec3;

/// Half of 9.81 m/s^2 times the square of 1/30 s, upwards (m).
const FIRST_DROP: f32 = -0.00545;

/// Counts the frames; in frame t a thing that was let go falls 2t - 1 times as far as in the first.
#[derive(Default)]
struct Falling(u8);

impl MotionMethod for Falling {
    fn predict(&mut self, _: &Step, scene: &mut Scene, _: &mut StageLog) -> Result<()> {
        self.0 += 1;
        let drop = FIRST_DROP * f32::from(2 * self.0 - 1);
        scene.dynamic.gaussians.means.iter_mut().for_each(|mean| mean[2] += drop);
        Ok(())
    }
}

fn main() -> Result<()> {
    let world = World::new(3, DVec3::ZERO);
    let (mut scene, mut method) = (world.scene(&[0, 1, 2]), Falling::default());
    for frame in 1..4 {
        world.with_step(frame, &[], |step| method.predict(step, &mut scene, &mut StageLog::default()))?;
        println!("frame {frame}: {:?}", scene.dynamic.gaussians.means);
    }
    let verdict = std::panic::catch_unwind(|| motion_method("falling", &|_| Box::new(Falling::default())));
    println!("conforms: {}", verdict.is_ok());
    Ok(())
}
