//! The fusion of all trackers with the prior, by their precisions: the information form of a Kalman update.

use crate::config::{FusionConfig, PriorModel, ProcessNoise, Structure};
use crate::error::FusionError;
use crate::evidence::{Evidence, robust_weight};
use crate::groups::{Group, Groups, discover};
use crate::input::FusionInput;
use crate::prediction::{Departures, Prediction};
use crate::prior::Prior;
use crate::process_noise::{median_displacement, per_group};
use crate::structure::{Structured, structured};
use crate::symmetric::Symmetric;
use ffgs_core::EstimateStatus;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// The state after fusion, columns of length N.
#[derive(Clone, Debug, Default)]
pub struct Fused {
    /// Means (m).
    pub means: Vec<DVec3>,
    /// Position covariances (m^2).
    pub covariances: Vec<DMat3>,
    /// Process noise (m): median displacement over all successful estimates.
    pub q: f64,
    /// Whether any tracker's estimate succeeded.
    pub measured: Vec<bool>,
    /// Rotation of the group or neighbourhood from t-1 to t; the identity without structure.
    pub rotations: Vec<DQuat>,
    /// What moves rigidly together; empty without structure.
    pub groups: Vec<Group>,
    /// Group of each Gaussian; `None` where it has none or left it.
    pub group_of: Vec<Option<usize>>,
    /// Logarithm of the odds that a Gaussian's departure from its group is real, over this and earlier frames.
    pub flexibility: Vec<f64>,
}

/// Information-form Kalman update (Algorithm 1, lines 26 to 34), relative to the prior mean so that coordinates of
/// any size stay exact; optionally with the rigid motion of the neighbourhood as the prior.
#[derive(Clone, Copy, Debug, Default)]
pub struct InformationFuser {
    /// Settings.
    pub config: FusionConfig,
}

impl InformationFuser {
    /// Combines the trackers' estimates of one frame with the temporal prior. A Gaussian without any estimate keeps its
    /// predicted place and covariance.
    ///
    /// # Errors
    /// [`FusionError`] when a column has the wrong length or an option lacks its input.
    pub fn fuse(&self, input: &FusionInput) -> Result<Fused, FusionError> {
        let prediction = self.predict(input)?;
        let departures = prediction.departures();
        self.update(prediction, &departures)
    }

    /// The first half of [`fuse`](Self::fuse): where everything is expected, and what the trackers show of rigid groups.
    ///
    /// # Errors
    /// As [`fuse`](Self::fuse).
    pub fn predict<'a>(&self, input: &'a FusionInput<'a>) -> Result<Prediction<'a>, FusionError> {
        check(input)?;
        let means = predict(input, &self.config)?;
        let (q, evidence) =
            rayon::join(|| median_displacement(&means, input.estimates), || Evidence::new(input.estimates));
        let q = q.unwrap_or(input.last_q).max(input.q_floor_m);
        let q_of = process_noise(input, &means, &self.config, q)?;
        let groups = match self.config.structure {
            Structure::RigidGroups => discover(input.prior_means, &evidence, &self.config.groups),
            _ => Groups { of: vec![None; input.prior_means.len()], ..Groups::default() },
        };
        Ok(Prediction { input, means, q, q_of, evidence, groups })
    }

    /// The second half of [`fuse`](Self::fuse): the posterior of every Gaussian.
    ///
    /// # Errors
    /// As [`fuse`](Self::fuse).
    pub fn update(&self, prediction: Prediction, departures: &Departures) -> Result<Fused, FusionError> {
        let Prediction { input, means: mut predicted, q, q_of, evidence, groups } = prediction;
        let evidence = evidence.without(|i| groups.lost(i));
        let structure = match self.config.structure {
            Structure::None => None,
            _ => structured(input, &evidence, &self.config, groups, departures)?,
        };
        if let (None, Structure::RigidGroups, Some(steps)) =
            (&structure, self.config.structure, input.previous_steps)
        {
            // Nothing was measured: all go on as they moved.
            check_column("previous_steps", steps.len(), predicted.len())?;
            predicted = input.prior_means.iter().zip(steps).map(|(&mean, &step)| mean + step).collect();
        }
        let states: Vec<State> = (0..predicted.len())
            .into_par_iter()
            .map(|i| match &structure {
                None => self.update_one(input, i, random_walk(input, predicted[i], i, q_of[i])),
                Some(structure) => self.blend(input, &evidence, structure, i),
            })
            .collect();
        Ok(Fused {
            means: states.iter().map(|s| s.mean).collect(),
            covariances: states.iter().map(|s| s.covariance).collect(),
            measured: (0..states.len()).map(|i| evidence.measured(i)).collect(),
            q,
            ..layout(structure, states.len())
        })
    }
}

