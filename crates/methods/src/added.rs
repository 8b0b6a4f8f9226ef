//! Gaussians added where the gradient was large, and trained alone: the second stage of HiCoM and ReCon-GS.

use crate::photographs::Photographs;
use anyhow::Result;
use ffgs_core::Gaussians;
use ffgs_rasterizer::{Gradients, RenderOptions};
use ffgs_trainer::{
    Adam, DensityConfig, DensityControl, Epochs, GradientSums, LearningRates, Schedule, Training, Update,
    decay, normal,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Standard deviation of the place of a copy, in units of the Gaussian's own along each axis of the world.
const SPREAD: f32 = 2.0;
/// Opacity logit of a copy.
const OPACITY_LOGIT: f32 = 0.1;
/// Steps over which the position rate would decay; a frame takes only the first of them.
const DECAY_STEPS: usize = 15_000;
/// Rate of SH coefficient 0, in units of that of the others, as in 3DGS.
pub(crate) const SH0_BY_REST: f32 = 20.0;

/// How Gaussians are added.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AddedConfig {
    /// Steps per frame, one view each.
    pub iterations: usize,
    /// Mean gradient of the projected position from which a Gaussian is copied, and a copy is split.
    pub grow_gradient: f32,
    /// Steps between two rounds of splitting and removal; 0 = none.
    pub densify_every: usize,
    /// Opacity below which a copy is removed.
    pub prune_opacity: f32,
    /// Position rate at the first step, as a share of the radius of the cameras.
    pub position_rate: f32,
    /// The same after 15 000 steps.
    pub position_rate_end: f32,
    /// Rate of quaternions.
    pub quat_rate: f32,
    /// Rate of log scales.
    pub scale_rate: f32,
    /// Rate of opacity logits.
    pub opacity_rate: f32,
    /// Rate of SH coefficient 0; the others have a twentieth.
    pub sh0_rate: f32,
}

impl Default for AddedConfig {
    fn default() -> Self {
        Self {
            iterations: 100,
            grow_gradient: 1.5e-4,
            densify_every: 40,
            prune_opacity: 0.01,
            position_rate: 2.4e-3,
            position_rate_end: 2.4e-5,
            quat_rate: 0.015,
            scale_rate: 0.075,
            opacity_rate: 0.75,
            sh0_rate: 0.0375,
        }
    }
}

impl AddedConfig {
    fn rates(&self, step: usize, extent: f32) -> LearningRates {
        LearningRates {
            means: decay(self.position_rate, self.position_rate_end, step, DECAY_STEPS) * extent,
            quats: self.quat_rate,
            scales: self.scale_rate,
            opacities: self.opacity_rate,
            sh0: self.sh0_rate,
            sh_rest: self.sh0_rate / SH0_BY_REST,
        }
    }

    fn density(&self) -> DensityConfig {
        let (grow_gradient, prune_opacity) = (self.grow_gradient, self.prune_opacity);
        DensityConfig { grow_gradient, prune_opacity, max_gaussians: usize::MAX, ..DensityConfig::default() }
    }
}

/// Copies behind Gaussians that stay, under training.
pub(crate) struct Added<'a, 'v> {
    config: &'a AddedConfig,
    /// Radius of the cameras (m).
    extent: f32,
    /// Number of Gaussians that stay.
    base: usize,
    gaussians: &'a mut Gaussians,
    photographs: &'a mut Photographs<'v>,
    control: DensityControl,
    adam: Adam,
    gradients: Gradients,
    sums: GradientSums,
    steps: usize,
}

impl<'a, 'v> Added<'a, 'v> {
    /// Copies the small Gaussians whose mean gradient is large; `None` where there are none.
    pub(crate) fn new(
        config: &'a AddedConfig,
        gaussians: &'a mut Gaussians,
        sums: &GradientSums,
        photographs: &'a mut Photographs<'v>,
        (extent, seed): (f32, u64),
    ) -> Option<Self> {
        let base = gaussians.len();
        let copied = candidates(gaussians, sums, config, extent);
        gaussians.extend(&copies(gaussians, &copied, seed));
        (!copied.is_empty()).then(|| Self {
            config,
            extent,
            base,
            control: DensityControl::new(config.density(), seed),
            adam: Adam::new(gaussians.len(), gaussians.sh_degree()),
            gradients: Gradients::default(),
            sums: GradientSums::new(gaussians.len()),
            gaussians,
            photographs,
            steps: 0,
        })
    }

    /// Takes the steps over views in the given order.
    ///
    /// # Errors
    /// When the training diverges.
    pub(crate) fn train(mut self, views: &mut Epochs) -> Result<()> {
        let (config, extent) = (self.config, self.extent);
        let schedule = Schedule {
            iterations: config.iterations,
            rates: &|iteration| config.rates(iteration + 1, extent),
            ..Schedule::default()
        };
        schedule.run(&mut self, views, |_, _| Ok(()), &mut |_| ()).map(drop)
    }

