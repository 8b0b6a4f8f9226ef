//! Settings of the fusion: the prior's model, the process noise, and whether neighbours inform each other.

use crate::groups::GroupsConfig;
use crate::neighbourhoods::StructureConfig;
use serde::{Deserialize, Serialize};

/// Where the prior expects a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PriorModel {
    /// Where it was (Algorithm 1, line 30).
    #[default]
    RandomWalk,
    /// Where its last step would take it.
    ConstantVelocity,
}

/// Over which Gaussians q is the median.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProcessNoise {
    /// All of them (Algorithm 1, line 26).
    #[default]
    Global,
    /// Those of the same group.
    PerObject,
}

/// Whether neighbours inform each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Structure {
    /// Every Gaussian by itself (literal Algorithm 1).
    None,
    /// Robust rigid motion of the neighbourhood replaces the random walk as the prior.
    RigidNeighbours,
    /// Robust rigid motion of what moves together; Gaussians that leave it take that of their neighbourhood.
    #[default]
    RigidGroups,
}

/// Settings of [`crate::InformationFuser`]; [`FusionConfig::literal`] is Algorithm 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FusionConfig {
    /// Motion model of the prior.
    pub prior: PriorModel,
    /// Extent of the median q.
    pub q_mode: ProcessNoise,
    /// Least q (px at the Gaussians' median depth), without structure; 0 = literal.
    pub q_floor_px: f64,
    /// Squared Mahalanobis distance to the fused estimate beyond which a tracker's estimate is left out (the worst
    /// first); 0 = no gate (literal). 16.3 keeps 99.9 % of consistent estimates.
    pub gate: f64,
    /// Factor on the trackers' covariances for the mistakes they share; 1 = independent (literal).
    pub correlation_inflation: f64,
    /// Whether neighbours inform each other.
    pub structure: Structure,
    /// Settings of the neighbourhood motion.
    pub rigid: StructureConfig,
    /// Settings of the rigid groups.
    pub groups: GroupsConfig,
}

impl Default for FusionConfig {
    fn default() -> Self {
        Self {
            prior: PriorModel::default(),
            q_mode: ProcessNoise::default(),
            q_floor_px: 0.25,
            gate: 0.0,
            correlation_inflation: 1.0,
            structure: Structure::default(),
            rigid: StructureConfig::default(),
            groups: GroupsConfig::default(),
        }
    }
}

impl FusionConfig {
    /// Our most literal reading of Algorithm 1.
    pub fn literal() -> Self {
        Self { structure: Structure::None, q_floor_px: 0.0, ..Self::default() }
    }
}
