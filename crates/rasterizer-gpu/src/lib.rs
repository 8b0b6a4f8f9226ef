//! Differentiable rasterization of 3D Gaussians on the GPU; the CPU crate `ffgs-rasterizer` is its twin.
//!
//! Projection with exact tile coverage, a stable radix sort by depth, lists per tile, blending, and a backward pass that
//! walks the same lists front to back. No float is summed in an order that depends on scheduling: equal inputs give
//! equal bits on one adapter. Sizes that depend on the scene are counted on the device; a render that found too
//! little room says so, and is repeated with more.
//!
//! ```
//! use ffgs_core::{Camera, Gaussians, ImageSize, Intrinsics};
//! use ffgs_rasterizer::{Background, RenderOptions, View};
//! use ffgs_rasterizer_gpu::GpuRasterizer;
//! let size = ImageSize { width: 32, height: 24 };
//! let intrinsics = Intrinsics { fx: 30.0, fy: 30.0, cx: 16.0, cy: 12.0 };
//! let camera = Camera::new(intrinsics, glam::DMat4::IDENTITY, size).unwrap();
//! let mut gaussians = Gaussians::zeros(1, 0);
//! gaussians.means[0] = [0.0, 0.0, 2.0];
//! gaussians.log_scales[0] = [-2.0; 3];
//! let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
//! // A machine may have no adapter.
//! if let Ok(gpu) = ffgs_gpu::Gpu::open(None) {
//!     let rendered = GpuRasterizer::new(&gpu, RenderOptions::default())?.render(&gaussians, &view)?;
//!     assert!(rendered.transmittance[12 * 32 + 16] < 0.6);
//! }
//! # Ok::<(), ffgs_gpu::GpuError>(())
//! ```

mod device;
mod encode;
mod footprint;
mod kernels;
mod layout;
mod rasterize;
mod scene;
mod scratch;
#[cfg(test)]
mod shader_tests;
mod view;

pub use device::{Place, SceneDevice};
pub use encode::{backward, bin_to_tiles, count_views, prepare, render, render_split, tile_depths};
pub use footprint::{Footprints, Planes};
pub use kernels::{LEDGER, VIEW};
pub use layout::{Geometry, Ledger};
pub use rasterize::{GpuRasterizer, Rendered, VIEWS_PER_SUBMISSION};
pub use scene::{GpuGradients, GpuScene};
pub use scratch::{Capacity, Scratch};
pub use view::GpuView;
