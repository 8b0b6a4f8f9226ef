//! The method `none`: every Gaussian starts where the last frame ended, so that training alone follows the motion.

use anyhow::Result;
use ffgs_core::{Scene, StageLog};
use ffgs_method::{MotionMethod, Step};

/// Every frame starts where the last one ended: what the motion initialisation is compared with.
#[derive(Clone, Copy, Debug, Default)]
pub struct Standstill;

impl MotionMethod for Standstill {
    fn predict(&mut self, _: &Step, scene: &mut Scene, _: &mut StageLog) -> Result<()> {
        scene.dynamic.steps.clear();
        Ok(())
    }
}
