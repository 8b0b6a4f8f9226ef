//! Motion fields of one view on the GPU: tracks to fields, agreement between trackers, and what association sums over a
//! Gaussian's footprint. `ffgs-voronoi` is the twin of the first two.
//!
//! Only masked pixels are computed. Tracks go to the device, dense fields in 16-bit numbers; the planes stay there and are
//! read by the rasterizer's footprint kernel, so that a view costs the way back of its sums only.
//!
//! ```
//! use ffgs_core::{ImageSize, Mask, TrackSet};
//! use ffgs_motion_gpu::ViewFields;
//! use ffgs_voronoi::VoronoiConfig;
//! let tracks = TrackSet { src: vec![[4.5, 3.5]], tgt: vec![[6.5, 3.5]], visibility: vec![1.0] };
//! let mask = Mask::filled(ImageSize { width: 16, height: 8 }, true);
//! // A machine may have no adapter.
//! if let Ok(gpu) = ffgs_gpu::Gpu::open(None) {
//!     let fields = ViewFields::new(&gpu, &mask, 1)?;
//!     fields.densify(0, &VoronoiConfig::default(), &tracks, &mask)?;
//!     assert_eq!(fields.download(0)?.flow[0], [2.0, 0.0]);
//! }
//! # Ok::<(), ffgs_motion_gpu::FieldsError>(())
//! ```

mod fields;
mod kernels;
mod layout;
mod packed;
#[cfg(test)]
mod shader_tests;

pub use fields::{FieldsError, ViewFields, supports};
