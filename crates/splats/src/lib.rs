//! Splat files: 3DGS PLY (with position covariances as extra properties), the formats of today's players (compressed PLY,
//! SPZ, SOG, GLB), checkpoints that restore a frame's state bit by bit, and the sky as PNG or JPEG.
//!
//! Every file is written through a temporary one and a rename: a reader sees the whole file or none.

mod bytes;
mod checkpoint;
mod codebook;
mod compressed_ply;
mod error;
mod format;
mod formats;
mod glb;
mod ply_header;
mod ply_read;
mod ply_write;
mod quantise;
mod sky;
mod sog;
mod spz;

pub use checkpoint::{FrameState, load_checkpoint, save_checkpoint};
pub use error::{Problem, SplatError};
pub use ffgs_method::Followed;
pub use formats::FORMATS;
pub use ply_read::{PlySplats, read_ply};
pub use ply_write::write_ply;
pub use sky::{Panorama, encode_sky_equirectangular, write_sky_cross, write_sky_equirectangular};
pub use spz::decode_spz;
