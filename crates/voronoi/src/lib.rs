//! Densifies point tracks into motion fields (Algorithm 2) and scores how well the trackers agree (Algorithm 1,
//! lines 10 to 13).
//!
//! Every interpolator stands behind [`MotionInterpolator`]; [`densify_view`] is the whole stage of one view: source
//! filter, interpolation, visibility. Results do not depend on the number of threads.
//!
//! ```
//! use ffgs_core::{ImageSize, TrackSet};
//! use ffgs_voronoi::{GaussianKnn, MotionInterpolator};
//!
//! let tracks = TrackSet { src: vec![[4.5, 3.5]], tgt: vec![[6.5, 3.5]], visibility: vec![1.0] };
//! let size = ImageSize { width: 16, height: 8 };
//! let motion = GaussianKnn::default().densify(&tracks, size, None)?;
//! assert_eq!(motion.flow[0], [2.0, 0.0]);
//! assert_eq!(motion.confidence[3 * 16 + 4], 1.0);
//! # Ok::<(), ffgs_voronoi::MotionError>(())
//! ```

mod agreement;
mod config;
mod exponential;
mod gaussian_knn;
#[cfg(test)]
mod instruction_sets;
mod interpolator;
mod kernel_mean;
mod natural_neighbour;
mod nearest;
mod normalised;

pub use agreement::{AgreementConfig, agreement};
pub use config::{Method, SourceFilter, VoronoiConfig, densify_view, filter_sources};
pub use gaussian_knn::GaussianKnn;
pub use interpolator::{IntegerCentredTracks, MotionError, MotionInterpolator};
pub use natural_neighbour::NaturalNeighbour;
