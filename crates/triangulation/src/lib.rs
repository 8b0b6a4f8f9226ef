//! Lifts displaced projections of Gaussians to positions with covariances.
