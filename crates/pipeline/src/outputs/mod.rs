//! What a run writes into its folder, and how that is read again.

pub(crate) mod camera_pictures;
pub mod exposure_files;
pub mod finished_run;
pub mod folder;
pub mod json;
pub mod orbit;
pub mod picture;
pub mod publish;
pub mod record;
pub(crate) mod scene_files;
pub mod scoring;
pub mod state;
pub(crate) mod turntable;
