//! One frame's training of QUEEN: residuals through their decoders, density control, and the gradients back to the latents.

use super::QueenConfig;
use super::residuals::{DECAY_STEPS, Residuals};
use crate::photographs::{Photographs, frame_seed, view_order};
use anyhow::Result;
use ffgs_core::Gaussians;
use ffgs_method::Step;
use ffgs_rasterizer::{Gradients, RenderOptions};
use ffgs_trainer::{DensityControl, GradientSums, LearningRates, Schedule, Training, camera_extent, decay};

/// A frame under training.
pub(super) struct Frame<'a, 'b, 'v> {
    config: &'a QueenConfig,
    residuals: &'a mut Residuals<'b>,
    photographs: Photographs<'v>,
    /// What the residuals decode to.
    gaussians: Gaussians,
    gradients: Gradients,
    sums: GradientSums,
    control: DensityControl,
    /// Radius of the cameras (m).
    extent: f32,
    /// Steps of an epoch.
    views: usize,
    /// Steps begun.
    steps: usize,
}

impl<'a, 'b, 'v> Frame<'a, 'b, 'v> {
    pub(super) fn new(
        config: &'a QueenConfig,
        step: &Step,
        residuals: &'a mut Residuals<'b>,
        photographs: Photographs<'v>,
    ) -> Self {
        let gaussians = residuals.derived();
        Self {
            config,
            residuals,
            photographs,
            gradients: Gradients::default(),
            sums: GradientSums::new(gaussians.len()),
            gaussians,
            control: DensityControl::new(config.density(), frame_seed(step)),
            extent: camera_extent(step.now),
            views: step.now.len(),
            steps: 0,
        }
    }

    /// Takes all steps.
    ///
    /// # Errors
    /// When the training diverges.
    pub(super) fn train(mut self, step: &Step) -> Result<()> {
        let (config, extent) = (self.config, self.extent);
        let rate =
            |i: usize| decay(config.position_rate, config.position_rate_end, i + 1, DECAY_STEPS) * extent;
        let schedule = Schedule {
            iterations: config.epochs * self.views,
            rates: &|iteration| LearningRates::with_means(rate(iteration)),
            ..Schedule::default()
        };
        schedule.run(&mut self, &mut view_order(step), |_, _| Ok(()), &mut |_| ()).map(drop)
    }

    /// Adds Gaussians, and removes added ones.
    fn revise(&mut self) {
        let mut plan = self.control.plan(&self.gaussians, &self.sums, self.extent);
        plan.prune[..self.residuals.kept].fill(false);
        let map = self.control.apply(&plan, &mut self.gaussians);
        self.residuals.follow(&plan, &map, &self.gaussians);
        self.gaussians = self.residuals.derived();
        self.sums = GradientSums::new(map.len());
    }
}

impl Training for Frame<'_, '_, '_> {
    type Error = anyhow::Error;

    fn forward(&mut self, view: usize, _: RenderOptions) -> Result<()> {
        if self.steps == (self.config.epochs as f32 * self.config.masked).ceil() as usize * self.views {
            self.photographs.masks.clear();
        }
        self.steps += 1;
        self.residuals.apply(&mut self.gaussians);
        self.photographs.forward(view, &self.gaussians).map(|_| ())
    }

    fn backward(&mut self) -> Result<()> {
        self.photographs.backward(&self.gaussians, &mut self.gradients);
        if self.steps > self.config.densify_from.saturating_sub(2) * self.views {
            self.sums.add(&self.gradients.mean2d_norm, &self.gradients.touched);
        }
        Ok(())
    }

    /// In the official code a round of density control replaces the parameters and with them the gradients: no step is taken then. The
    /// rate of positions is the one of `rates` that counts; the others are of latents and decoders.
    fn step(&mut self, rates: &LearningRates) -> Result<()> {
        let round = self.config.densify_every * self.views;
        let late = self.steps > self.config.densify_from * self.views;
        if round > 0 && late && self.steps.is_multiple_of(round) {
            self.revise();
        } else {
            self.residuals.step(&self.gradients.gaussians, self.config, rates.means);
        }
        Ok(())
    }
}