    /// Splits and removes copies.
    fn revise(&mut self) {
        let mut plan = self.control.plan(self.gaussians, &self.sums, self.extent);
        plan.clone.clear();
        plan.split.retain(|&i| i >= self.base);
        plan.prune[..self.base].fill(false);
        let map = self.control.apply(&plan, self.gaussians);
        self.adam.remap(&map);
        self.sums = GradientSums::new(map.len());
    }
}

impl Training for Added<'_, '_> {
    type Error = anyhow::Error;

    fn forward(&mut self, view: usize, _: RenderOptions) -> Result<()> {
        self.photographs.forward(view, self.gaussians).map(|_| ())
    }

    fn backward(&mut self) -> Result<()> {
        self.photographs.backward(self.gaussians, &mut self.gradients);
        self.sums.add(&self.gradients.mean2d_norm, &self.gradients.touched);
        Ok(())
    }

    /// In the official code a round of density control replaces the parameters and with them the gradients: no step is taken then.
    fn step(&mut self, rates: &LearningRates) -> Result<()> {
        self.steps += 1;
        if self.config.densify_every > 0 && self.steps.is_multiple_of(self.config.densify_every) {
            self.revise();
            return Ok(());
        }
        let is_new: Vec<bool> = (0..self.gaussians.len()).map(|i| i >= self.base).collect();
        self.adam.step(self.gaussians, &self.gradients.gaussians, rates, Update::Touched(&is_new));
        Ok(())
    }
}

/// Gaussians that are copied.
fn candidates(gaussians: &Gaussians, sums: &GradientSums, config: &AddedConfig, extent: f32) -> Vec<usize> {
    let DensityConfig { split_scale, .. } = config.density();
    let small = |i: usize| gaussians.log_scales[i].iter().all(|s| s.exp() <= split_scale * extent);
    (0..gaussians.len()).filter(|&i| sums.mean(i) >= config.grow_gradient && small(i)).collect()
}

fn copies(gaussians: &Gaussians, of: &[usize], seed: u64) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut copies = gaussians.select(of);
    for i in 0..copies.len() {
        let deviation = copies.log_scales[i].map(f32::exp);
        (0..3).for_each(|a| copies.means[i][a] += SPREAD * deviation[a] * normal(&mut rng));
        copies.quats[i] = [1.0, 0.0, 0.0, 0.0];
        copies.opacity_logits[i] = OPACITY_LOGIT;
    }
    copies
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photographs::view_order;
    use crate::world::World;

    #[test]
    fn only_added_gaussians_change_and_only_small_ones_with_large_gradients_are_copied() {
        let world = World::new();
        let config = AddedConfig { iterations: 12, densify_every: 5, ..AddedConfig::default() };
        let gaussians = world.gaussians();
        let count = gaussians.len();
        let mut large = gaussians.clone();
        large.log_scales[1] = [0.0; 3];
        let mut sums = GradientSums::new(count);
        let norms: Vec<f32> = (0..count).map(|i| if i < 3 { 1e-3 } else { 1e-5 }).collect();
        sums.add(&norms, &vec![true; count]);
        assert_eq!(candidates(&large, &sums, &config, 7.0), [0, 2]);
        world.with_step(1, |step| {
            let mut photographs = Photographs::new(step, &world.sky);
            let mut grown = gaussians.clone();
            let added = Added::new(&config, &mut grown, &sums, &mut photographs, (7.0, 1)).unwrap();
            added.train(&mut view_order(step)).unwrap();
            assert_eq!(grown.select(&(0..count).collect::<Vec<_>>()), gaussians);
            assert!(grown.len() > count && grown.is_finite(), "{} of {count}", grown.len());
        });
    }

    #[test]
    fn copies_spread_about_their_gaussians_and_forget_rotation_and_opacity() {
        const COUNT: usize = 4000;
        let mut one = Gaussians::zeros(1, 0);
        (one.means[0], one.quats[0]) = ([1.0, 2.0, 3.0], [0.5; 4]);
        one.log_scales[0] = [0.1_f32, 0.2, 0.3].map(f32::ln);
        let made = copies(&one, &vec![0; COUNT], 3);
        assert!(made.quats.iter().all(|q| *q == [1.0, 0.0, 0.0, 0.0]));
        assert!(made.opacity_logits.iter().all(|o| *o == 0.1));
        for a in 0..3 {
            let off = |m: &[f32; 3]| f64::from(m[a] - one.means[0][a]);
            let variance = made.means.iter().map(|m| off(m).powi(2)).sum::<f64>() / COUNT as f64;
            let expected = (0.2 * (a + 1) as f64).powi(2);
            // Five standard errors of a variance.
            assert!((variance / expected - 1.0).abs() < 5.0 * (2.0 / COUNT as f64).sqrt(), "{a}: {variance}");
        }
    }
}
