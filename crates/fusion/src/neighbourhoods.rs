//! Rigid motions of neighbourhoods, fitted robustly to the trackers' measurements, as the prior of single Gaussians.

use crate::error::FusionError;
use crate::evidence::{MEDIAN_CHI2, MEDIAN_LENGTH, MIN_SCALE};
use crate::rigid::{RigidMotion, fit_rigid};
use ffgs_core::median;
use glam::{DMat3, DQuat, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::num::NonZero;

/// Settings of the neighbourhood motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StructureConfig {
    /// Measured neighbours a motion is fitted to.
    pub neighbours: usize,
    /// Fewest measured Gaussians for which there is any structure.
    pub min_measured: usize,
    /// Most neighbourhoods fitted; Gaussians blend the nearest ones.
    pub max_seeds: usize,
    /// Neighbourhoods that each Gaussian blends.
    pub blend: usize,
    /// Neighbours that share their error: 200 neighbours count as 200 / this many independent ones. Measured on two
    /// simulated cars: 25 raises the error by a sixth and does not improve the calibration.
    pub correlated: f64,
    /// Squared Mahalanobis distance beyond which a Gaussian's own evidence contradicts its neighbourhood and widens
    /// its prior; 11.3 is the 99 % point.
    pub leave: f64,
}

impl Default for StructureConfig {
    fn default() -> Self {
        Self { neighbours: 200, min_measured: 16, max_seeds: 400, blend: 6, correlated: 60.0, leave: 11.3 }
    }
}

/// What the neighbourhoods say of every Gaussian, columns of length N.
#[derive(Clone, Debug)]
pub struct StructurePrior {
    /// Predicted places (m).
    pub means: Vec<DVec3>,
    /// Covariances of the predicted motion (m^2), without that of the place at t-1.
    pub covariances: Vec<DMat3>,
    /// Rotation of the neighbourhood from t-1 to t.
    pub rotations: Vec<DQuat>,
    /// Factor on the trackers' covariances learnt from how they scatter about the rigid motion.
    pub inflation: f64,
}

/// Robust rigid motion of the neighbourhood of every `wanted` Gaussian, fitted to the measured means; beyond the paper.
///
/// `previous` (N, m) at t-1, `means` and `covariances` (N) the trackers' combined measurement at t, valid where
/// `measured`. What is not wanted keeps its previous place. `None` when too few are measured. Neighbourhoods of moving parts overlap, so each Gaussian weighs them
/// by how well they explain its own and its nearest neighbours' measurements.
///
/// # Errors
/// [`FusionError::Index`] when the spatial index refuses the points.
pub(crate) fn local_rigid_motion(
    previous: &[DVec3],
    means: &[DVec3],
    covariances: &[DMat3],
    measured: &[bool],
    wanted: &[bool],
    config: &StructureConfig,
) -> Result<Option<StructurePrior>, FusionError> {
    let donors: Vec<usize> = (0..previous.len()).filter(|&i| measured[i]).collect();
    if donors.len() < config.min_measured.max(4) {
        return Ok(None);
    }
    let cloud = Cloud::new(previous, means, covariances, donors)?;
    let centres: Vec<usize> = cloud.donors.iter().copied().filter(|&i| wanted[i]).collect();
    let centres = if centres.is_empty() { cloud.donors.clone() } else { centres };
    let stride = centres.len().div_ceil(config.max_seeds.max(1));
    let places: Vec<usize> = centres.into_iter().step_by(stride.max(1)).collect();
    let seeds: Vec<Seed> = places.par_iter().filter_map(|&i| cloud.seed(i, config)).collect();
    if seeds.is_empty() {
        return Ok(None);
    }
    let centres: Vec<[f64; 3]> = seeds.iter().map(|s| (s.motion.centre - cloud.origin).to_array()).collect();
    let tree = tree(&centres)?;
    let predictions: Vec<Prediction> = (0..previous.len())
        .into_par_iter()
        .map(|i| {
            if wanted[i] {
                cloud.predict(i, &seeds, &tree, config)
            } else {
                Prediction { place: previous[i], variance: 1.0, rotation: DQuat::IDENTITY }
            }
        })
        .collect();
    let inflation = cloud.inflation(&predictions, wanted);
    let covariance = |i: usize, p: &Prediction| {
        let widened =
            if measured[i] && wanted[i] { cloud.widening(i, p, inflation, config.leave) } else { 1.0 };
        DMat3::from_diagonal(DVec3::splat(p.variance * widened))
    };
    Ok(Some(StructurePrior {
        means: predictions.iter().map(|p| p.place).collect(),
        covariances: predictions.par_iter().enumerate().map(|(i, p)| covariance(i, p)).collect(),
        rotations: predictions.iter().map(|p| p.rotation).collect(),
        inflation,
    }))
}

