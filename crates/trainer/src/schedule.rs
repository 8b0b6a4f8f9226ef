//! The schedule of a training: the order in which views are drawn, and how step sizes decay.

use crate::adam::LearningRates;
use crate::backend::Training;
use crate::view::Progress;
use ffgs_rasterizer::{Dropout, RenderOptions};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Draws items in epochs: every item once in a seeded random order, then again in another.
#[derive(Clone, Debug)]
pub struct Epochs {
    order: Vec<usize>,
    next: usize,
    rng: ChaCha8Rng,
}

impl Epochs {
    /// Draws from 0 to `count - 1`, in orders that `seed` fixes.
    pub fn new(count: usize, seed: u64) -> Self {
        Self { order: (0..count).collect(), next: count, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// The next item; `None` when there are none at all.
    pub fn draw(&mut self) -> Option<usize> {
        if self.next >= self.order.len() {
            self.order.shuffle(&mut self.rng);
            self.next = 0;
        }
        self.next += 1;
        self.order.get(self.next - 1).copied()
    }
}

/// Log-linear interpolation from `start` to `end`.
pub fn decay(start: f32, end: f32, iteration: usize, iterations: usize) -> f32 {
    let t = iteration as f32 / iterations.max(1) as f32;
    (start.ln() * (1.0 - t) + end.ln() * t).exp()
}

/// How often and how far a training steps.
pub struct Schedule<'a> {
    /// Steps, one view each.
    pub iterations: usize,
    /// SH degree of the colours at a step; `None` = the Gaussians' own.
    pub sh_degree: &'a dyn Fn(usize) -> Option<usize>,
    /// Share of the Gaussians that each step leaves out.
    pub dropout: f32,
    /// Whether every projection is linear around the centre ([`RenderOptions::at_centres`]).
    pub at_centres: bool,
    /// Step sizes at a step.
    pub rates: &'a dyn Fn(usize) -> LearningRates,
    /// Share of the natural step at a step; 0 = a step of Adam.
    pub natural: &'a dyn Fn(usize) -> f32,
}

impl Default for Schedule<'_> {
    /// No steps; with all SH coefficients, and without dropout.
    fn default() -> Self {
        Self {
            iterations: 0,
            sh_degree: &|_| None,
            dropout: 0.0,
            at_centres: false,
            rates: &|_| LearningRates::default(),
            natural: &|_| 0.0,
        }
    }
}

impl Schedule<'_> {
    /// How a step renders.
    fn options(&self, iteration: usize) -> RenderOptions {
        let dropout = Dropout { share: self.dropout, draw: iteration as u32 };
        RenderOptions {
            sh_degree: (self.sh_degree)(iteration),
            dropout: (self.dropout > 0.0).then_some(dropout),
            at_centres: self.at_centres,
        }
    }

    /// Takes the steps, over `views`. `after` is called with the number of steps done, for what comes between two of them.
    ///
    /// # Errors
    /// When the device fails, or `after` does.
    pub fn run<T: Training>(
        &self,
        training: &mut T,
        views: &mut Epochs,
        mut after: impl FnMut(usize, &mut T) -> Result<(), T::Error>,
        report: &mut dyn FnMut(Progress),
    ) -> Result<(), T::Error> {
        for iteration in 0..self.iterations {
            let Some(view) = views.draw() else { break };
            training.forward(view, self.options(iteration))?;
            training.backward()?;
            let (share, rates) = ((self.natural)(iteration), (self.rates)(iteration));
            if share > 0.0 {
                training.step_naturally(share, &rates)?;
            } else {
                training.step(&rates)?;
            }
            after(iteration + 1, training)?;
            training.progress(iteration + 1, self.iterations)?.into_iter().for_each(&mut *report);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_epoch_visits_every_item_once() {
        let mut epochs = Epochs::new(3, 1);
        for _ in 0..4 {
            let mut seen: Vec<_> = (0..3).map(|_| epochs.draw().unwrap()).collect();
            seen.sort_unstable();
            assert_eq!(seen, [0, 1, 2]);
        }
        assert_eq!(Epochs::new(0, 1).draw(), None);
    }
}
