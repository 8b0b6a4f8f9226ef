//! Motion of many Gaussians by few nodes, as in HiCoM (Gao et al. 2024) and ReCon-GS (Fu et al. 2025).
//!
//! Every node has a delta of 7 values: a translation (m) and a quaternion (w, x, y, z). A Gaussian follows one node per level: its
//! translation is the sum of theirs, its rotation the sum of their quaternions, normalised, and applied in the Gaussian's own axes.

use crate::photographs::Photographs;
use anyhow::Result;
use ffgs_core::Gaussians;
use ffgs_rasterizer::{Gradients, RenderOptions};
use ffgs_trainer::{AdamVec, GradientSums, LearningRates, Training, Update};
use glam::Quat;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Values of a delta.
pub(crate) const DELTA: usize = 7;
/// The delta that moves nothing.
pub(crate) const IDENTITY: [f32; DELTA] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
/// Of Adam.
const EPSILON: f32 = 1e-15;

/// How the nodes' deltas are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionFitConfig {
    /// Steps per frame, one view each.
    pub iterations: usize,
    /// Rate of every value of a delta (m; quaternions).
    pub rate: f32,
    /// Weight of the mean absolute distance of the deltas from the identity.
    pub regulariser: f32,
    /// What the deltas of the last frame are multiplied by where the next one starts.
    pub momentum: f32,
}

impl Default for MotionFitConfig {
    fn default() -> Self {
        Self { iterations: 100, rate: 5e-4, regulariser: 1.0, momentum: 0.6 }
    }
}

/// Which Gaussians follow which nodes.
pub(crate) struct Deformation {
    /// Per level, the node of each Gaussian.
    levels: Vec<Vec<u32>>,
    /// Per node, the Gaussians that follow it, ascending.
    followers: Vec<Vec<u32>>,
}

impl Deformation {
    /// `levels`: per level, the node of each Gaussian, all below `nodes`.
    pub(crate) fn new(levels: Vec<Vec<u32>>, nodes: usize) -> Self {
        let mut followers = vec![Vec::new(); nodes];
        for level in &levels {
            level.iter().enumerate().for_each(|(i, &node)| followers[node as usize].push(i as u32));
        }
        Self { levels, followers }
    }

    /// Sum of the deltas that Gaussian `i` follows.
    fn delta(&self, deltas: &[f32], i: usize) -> [f32; DELTA] {
        let mut sum = [0.0; DELTA];
        for level in &self.levels {
            let delta = &deltas[level[i] as usize * DELTA..][..DELTA];
            sum.iter_mut().zip(delta).for_each(|(sum, delta)| *sum += delta);
        }
        sum
    }

    /// Positions and rotations of `out` become those of `base`, moved.
    pub(crate) fn apply(&self, deltas: &[f32], base: &Gaussians, out: &mut Gaussians) {
        let moved = out.means.par_iter_mut().zip(&mut out.quats).enumerate();
        moved.for_each(|(i, (mean, quat))| {
            let delta = self.delta(deltas, i);
            *mean = [0, 1, 2].map(|a| base.means[i][a] + delta[a]);
            *quat = columns(unit(base.quats[i]) * unit(rotation(&delta)));
        });
    }

    /// Derivatives by the deltas, given those by the moved positions and rotations.
    pub(crate) fn backward(&self, deltas: &[f32], base: &Gaussians, moved: &Gaussians) -> Vec<f32> {
        let own = |i| self.backward_of(deltas, base, moved, i);
        let own: Vec<[f32; DELTA]> = (0..base.len()).into_par_iter().map(own).collect();
        let sum = |followers: &Vec<u32>| {
            let mut sum = [0.0; DELTA];
            for &i in followers {
                sum.iter_mut().zip(own[i as usize]).for_each(|(sum, own)| *sum += own);
            }
            sum
        };
        self.followers.par_iter().map(sum).collect::<Vec<_>>().into_flattened()
    }