type Tree = ImmutableKdTree<f64, 3>;

fn tree(points: &[[f64; 3]]) -> Result<Tree, FusionError> {
    ImmutableKdTree::new_from_slice(points).map_err(|e| FusionError::Index(format!("{e:?}")))
}

fn nearest(tree: &Tree, place: DVec3, k: usize) -> Vec<usize> {
    let k = NonZero::new(k.max(1)).unwrap_or(NonZero::<usize>::MIN);
    let found = tree.query(&place.to_array()).nearest_n::<SquaredEuclidean<f64>>(k).execute();
    found.iter().map(|n| n.item as usize).collect()
}

/// Measured Gaussians with a spatial index over their places at t-1, relative to `origin`.
struct Cloud<'a> {
    previous: &'a [DVec3],
    means: &'a [DVec3],
    covariances: &'a [DMat3],
    donors: Vec<usize>,
    origin: DVec3,
    tree: Tree,
}

/// Rigid motion of a neighbourhood.
struct Seed {
    motion: RigidMotion,
    /// Variance per axis of the measurements about the motion (m^2).
    variance: f64,
    /// Effective number of independent inliers.
    effective: f64,
    /// Mean squared distance of the inliers to the centre (m^2).
    radius2: f64,
}

struct Prediction {
    place: DVec3,
    variance: f64,
    rotation: DQuat,
}

/// Re-weighting rounds of the robust fit.
const ROUNDS: usize = 10;
/// Measured neighbours, the Gaussian included, by which it is judged whether its own evidence, or a neighbourhood's motion, is more
/// than an error of its trackers.
pub(crate) const COMPARED: usize = 12;

impl<'a> Cloud<'a> {
    fn new(
        previous: &'a [DVec3],
        means: &'a [DVec3],
        covariances: &'a [DMat3],
        donors: Vec<usize>,
    ) -> Result<Self, FusionError> {
        let origin = previous[donors[0]];
        let points: Vec<[f64; 3]> = donors.iter().map(|&i| (previous[i] - origin).to_array()).collect();
        Ok(Self { previous, means, covariances, origin, tree: tree(&points)?, donors })
    }

    fn neighbours(&self, i: usize, k: usize) -> Vec<usize> {
        let found = nearest(&self.tree, self.previous[i] - self.origin, k.min(self.donors.len()));
        found.into_iter().map(|d| self.donors[d]).collect()
    }

    /// Re-weighted Kabsch (Geman-McClure weights) from the median displacement.
    fn seed(&self, i: usize, config: &StructureConfig) -> Option<Seed> {
        let near = self.neighbours(i, config.neighbours);
        let from: Vec<DVec3> = near.iter().map(|&j| self.previous[j]).collect();
        let to: Vec<DVec3> = near.iter().map(|&j| self.means[j]).collect();
        let base = self.base_weights(&near)?;
        let axis = |a: usize| median(from.iter().zip(&to).map(|(f, t)| (*t - *f)[a]));
        let step = DVec3::new(axis(0)?, axis(1)?, axis(2)?);
        let mut motion = RigidMotion { centre: self.previous[i], rotation: DQuat::IDENTITY, step };
        let (mut weights, mut scale) = (base.clone(), 0.0);
        let mut inlier = vec![1.0; near.len()];
        for _ in 0..ROUNDS {
            let lengths: Vec<f64> =
                from.iter().zip(&to).map(|(&f, &t)| (t - motion.apply(f)).length()).collect();
            scale = (median(lengths.iter().copied())? / MEDIAN_LENGTH).max(1e-9);
            for (k, r) in lengths.iter().enumerate() {
                inlier[k] = (1.0 + (r / (3.0 * scale)).powi(2)).powi(-2);
                weights[k] = base[k] * inlier[k];
            }
            motion = fit_rigid(&from, &to, &weights)?;
        }
        let total: f64 = weights.iter().sum();
        let squares: f64 = weights.iter().map(|w| w * w).sum();
        let radius2 =
            from.iter().zip(&weights).map(|(&f, w)| w * (f - motion.centre).length_squared()).sum::<f64>();
        let effective = (total * total / squares / config.correlated).max(1.0);
        Some(Seed { motion, variance: scale * scale, effective, radius2: (radius2 / total).max(1e-12) })
    }

