//! Triangulation of all Gaussians from the displaced projections of one tracker (Algorithm 1, lines 21 to 24), and its noise scale.

use crate::config::TriangulationConfig;
use crate::passes::RayWeights;
use crate::robust::{self, Scales};
use crate::simd::MAX_LANES;
use crate::solve::{Solution, Start, begin, finish};
use crate::views::{ViewCamera, Views};
use ffgs_core::{Camera, EstimateStatus, Estimates, Observations, instructions};
use glam::{DMat3, DVec3};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use thiserror::Error;

/// Why a whole batch could not be triangulated.
#[derive(Debug, Error, PartialEq)]
pub enum TriangulationError {
    /// The observations do not match the means or cameras.
    #[error(
        "observations hold {views} views of {gaussians} Gaussians; given {cameras} cameras and {means} means"
    )]
    Shape {
        /// Views of the observations.
        views: usize,
        /// Gaussians of the observations.
        gaussians: usize,
        /// Cameras given.
        cameras: usize,
        /// Previous means given.
        means: usize,
    },
    /// A column of the observations is not `views * gaussians` long.
    #[error("an observation column holds {found} entries, expected {expected}")]
    Column {
        /// Entries found.
        found: usize,
        /// Entries expected.
        expected: usize,
    },
    /// The settings hold a number out of range.
    #[error("triangulation settings out of range: {0:?}")]
    Config(Box<TriangulationConfig>),
}

/// Weighted least squares over viewing rays (Algorithm 1, lines 21 to 24), robust, refined to the maximum-likelihood
/// point, with a noise scale shrunk to what all Gaussians of the tracker and frame show.
#[derive(Clone, Copy, Debug, Default)]
pub struct WeightedRays {
    /// Settings.
    pub config: TriangulationConfig,
}

impl WeightedRays {
    /// Lifts one tracker's displaced projections to positions with covariances. Fills `out` (columns of length N) from the
    /// previous means (N, m), the V cameras **at time t** and the (V, N) observations. What fails for a Gaussian is its
    /// status; then its mean is the previous one, its covariance zero.
    ///
    /// # Errors
    /// [`TriangulationError`] when shapes do not match or settings are out of range.
    pub fn triangulate(
        &self,
        previous: &[DVec3],
        cameras: &[Camera],
        observations: &Observations,
        out: &mut Estimates,
    ) -> Result<(), TriangulationError> {
        check_shapes(previous, cameras, observations)?;
        if !self.config.is_valid() {
            return Err(TriangulationError::Config(Box::new(self.config)));
        }
        let view_cameras: Vec<ViewCamera> = cameras.iter().map(ViewCamera::from).collect();
        let batch = Batch { config: &self.config, previous, view_cameras: &view_cameras, observations };
        let scales = batch.scales();
        let mut solutions = vec![Err(EstimateStatus::TooFewViews); previous.len()];
        let arch = instructions();
        solutions.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
            arch.dispatch(SolveChunk { batch: &batch, scales, first: chunk * CHUNK, out });
        });
        let pooled = pooled_variance(&solutions);
        let max_step = self.config.max_step * typical_distance(previous, cameras);
        out.means.resize(previous.len(), DVec3::ZERO);
        out.covariances.resize(previous.len(), DMat3::ZERO);
        out.status.resize(previous.len(), EstimateStatus::TooFewViews);
        let columns = out.means.par_iter_mut().zip(&mut out.covariances).zip(&mut out.status);
        columns.zip(&solutions).zip(previous).with_min_len(CHUNK).for_each(|((to, solution), &mean)| {
            let ((place, covariance), status) = to;
            let step;
            (step, *covariance, *status) = accept(solution, (pooled, max_step), &self.config);
            *place = mean + step;
        });
        Ok(())
    }
}

type Outcome = Result<Solution, EstimateStatus>;

struct Batch<'a> {
    config: &'a TriangulationConfig,
    previous: &'a [DVec3],
    view_cameras: &'a [ViewCamera],
    observations: &'a Observations,
}

