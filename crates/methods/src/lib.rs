//! Methods of others behind the contract, for comparison on one rasterizer: a file or folder each.
//!
//! Written from the papers and from facts in the official code (losses, rates, schedules, structures). Each file says in its head
//! where it deviates. All train every Gaussian by whole photographs, from the same first frame (docs/adr/0036).

mod added;
mod deformation;
mod dynamic3dgs;
mod hicom;
mod nearest;
mod neighbours;
mod one_layer;
mod photographs;
mod queen;
mod recongs;
mod saved;
mod storage;
mod trackersplat;
mod two_stages;
#[cfg(test)]
mod world;

pub use added::AddedConfig;
pub use deformation::MotionFitConfig;
pub use dynamic3dgs::{Dynamic3dgs, Dynamic3dgsConfig};
pub use hicom::{HicomConfig, hicom};
pub use queen::{Queen, QueenConfig, read_queen_frame};
pub use recongs::{RecongsConfig, recongs};
pub use trackersplat::{Trackersplat, TrackersplatConfig, TrainLayer};

use serde::{Deserialize, Serialize};

/// Settings of these methods, a table each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MethodSettings {
    /// Dynamic 3D Gaussians.
    pub dynamic3dgs: Dynamic3dgsConfig,
    /// HiCoM.
    pub hicom: HicomConfig,
    /// QUEEN.
    pub queen: QueenConfig,
    /// ReCon-GS.
    pub recongs: RecongsConfig,
    /// TrackerSplat.
    pub trackersplat: TrackersplatConfig,
}
