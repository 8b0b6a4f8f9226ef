//! Fuses the trackers' estimates with the temporal prior (Algorithm 1, lines 25 to 34), checks the result against the
//! masks (lines 35 to 40) and plans the densification of uncertain Gaussians (line 42).
//!
//! ```
//! use ffgs_core::{EstimateStatus, Estimates};
//! use ffgs_fusion::{FusionConfig, FusionInput, InformationFuser, Structure};
//! use glam::{DMat3, DVec3};
//!
//! let config = FusionConfig { structure: Structure::None, ..FusionConfig::default() };
//! let estimate = Estimates {
//!     means: vec![DVec3::X],
//!     covariances: vec![DMat3::IDENTITY * 1e-4],
//!     status: vec![EstimateStatus::Ok],
//! };
//! let fused = InformationFuser { config }.fuse(&FusionInput {
//!     prior_means: &[DVec3::ZERO],
//!     prior_covariances: &[DMat3::IDENTITY * 1e-4],
//!     estimates: &[estimate],
//!     previous_steps: None,
//!     groups: None,
//!     last_q: 0.0,
//!     q_floor_m: 0.0,
//!     observed: None,
//!     flexibility: None,
//! })?;
//! assert_eq!(fused.q, 1.0);
//! assert!((fused.means[0].x - 1.0).abs() < 1e-3);
//! # Ok::<(), ffgs_fusion::FusionError>(())
//! ```

mod apart;
mod cell_views;
mod cells;
mod config;
mod correlation;
mod error;
mod evidence;
mod flexibility;
mod fuse;
mod groups;
mod growth;
mod input;
mod members;
mod motion_fit;
mod neighbourhoods;
mod normal;
mod prediction;
mod prior;
mod process_noise;
mod rigid;
mod seeds;
mod structure;
mod symmetric;
mod validation;
mod view_counts;
mod votes;

pub use cell_views::ViewObservations;
pub use config::{FusionConfig, PriorModel, ProcessNoise, Structure};
pub use error::FusionError;
pub use fuse::{Fused, InformationFuser, initial_covariance, symmetric_inverse};
pub use groups::{Group, Groups, GroupsConfig, spatial_objects};
pub use growth::{GrowthAction, GrowthConfig, apply_growth, plan_growth};
pub use input::FusionInput;
pub use neighbourhoods::{StructureConfig, StructurePrior};
pub use prediction::{Departures, Prediction};
pub use rigid::{RigidMotion, fit_rigid};
pub use seeds::{Seed, SeedView, first_of_each_cell, seeds, steps_of_nearest};
pub use validation::{Silhouettes, Slack, second_chance, validate};
pub use view_counts::{ViewCounts, count_views};