/// Rotations and groups; means and the like are left empty.
fn layout(structure: Option<Structured>, n: usize) -> Fused {
    let Some(structure) = structure else {
        let (rotations, flexibility) = (vec![DQuat::IDENTITY; n], vec![0.0; n]);
        return Fused { rotations, group_of: vec![None; n], flexibility, ..Fused::default() };
    };
    let departs = |i: usize| structure.alternatives[i].is_some_and(|(probability, _)| probability > 0.5);
    let group = |i: usize| structure.groups.of[i].filter(|_| !structure.priors[i].left && !departs(i));
    let rotation = |i: usize| match &structure.alternatives[i] {
        Some((probability, other)) => structure.priors[i].rotation.slerp(other.rotation, *probability),
        None => structure.priors[i].rotation,
    };
    Fused {
        rotations: (0..n).map(rotation).collect(),
        group_of: (0..n).map(group).collect(),
        flexibility: structure.flexibility,
        groups: structure.groups.found,
        ..Fused::default()
    }
}

#[derive(Clone, Copy)]
struct State {
    mean: DVec3,
    covariance: DMat3,
}

impl State {
    /// Mean and covariance of a mixture with `other`, which has this probability.
    fn mixed(self, other: Self, probability: f64) -> Self {
        let (own, apart) = (1.0 - probability, other.mean - self.mean);
        let outer = DMat3::from(Symmetric::outer(apart)) * (own * probability);
        Self {
            mean: self.mean + apart * probability,
            covariance: self.covariance * own + other.covariance * probability + outer,
        }
    }
}

impl InformationFuser {
    /// The posterior over both priors of a Gaussian that may depart from its group.
    fn blend(&self, input: &FusionInput, evidence: &Evidence, structure: &Structured, i: usize) -> State {
        let rigid = self.follow(input, evidence, structure, &structure.priors[i], i);
        let Some((probability, other)) = &structure.alternatives[i] else { return rigid };
        rigid.mixed(self.follow(input, evidence, structure, other, i), *probability)
    }

    /// Update of one Gaussian from what its surroundings say. Errors of the place at t-1 are in prior and measurement
    /// alike, so they are carried, not fused.
    fn follow(
        &self,
        input: &FusionInput,
        evidence: &Evidence,
        structure: &Structured,
        prior: &Prior,
        i: usize,
    ) -> State {
        let scales = structure.scales(prior);
        let count = evidence.of(i).count().max(1) as f64;
        let shared = self.config.correlation_inflation * (1.0 + (count - 1.0) * structure.correlation);
        let mut information = prior.covariance.inverse();
        let mut vector = DVec3::ZERO;
        for (l, told) in evidence.of(i) {
            let scale = scales[l] * shared;
            let (precision, r) = (told.information * scale.recip(), told.mean - prior.mean);
            let expected = told.information.inverse() * scale + prior.covariance;
            let weight = if prior.free { 1.0 } else { robust_weight(expected.inverse().quadratic(r)) };
            information += precision * weight;
            vector += precision * r * weight;
        }
        let covariance = information.inverse();
        let mean = prior.mean + covariance * vector;
        let carried = input.prior_covariances[i] + DMat3::from(prior.shared);
        if mean.is_finite() && covariance.is_finite() {
            State { mean, covariance: DMat3::from(covariance) + carried }
        } else {
            State { mean: prior.mean, covariance: DMat3::from(prior.covariance) + carried }
        }
    }

    /// Sum of the trackers' information and of information times offset from `origin`.
    fn information(
        &self,
        input: &FusionInput,
        i: usize,
        origin: DVec3,
        keep: impl Fn(usize) -> bool,
    ) -> (DMat3, DVec3) {
        let scale = self.config.correlation_inflation.recip();
        let (mut information, mut vector) = (DMat3::ZERO, DVec3::ZERO);
        for (l, estimate) in input.estimates.iter().enumerate() {
            if estimate.status[i] == EstimateStatus::Ok && keep(l) {
                let precision = symmetric_inverse(estimate.covariances[i]) * scale;
                if precision.is_finite() {
                    information += precision;
                    vector += precision * (estimate.means[i] - origin);
                }
            }
        }
        (information, vector)
    }

