//! Splat files: 3DGS PLY (with position covariances as extra properties), checkpoints that restore a frame's state
//! bit by bit, and the sky cube map as PNG.
//!
//! Every file is written through a temporary one and a rename: a reader sees the whole file or none.

mod bytes;
mod checkpoint;
mod error;
mod ply_header;
mod ply_read;
mod ply_write;
mod sky;

pub use checkpoint::{FrameState, load_checkpoint, save_checkpoint};
pub use error::{Problem, SplatError};
pub use ply_read::{PlySplats, read_ply};
pub use ply_write::{Tracked, write_ply};
pub use sky::{SKY_FACES, write_sky_cross, write_sky_faces};