    /// By the summed delta `d` of one Gaussian. Its rotation is `q u`, `u = d / |d|`; multiplication by the unit quaternion q
    /// is orthogonal, and the derivative of `u` is the projection across it, over `|d|`.
    fn backward_of(&self, deltas: &[f32], base: &Gaussians, moved: &Gaussians, i: usize) -> [f32; DELTA] {
        let delta = self.delta(deltas, i);
        let turn = quat(rotation(&delta));
        let (length, along) = (turn.length(), unit(rotation(&delta)));
        let by_unit = unit(base.quats[i]).conjugate() * quat(moved.quats[i]);
        let across = by_unit - along * along.dot(by_unit);
        let [w, x, y, z] =
            columns(if length > 0.0 { across / length } else { Quat::from_xyzw(0.0, 0.0, 0.0, 0.0) });
        let [a, b, c] = moved.means[i];
        [a, b, c, w, x, y, z]
    }
}

/// What is trained of the nodes: a delta each.
pub(crate) struct Deltas {
    pub values: Vec<f32>,
    pub adam: AdamVec,
    /// Those that moved the Gaussians of the last frame, which its file holds; none before one was trained here.
    pub applied: Vec<f32>,
}

impl Deltas {
    /// Values of whole nodes, never trained.
    pub(crate) fn new(values: Vec<f32>) -> Self {
        let adam = AdamVec::new(values.len() / DELTA, DELTA);
        Self { values, adam, applied: Vec::new() }
    }

    /// Those of so many nodes that move nothing.
    pub(crate) fn identity(nodes: usize) -> Self {
        Self::new(IDENTITY.repeat(nodes))
    }

    /// A delta each.
    pub(crate) fn nodes(&self) -> &[[f32; DELTA]] {
        self.values.as_chunks().0
    }
}

/// The deltas under training, and the Gaussians that they move.
pub(crate) struct Fit<'a, 'v> {
    deformation: &'a Deformation,
    deltas: &'a mut Deltas,
    base: Gaussians,
    gaussians: &'a mut Gaussians,
    photographs: &'a mut Photographs<'v>,
    regulariser: f32,
    gradients: Gradients,
    /// Of the moved Gaussians.
    pub sums: GradientSums,
}

impl<'a, 'v> Fit<'a, 'v> {
    /// From the deltas of the last frame.
    pub(crate) fn new(
        (deformation, deltas): (&'a Deformation, &'a mut Deltas),
        gaussians: &'a mut Gaussians,
        photographs: &'a mut Photographs<'v>,
        config: &MotionFitConfig,
    ) -> Self {
        deltas.values.iter_mut().for_each(|delta| *delta *= config.momentum);
        Self {
            base: gaussians.clone(),
            sums: GradientSums::new(gaussians.len()),
            gradients: Gradients::default(),
            regulariser: config.regulariser,
            deformation,
            deltas,
            gaussians,
            photographs,
        }
    }
}

impl Training for Fit<'_, '_> {
    type Error = anyhow::Error;

    /// What the last step changes is the start of the next frame, as in the official code: the Gaussians follow before a step, not after.
    fn forward(&mut self, view: usize, _: RenderOptions) -> Result<()> {
        self.deformation.apply(&self.deltas.values, &self.base, self.gaussians);
        self.deltas.applied.clone_from(&self.deltas.values);
        self.photographs.forward(view, self.gaussians).map(|_| ())
    }

    fn backward(&mut self) -> Result<()> {
        self.photographs.backward(self.gaussians, &mut self.gradients);
        self.sums.add(&self.gradients.mean2d_norm, &self.gradients.touched);
        Ok(())
    }

    /// All values of a delta have the rate of positions.
    fn step(&mut self, rates: &LearningRates) -> Result<()> {
        let Deltas { values, adam, .. } = &mut *self.deltas;
        let mut by_deltas = self.deformation.backward(values, &self.base, &self.gradients.gaussians);
        regularise(values, self.regulariser, &mut by_deltas);
        adam.step(values, &by_deltas, (rates.means, EPSILON), Update::Dense);
        Ok(())
    }
}

/// Adds the derivative of `weight * mean |delta - identity|` and returns its value.
pub(crate) fn regularise(deltas: &[f32], weight: f32, gradient: &mut [f32]) -> f64 {
    let share = weight / deltas.len().max(1) as f32;
    let mut sum = 0.0;
    for ((delta, gradient), identity) in deltas.iter().zip(gradient).zip(IDENTITY.iter().cycle()) {
        let far = delta - identity;
        sum += f64::from(far.abs());
        *gradient += if far == 0.0 { 0.0 } else { share * far.signum() };
    }
    f64::from(share) * sum
}