    /// Precise measurements count more, but none dominates.
    fn base_weights(&self, near: &[usize]) -> Option<Vec<f64>> {
        let traces: Vec<f64> = near.iter().map(|&j| trace(&self.covariances[j])).collect();
        let typical = median(traces.iter().copied())?.max(1e-18);
        Some(traces.iter().map(|t| typical / (typical + t)).collect())
    }

    /// Blends the nearest neighbourhoods that explain the measurements around Gaussian `i`.
    fn predict(&self, i: usize, seeds: &[Seed], tree: &Tree, config: &StructureConfig) -> Prediction {
        let place = self.previous[i];
        let compared = self.neighbours(i, COMPARED);
        let near: Vec<&Seed> = nearest(tree, place - self.origin, config.blend.clamp(1, seeds.len()))
            .iter()
            .map(|&s| &seeds[s])
            .collect();
        let misfit = |seed: &Seed| {
            let lengths =
                compared.iter().map(|&j| (self.means[j] - seed.motion.apply(self.previous[j])).length());
            median(lengths).unwrap_or(0.0).max(1e-9)
        };
        let misfits: Vec<f64> = near.iter().map(|s| misfit(s)).collect();
        let least = misfits.iter().copied().fold(f64::INFINITY, f64::min);
        let weight = |k: usize| {
            let leverage = 1.0 + (place - near[k].motion.centre).length_squared() / near[k].radius2;
            (least / misfits[k]).powi(8) / (leverage * leverage)
        };
        let weights: Vec<f64> = (0..near.len()).map(weight).collect();
        blend(place, &near, &weights)
    }

    /// How much the measurements scatter about the predictions, relative to what the trackers claim.
    fn inflation(&self, predictions: &[Prediction], wanted: &[bool]) -> f64 {
        let distance = |&i: &usize| {
            let e = self.means[i] - predictions[i].place;
            e.dot(self.covariances[i].inverse() * e)
        };
        let distances: Vec<f64> =
            self.donors.par_iter().filter(|&&i| wanted[i]).map(distance).filter(|d| d.is_finite()).collect();
        (median(distances).unwrap_or(0.0) / MEDIAN_CHI2).max(MIN_SCALE)
    }

    /// Factor on the prior's variance of a Gaussian whose own evidence contradicts it: it is free to leave.
    fn widening(&self, i: usize, prediction: &Prediction, inflation: f64, leave: f64) -> f64 {
        let e = self.means[i] - prediction.place;
        let total = self.covariances[i] * inflation + DMat3::from_diagonal(DVec3::splat(prediction.variance));
        let ratio = e.dot(total.inverse() * e) / leave;
        if ratio > 1.0 { (ratio * ratio).min(1e12) } else { 1.0 }
    }
}

/// Weighted mean of the predictions; its variance is that of the fits plus their spread.
fn blend(place: DVec3, seeds: &[&Seed], weights: &[f64]) -> Prediction {
    let total: f64 = weights.iter().sum();
    let mut mean = DVec3::ZERO;
    let (mut rotation, mut variance) = (DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), 0.0);
    for (seed, w) in seeds.iter().zip(weights) {
        let w = w / total;
        let leverage = 1.0 + 3.0 * (place - seed.motion.centre).length_squared() / seed.radius2;
        mean += (seed.motion.apply(place) - place) * w;
        rotation += seed.motion.rotation * w;
        variance += w * seed.variance * leverage / seed.effective;
    }
    let spread: f64 = (seeds.iter().zip(weights))
        .map(|(s, w)| w / total * (s.motion.apply(place) - place - mean).length_squared() / 3.0)
        .sum();
    Prediction {
        place: place + mean,
        variance: (variance + spread).max(1e-16),
        rotation: rotation.normalize(),
    }
}

fn trace(m: &DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}
