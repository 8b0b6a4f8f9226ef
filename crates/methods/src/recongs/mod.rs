//! ReCon-GS: Continuum-Preserved Gaussian Streaming for Fast and Compact Reconstruction of Dynamic Scenes (Fu et al., NeurIPS 2025).
//!
//! Nodes are anchors: Gaussians sampled evenly in space, of which every Gaussian follows the nearest of each level. Every few frames they
//! are sampled anew and inherit the motion of the old ones. What all methods of nodes have in common is in [`crate::two_stages`].
//!
//! Deviations, beside those of all such methods:
//! - the mean of quaternions has the sign of the nearest one; the official one has the sign that the eigenvector happens to have;
//! - where a level has fewer than three anchors, an anchor inherits from those that there are; the official code stops.

mod anchors;

use crate::added::AddedConfig;
use crate::deformation::MotionFitConfig;
use crate::two_stages::TwoStages;
use anchors::Anchors;
use ffgs_method::MotionMethod;
use serde::{Deserialize, Serialize};

/// Settings of ReCon-GS.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecongsConfig {
    /// Gaussians per anchor of the finest level: fewer are better and larger.
    pub gaussians_per_anchor: usize,
    /// Levels.
    pub levels: usize,
    /// Anchors of a level, in anchors of the next coarser one.
    pub level_ratio: usize,
    /// Anchors are sampled anew in frames that are multiples of this.
    pub renew_every: usize,
    /// First stage.
    pub motion: MotionFitConfig,
    /// Second stage.
    pub added: AddedConfig,
}

impl Default for RecongsConfig {
    fn default() -> Self {
        Self {
            gaussians_per_anchor: 24,
            levels: 3,
            level_ratio: 3,
            renew_every: 2,
            motion: MotionFitConfig::default(),
            added: AddedConfig::default(),
        }
    }
}

/// The method, before the first frame that moves.
pub fn recongs(config: RecongsConfig) -> impl MotionMethod {
    TwoStages::<Anchors>::new(config)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::{World, advance, repeats};
    use glam::Vec3;

    fn short(renew_every: usize) -> RecongsConfig {
        let mut config = RecongsConfig { gaussians_per_anchor: 5, renew_every, ..RecongsConfig::default() };
        config.motion.iterations = 6;
        config.added = AddedConfig { iterations: 6, densify_every: 4, grow_gradient: 1e-6, ..config.added };
        config
    }

    /// With anchors that stay, whose moments go on, and with new ones.
    #[test]
    fn a_resumed_run_and_other_threads_give_equal_bytes() {
        repeats(&|| Box::new(recongs(short(2))));
        repeats(&|| Box::new(recongs(short(9))));
    }

    #[test]
    fn a_slow_rigid_motion_is_followed() {
        let world = World::moving(Vec3::new(0.01, 0.005, 0.0));
        let mut config = RecongsConfig::default();
        config.added.grow_gradient = 1e9;
        let (mut method, mut scene) = (recongs(config), world.scene());
        let [.., still] = world.errors(&scene, 1);
        advance(&world, &mut method, 1, &mut scene).unwrap();
        let [.., found] = world.errors(&scene, 1);
        // Ten anchors for 230 Gaussians: 0.37 was measured.
        assert!(found < 0.5 * still, "{found} m of {still} m");
    }
}