fn rotation(delta: &[f32; DELTA]) -> [f32; 4] {
    let [_, _, _, rotation @ ..] = *delta;
    rotation
}

fn quat([w, x, y, z]: [f32; 4]) -> Quat {
    Quat::from_xyzw(x, y, z, w)
}

/// Normalised; one of length 0 turns nothing.
pub(crate) fn unit(columns: [f32; 4]) -> Quat {
    let quat = quat(columns);
    if quat.length_squared() > 0.0 { quat.normalize() } else { Quat::IDENTITY }
}

pub(crate) fn columns(quat: Quat) -> [f32; 4] {
    [quat.w, quat.x, quat.y, quat.z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::waves;
    use ffgs_testkit::largest_difference;

    /// Twelve Gaussians, two levels of three and one node.
    fn case() -> (Deformation, Vec<f32>, Gaussians) {
        let fine = (0..12).map(|i| i % 3).collect();
        let mut base = Gaussians::zeros(12, 0);
        waves(base.means.as_flattened_mut(), 0.3);
        waves(base.quats.as_flattened_mut(), 0.9);
        let mut deltas = IDENTITY.repeat(4);
        let mut change = vec![0.0; deltas.len()];
        waves(&mut change, 2.0);
        deltas.iter_mut().zip(change).for_each(|(d, c)| *d += 0.2 * c);
        (Deformation::new(vec![fine, vec![3; 12]], 4), deltas, base)
    }

    /// A linear function of positions and rotations, in f64.
    fn value(moved: &Gaussians, weights: &Gaussians) -> f64 {
        let dot =
            |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        dot(moved.means.as_flattened(), weights.means.as_flattened())
            + dot(moved.quats.as_flattened(), weights.quats.as_flattened())
    }

    #[test]
    fn the_derivative_by_the_deltas_is_that_of_finite_differences() {
        const STEP: f32 = 1e-2;
        let (deformation, deltas, base) = case();
        let (mut weights, mut moved) = (Gaussians::zeros(12, 0), base.clone());
        waves(weights.means.as_flattened_mut(), 4.0);
        waves(weights.quats.as_flattened_mut(), 5.0);
        let mut at = |deltas: &[f32]| {
            deformation.apply(deltas, &base, &mut moved);
            value(&moved, &weights)
        };
        let numeric: Vec<f64> = (0..deltas.len())
            .map(|k| {
                let [ahead, behind] = [STEP, -STEP].map(|step| {
                    let mut changed = deltas.clone();
                    changed[k] += step;
                    at(&changed)
                });
                (ahead - behind) / f64::from(2.0 * STEP)
            })
            .collect();
        let analytic = deformation.backward(&deltas, &base, &weights);
        // Central differences: the error is of second order in the step; measured 2.6e-4.
        let far = largest_difference(&analytic, &numeric);
        assert!(far < 1e-3, "{far}");
    }

    #[test]
    fn the_identity_moves_nothing_at_any_scale_of_its_quaternions() {
        let (deformation, _, base) = case();
        for scale in [1.0, 0.6] {
            let mut deltas = IDENTITY.repeat(4);
            deltas.iter_mut().for_each(|delta| *delta *= scale);
            let mut moved = base.clone();
            deformation.apply(&deltas, &base, &mut moved);
            assert_eq!(moved.means, base.means);
            for (now, before) in moved.quats.iter().zip(&base.quats) {
                assert!(largest_difference(now, &columns(unit(*before))) < 1e-6);
            }
        }
    }

    #[test]
    fn the_regulariser_is_a_mean_distance_from_the_identity() {
        let mut deltas = IDENTITY.repeat(2);
        deltas[1] = 0.5;
        deltas[3] = 0.75;
        let mut gradient = vec![0.0; deltas.len()];
        let value = regularise(&deltas, 2.0, &mut gradient);
        assert!((value - 2.0 * 0.75 / 14.0).abs() < 1e-7);
        let mut expected = vec![0.0; 14];
        (expected[1], expected[3]) = (2.0 / 14.0, -2.0 / 14.0);
        assert!(largest_difference(&gradient, &expected) < 1e-7);
    }
}