/// Gaussians a task solves: neighbours in the columns of the observations, so that cache lines are shared.
const CHUNK: usize = 512;
/// The same of the noise scale.
const SAMPLE_CHUNK: usize = 64;
/// Gaussians the noise scale of the robust cut is taken from.
const SCALE_SAMPLES: usize = 512;
/// Rounds of the noise scale, each with the soft scale of the one before.
const SCALE_ROUNDS: usize = 4;

impl Batch<'_> {
    /// The Gaussians of a chunk, those that the same views observed side by side: so the lanes of a group are busy.
    fn by_visibility(&self, first: usize, count: usize) -> Vec<u32> {
        let Observations { gaussians, weights, .. } = self.observations;
        let mut keys: Vec<(u64, u32)> = (first..first + count).map(|i| (0, i as u32)).collect();
        for v in 0..self.view_cameras.len() {
            let bit = 1 << (63 - v * 64 / self.view_cameras.len().max(64));
            let row = &weights[v * gaussians + first..][..count];
            for (key, weight) in keys.iter_mut().zip(row) {
                key.0 |= if *weight > 0.0 { bit } else { 0 };
            }
        }
        keys.sort_unstable();
        keys.into_iter().map(|(_, i)| i).collect()
    }

    /// The configured robust scales, raised where the trackers' noise is larger than they expect.
    fn scales(&self) -> Scales {
        let TriangulationConfig { outlier_soft_px: soft, outlier_cut_px: cut, .. } = *self.config;
        let mut noise = 0.0;
        if self.config.robust {
            // Too small a soft scale hides noise in few views: measure again with the scale just found.
            for _ in 0..SCALE_ROUNDS {
                noise = self.typical_noise(soft.max(2.0 * noise));
            }
        }
        Scales { soft: soft.max(2.0 * noise), cut: cut.max(4.0 * noise) }
    }

    /// Median-based noise per axis (px) over an even subset of the Gaussians; robust against outliers in fewer than
    /// half of the views.
    fn typical_noise(&self, soft: f64) -> f64 {
        let stride = self.previous.len().div_ceil(SCALE_SAMPLES).max(1);
        let samples: Vec<u32> = (0..self.previous.len() as u32).step_by(stride).collect();
        let arch = instructions();
        let parts = samples.par_chunks(SAMPLE_CHUNK);
        let mut residuals: Vec<f64> = parts
            .flat_map_iter(|samples| arch.dispatch(SoftResiduals { batch: self, soft, samples }))
            .collect();
        if residuals.is_empty() {
            return 0.0;
        }
        let middle = residuals.len() / 2;
        let (_, median, _) = residuals.select_nth_unstable_by(middle, f64::total_cmp);
        // The median of a squared two-dimensional normal residual is 2 ln 2 sigma^2.
        let variance = *median / (2.0 * std::f64::consts::LN_2);
        if variance.is_finite() { variance.sqrt() } else { 0.0 }
    }
}

/// Solves the Gaussians from `first` on.
struct SolveChunk<'a> {
    batch: &'a Batch<'a>,
    scales: Scales,
    first: usize,
    out: &'a mut [Outcome],
}

impl WithSimd for SolveChunk<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { batch, scales, first, out } = self;
        let Batch { config, previous, observations, .. } = *batch;
        let mut views = Views::new(simd, batch.view_cameras);
        let order = batch.by_visibility(first, out.len());
        let mut begun = Vec::with_capacity(order.len());
        for group in order.chunks(S::F64_LANES) {
            let mut starts = [Start::NONE; MAX_LANES];
            views.gather(previous, observations, group, true);
            begin(&views, config, scales, &mut starts[..group.len()]);
            begun.extend(group.iter().copied().zip(starts));
        }
        let rays = !config.refine || config.collinear_degrees != 0.0;
        begun.sort_by_key(|(_, start)| start.doubtful);
        for group in begun.chunks(S::F64_LANES) {
            let (mut gaussians, mut starts) = ([0; MAX_LANES], [Start::NONE; MAX_LANES]);
            for (k, &(i, start)) in group.iter().enumerate() {
                (gaussians[k], starts[k]) = (i, start);
            }
            let n = group.len();
            let mut solutions = [Err(EstimateStatus::TooFewViews); MAX_LANES];
            views.gather(previous, observations, &gaussians[..n], rays);
            finish(&mut views, &starts[..n], config, scales, &mut solutions[..n]);
            for (&(i, _), solution) in group.iter().zip(solutions) {
                out[i as usize - first] = solution;
            }
        }
    }
}

