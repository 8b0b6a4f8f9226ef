//! Gaussians for viewers that do not compensate the opacity of small splats.
//!
//! Everything here trains with the compensation of Mip-Splatting (Yu et al. 2024): a splat that is thinner than the pixel
//! filter is drawn with less opacity, by `sqrt(det S / det (S + 0.3 I))` in pixels. Ordinary viewers draw it with its full
//! opacity, so that thin Gaussians seen edge on cover what lies behind them. The factor depends on the view, therefore no
//! single opacity is exact. Two steps come near: [`conserve_weight`] gives each Gaussian the opacity with which its blending
//! weight, summed over all views, stays what it was; [`fit`] then fits all parameters by plain rasterization to renders of what was
//! trained, from the cameras and from between them.

mod fit;
mod target;
mod viewpoints;
mod weight;

pub use fit::{FitConfig, fit};
pub use weight::conserve_weight;
