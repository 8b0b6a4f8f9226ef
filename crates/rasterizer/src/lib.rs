//! Differentiable rasterization of 3D Gaussians on the CPU.
//!
//! Projection (EWA), exact tile coverage, a depth sort per tile, blending in 8 or 16 SIMD lanes, and a backward pass
//! that walks the same lists front to back. Every result is bit-identical for any number of threads: a tile is one
//! unit of work, and per-Gaussian sums run over its tiles in a fixed order.
//!
//! ```
//! use ffgs_core::{Camera, Gaussians, ImageSize, Intrinsics};
//! use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, View};
//! let size = ImageSize { width: 32, height: 24 };
//! let intrinsics = Intrinsics { fx: 30.0, fy: 30.0, cx: 16.0, cy: 12.0 };
//! let camera = Camera::new(intrinsics, glam::DMat4::IDENTITY, size).unwrap();
//! let mut gaussians = Gaussians::zeros(1, 0);
//! gaussians.means[0] = [0.0, 0.0, 2.0];
//! gaussians.quats[0] = [1.0, 0.0, 0.0, 0.0];
//! gaussians.log_scales[0] = [-2.0; 3];
//! let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
//! let mut tape = RenderTape::default();
//! CpuRasterizer::new(RenderOptions::default()).render(&gaussians, &view, &mut tape);
//! assert!(tape.transmittance()[12 * 32 + 16] < 0.6);
//! ```

mod association;
mod backward;
mod blend;
mod block;
mod chunks;
mod compose;
pub mod constants;
mod contributor_lists;
mod coverage;
mod cpu;
mod dropout;
mod elementary;
mod expansion;
mod footprint;
mod gradients;
mod information;
mod pinhole;
mod projection;
mod projection_backward;
mod spherical_harmonics;
mod split;
mod tape;
mod tile_lists;
mod tiles;
mod top_contributors;
mod view;

pub use association::{Association, AssociationScene, AssociationScratch, Observed};
pub use constants::TILE;
pub use contributor_lists::{ContributorError, ContributorLists, ListedMotion, associate_lists};
pub use cpu::CpuRasterizer;
pub use dropout::Dropout;
pub use footprint::FootprintSums;
pub use gradients::{Gradients, PixelGradients};
pub use information::Information;
pub use pinhole::pixel_filter;
pub use spherical_harmonics::basis as sh_basis;
pub use split::{SplitLayers, TileDepths};
pub use tape::RenderTape;
pub use tiles::TileMask;
pub use top_contributors::TopContributors;
pub use view::{Background, RenderOptions, View};