    /// Kalman update of one Gaussian from `prior`.
    fn update_one(&self, input: &FusionInput, i: usize, prior: State) -> State {
        let mut rejected = vec![false; if self.config.gate > 0.0 { input.estimates.len() } else { 0 }];
        loop {
            let keep = |l: usize| !rejected.get(l).copied().unwrap_or(false);
            let (information, vector) = self.information(input, i, prior.mean, keep);
            if information == DMat3::ZERO {
                return prior;
            }
            let covariance = symmetric_inverse(symmetric_inverse(prior.covariance) + information);
            let mean = prior.mean + covariance * vector;
            if !mean.is_finite() || !covariance.is_finite() {
                return prior;
            }
            let state = State { mean, covariance };
            let Some(worst) = self.worst_outside_gate(input, i, state, &rejected) else { return state };
            rejected[worst] = true;
        }
    }

    fn worst_outside_gate(
        &self,
        input: &FusionInput,
        i: usize,
        state: State,
        rejected: &[bool],
    ) -> Option<usize> {
        let distance = |l: usize| {
            let estimate = &input.estimates[l];
            let offset = estimate.means[i] - state.mean;
            offset.dot(symmetric_inverse(estimate.covariances[i] + state.covariance) * offset)
        };
        let candidates = (0..rejected.len())
            .filter(|&l| !rejected[l] && input.estimates[l].status[i] == EstimateStatus::Ok)
            .map(|l| (l, distance(l)));
        candidates.filter(|c| c.1 > self.config.gate).max_by(|a, b| a.1.total_cmp(&b.1)).map(|c| c.0)
    }
}

/// `P + q^2 I` at the predicted place (Algorithm 1, line 28).
fn random_walk(input: &FusionInput, place: DVec3, i: usize, q: f64) -> State {
    State { mean: place, covariance: input.prior_covariances[i] + DMat3::IDENTITY * (q * q) }
}

fn predict(input: &FusionInput, config: &FusionConfig) -> Result<Vec<DVec3>, FusionError> {
    match (config.prior, input.previous_steps) {
        (PriorModel::RandomWalk, _) => Ok(input.prior_means.to_vec()),
        (PriorModel::ConstantVelocity, Some(steps)) => {
            check_column("previous_steps", steps.len(), input.prior_means.len())?;
            Ok(input.prior_means.iter().zip(steps).map(|(&mean, &step)| mean + step).collect())
        }
        (PriorModel::ConstantVelocity, None) => {
            Err(FusionError::MissingInput { option: "prior = constant_velocity", input: "previous_steps" })
        }
    }
}

/// q of every Gaussian (m).
fn process_noise(
    input: &FusionInput,
    predicted: &[DVec3],
    config: &FusionConfig,
    q: f64,
) -> Result<Vec<f64>, FusionError> {
    match (config.q_mode, input.groups) {
        (ProcessNoise::Global, _) => Ok(vec![q; predicted.len()]),
        (ProcessNoise::PerObject, Some(groups)) => {
            check_column("groups", groups.len(), predicted.len())?;
            let medians = per_group(predicted, input.estimates, groups);
            Ok(groups.iter().map(|g| medians.get(g).copied().unwrap_or(q).max(input.q_floor_m)).collect())
        }
        (ProcessNoise::PerObject, None) => {
            Err(FusionError::MissingInput { option: "q_mode = per_object", input: "groups" })
        }
    }
}

/// Inverse, made exactly symmetric.
pub fn symmetric_inverse(m: DMat3) -> DMat3 {
    let inverse = m.inverse();
    (inverse + inverse.transpose()) * 0.5
}

/// Position covariance at t = 0 (m^2): half the smallest axis as standard deviation, at least a quarter of a pixel.
///
/// `smallest_axis` is the least standard deviation of the splat (m), `pixel_m` the size of a pixel at its depth (z / f).
pub fn initial_covariance(smallest_axis: f64, pixel_m: f64) -> DMat3 {
    let sigma = (0.5 * smallest_axis).max(0.25 * pixel_m);
    DMat3::from_diagonal(DVec3::splat(sigma * sigma))
}

fn check(input: &FusionInput) -> Result<(), FusionError> {
    let n = input.prior_means.len();
    check_column("prior_covariances", input.prior_covariances.len(), n)?;
    for estimate in input.estimates {
        check_column("estimates.means", estimate.means.len(), n)?;
        check_column("estimates.covariances", estimate.covariances.len(), n)?;
        check_column("estimates.status", estimate.status.len(), n)?;
    }
    Ok(())
}

/// Refuses a column of another length.
pub(crate) fn check_column(column: &'static str, found: usize, expected: usize) -> Result<(), FusionError> {
    if found == expected { Ok(()) } else { Err(FusionError::Column { column, found, expected }) }
}
