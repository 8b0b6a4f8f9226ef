//! Lifts displaced projections of Gaussians to 3D positions with covariances (Algorithm 1, lines 20 to 24).
//!
//! Everything is solved relative to the previous mean, so that coordinates of any size stay exact. Gaussians are
//! independent apart from one pooled noise scale, which is summed in a fixed order: results do not depend on the
//! number of threads.
//!
//! A vector holds several Gaussians, one per lane, and every loop runs over the views that any of them was observed in, whose
//! camera is broadcast. A lane's sums do not depend on the other lanes. Gaussians with similar numbers of views share a
//! vector, so that its lanes finish together: they are sorted by the views that observed them, then by the number of views that will probably be removed.
//!
//! What it costs, at the least: 24 bytes read for each observation; a sum over the views of about 60 operations each for
//! every re-weighting of the rays, Gauss-Newton step and removed view; and 36 shorter ones where most views do not agree.
//!
//! ```
//! use ffgs_core::{Camera, Estimates, EstimateStatus, ImageSize, Intrinsics, Observations};
//! use ffgs_triangulation::WeightedRays;
//! use glam::{DMat4, DVec3};
//!
//! let size = ImageSize { width: 64, height: 48 };
//! let intrinsics = Intrinsics { fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
//! let pose = |x| DMat4::from_translation(DVec3::new(x, 0.0, 0.0));
//! let cameras = [-1.0, 0.0, 1.0].map(|x| Camera::new(intrinsics, pose(x), size).unwrap());
//! let truth = DVec3::new(0.1, 0.2, 4.0);
//! let mut observations = Observations::unobserved(3, 1);
//! for (v, camera) in cameras.iter().enumerate() {
//!     observations.targets[v] = camera.project(truth).unwrap().pixel;
//!     observations.weights[v] = 1.0;
//! }
//! let mut out = Estimates::default();
//! let previous = [DVec3::new(0.0, 0.0, 4.0)];
//! WeightedRays::default().triangulate(&previous, &cameras, &observations, &mut out)?;
//! assert_eq!(out.status[0], EstimateStatus::Ok);
//! assert!((out.means[0] - truth).length() < 1e-9);
//! # Ok::<(), ffgs_triangulation::TriangulationError>(())
//! ```

mod config;
mod normal;
mod passes;
#[cfg(test)]
mod problems;
mod robust;
mod simd;
mod solve;
mod views;
mod weighted_rays;

pub use config::TriangulationConfig;
pub use weighted_rays::{TriangulationError, WeightedRays};
