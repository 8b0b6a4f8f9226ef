//! Footage to a capture.
//!
//! Four steps, each of which can be repeated alone: pictures (extraction and undistortion, with the camera lists),
//! masks, points and tracks. A file that is there is complete and is not made again.

mod agreement;
mod beside;
mod blocks;
mod camera_lists;
mod conversion;
mod dark;
mod depth_maps;
mod error;
mod extraction;
mod foreground;
mod free_space;
mod ground;
mod hull;
mod in_place;
mod journal;
mod masks;
mod moments;
mod names;
mod networks;
#[cfg(test)]
mod painted;
mod patch_match;
mod pictures;
mod points;
mod preparation;
mod progress;
mod region;
mod removal;
mod request;
mod rig;
mod rows;
mod schedule;
mod silhouettes;
mod spread;
mod stereo;
mod surfaces;
mod thinning;
mod timing;
mod tracker_list;
mod tracking;
mod tracks;
mod unexplained;
mod video;
mod views;
mod windows;

pub use conversion::{Layout, convert};
pub use error::PrepareError;
pub use in_place::InPlace;
pub use preparation::{Summary, prepare};
pub use progress::Progress;
pub use request::{Request, Step, TestCameras};
pub use tracking::track;