/// Squared residuals (px^2) of Gaussians about their softly re-weighted points, corrected for the three fitted
/// coordinates.
struct SoftResiduals<'a> {
    batch: &'a Batch<'a>,
    soft: f64,
    samples: &'a [u32],
}

impl WithSimd for SoftResiduals<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<f64> {
        let Self { batch, soft, samples } = self;
        let mut views = Views::new(simd, batch.view_cameras);
        let mut out = Vec::new();
        for group in samples.chunks(S::F64_LANES) {
            views.gather(batch.previous, batch.observations, group, true);
            let (start, solved) = views.meet([views.number(0.0); 3], RayWeights::Depth).solve(simd);
            let lanes = solved & views.number(3.0).le(views.count);
            let point = robust::reweight(&views, lanes, start, soft);
            views.push_errors(lanes, point, &mut out);
        }
        out
    }
}

/// `s0^2 = sum of all residuals / sum of all degrees of freedom` (px^2), summed in order.
fn pooled_variance(solutions: &[Outcome]) -> f64 {
    let solved = solutions.iter().flatten();
    let (sum, degrees) = solved.fold((0.0, 0.0), |(r, k), s| (r + s.residuals, k + s.degrees));
    if degrees > 0.0 { sum / degrees } else { 1.0 }
}

/// Shrinks the variance, scales the covariance and applies the acceptance limits.
fn accept(
    outcome: &Outcome,
    (pooled, max_step): (f64, f64),
    config: &TriangulationConfig,
) -> (DVec3, DMat3, EstimateStatus) {
    let failed = |status| (DVec3::ZERO, DMat3::ZERO, status);
    let solution = match outcome {
        Ok(solution) => solution,
        Err(status) => return failed(*status),
    };
    let prior = config.pooled_degrees;
    let variance = (prior * pooled + solution.residuals) / (prior + solution.degrees);
    let covariance = solution.unit_covariance * variance.max(config.min_noise_px * config.min_noise_px);
    let rms = (solution.residuals / solution.views as f64).sqrt();
    if !(rms <= config.max_residual_px) {
        return failed(EstimateStatus::Residual);
    }
    let length = solution.step.length();
    let direction = solution.step.normalize_or_zero();
    let own_sigma = direction.dot(covariance * direction).max(0.0).sqrt();
    if !(length - 3.0 * own_sigma <= max_step) {
        return failed(EstimateStatus::Step);
    }
    (solution.step, covariance, EstimateStatus::Ok)
}

/// Median distance (m) of an even subset of `means` (m) from the cameras.
fn typical_distance(means: &[DVec3], cameras: &[Camera]) -> f64 {
    let sample = means.iter().step_by(means.len().div_ceil(SCALE_SAMPLES).max(1));
    let mut distances: Vec<f64> =
        sample.flat_map(|mean| cameras.iter().map(|camera| camera.center().distance(*mean))).collect();
    let middle = distances.len() / 2;
    if distances.is_empty() { 0.0 } else { *distances.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

fn check_shapes(
    previous: &[DVec3],
    cameras: &[Camera],
    observations: &Observations,
) -> Result<(), TriangulationError> {
    let Observations { views, gaussians, .. } = *observations;
    if views != cameras.len() || gaussians != previous.len() {
        let (cameras, means) = (cameras.len(), previous.len());
        return Err(TriangulationError::Shape { views, gaussians, cameras, means });
    }
    let expected = views * gaussians;
    for found in [observations.targets.len(), observations.weights.len()] {
        if found != expected {
            return Err(TriangulationError::Column { found, expected });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
