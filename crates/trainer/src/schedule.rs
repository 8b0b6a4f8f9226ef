//! The schedule of a training: the order in which views are drawn, and the steps.

use crate::backend::Training;
use crate::rates::LearningRates;
use crate::view::Progress;
use ffgs_rasterizer::{Dropout, RenderOptions};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Draws items in epochs: every item once, or as often as its weight says, in a seeded random order, then again in another.
#[derive(Clone, Debug)]
pub struct Epochs {
    order: Vec<usize>,
    next: usize,
    rng: ChaCha8Rng,
    /// Draws of each item per epoch, and those that are due to it; empty = one each.
    weights: Vec<[f64; 2]>,
}

impl Epochs {
    /// Draws from 0 to `count - 1`, in orders that `seed` fixes.
    pub fn new(count: usize, seed: u64) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self { order: (0..count).collect(), next: count, rng, weights: Vec::new() }
    }

    /// The same, each item as often as its weight (not negative) says: in an epoch as many in all as there are items, but for those that
    /// rounding leaves for the next one. Items without any weight are drawn once each.
    pub fn weighted(weights: &[f64], seed: u64) -> Self {
        let mean = weights.iter().sum::<f64>() / weights.len().max(1) as f64;
        let count = weights.len();
        let per_epoch = weights.iter().map(|weight| [weight / mean, 0.5]);
        let weights = if mean > 0.0 { per_epoch.collect() } else { Vec::new() };
        Self { weights, ..Self::new(count, seed) }
    }

    /// The next item; `None` when there are none at all.
    pub fn draw(&mut self) -> Option<usize> {
        if self.next >= self.order.len() {
            self.deal();
            self.order.shuffle(&mut self.rng);
            self.next = 0;
        }
        self.next += 1;
        self.order.get(self.next - 1).copied()
    }

    /// What is due in the next epoch.
    fn deal(&mut self) {
        if self.weights.is_empty() {
            return;
        }
        self.order.clear();
        while self.order.is_empty() {
            for (item, [per_epoch, due]) in self.weights.iter_mut().enumerate() {
                *due += *per_epoch;
                self.order.extend(std::iter::repeat_n(item, due.floor() as usize));
                *due -= due.floor();
            }
        }
    }
}

/// How often and how far a training steps.
pub struct Schedule<'a> {
    /// Steps, one view each; fewer where the training [settles](Self::settled).
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
    /// [`Training::expected_gain`] (nats) of natural steps below which every other of those that are left is enough; 0 = never.
    pub settled: f64,
    /// Which of the task's views is used for one that is drawn.
    pub shown: &'a dyn Fn(usize) -> usize,
}

/// Steps between two looks at what can still be gained.
const LOOK: usize = 10;
/// How many times as fast a settled training goes through the rest of its schedule.
const SETTLED_PACE: usize = 2;

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
            settled: 0.0,
            shown: &|view| view,
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

    /// Takes the steps, over `views`, and says how many. `after` is called with the place in the schedule, for what comes between two of
    /// them.
    ///
    /// # Errors
    /// When the device fails, or `after` does.
    pub fn run<T: Training>(
        &self,
        training: &mut T,
        views: &mut Epochs,
        after: impl FnMut(usize, &mut T) -> Result<(), T::Error>,
        report: &mut dyn FnMut(Progress),
    ) -> Result<usize, T::Error> {
        self.run_part(0..self.iterations, training, views, after, report)
    }

    /// The same for a part of the schedule.
    ///
    /// # Errors
    /// When the device fails, or `after` does.
    pub fn run_part<T: Training>(
        &self,
        part: Range<usize>,
        training: &mut T,
        views: &mut Epochs,
        mut after: impl FnMut(usize, &mut T) -> Result<(), T::Error>,
        report: &mut dyn FnMut(Progress),
    ) -> Result<usize, T::Error> {
        let (mut iteration, mut pace, mut steps) = (part.start, 1, 0_usize);
        while iteration < part.end {
            let Some(view) = views.draw() else { break };
            training.forward((self.shown)(view), self.options(iteration))?;
            training.backward()?;
            let (share, rates) = ((self.natural)(iteration), (self.rates)(iteration));
            if share > 0.0 {
                training.step_naturally(share, &rates)?;
            } else {
                training.step(&rates)?;
            }
            steps += 1;
            iteration = (iteration + pace).min(part.end);
            after(iteration, training)?;
            training.progress(iteration, self.iterations)?.into_iter().for_each(&mut *report);
            if pace == 1 && self.has_settled((steps, share), training)? {
                pace = SETTLED_PACE;
            }
        }
        Ok(steps)
    }

    /// Whether natural steps, the last with this `share`, hardly pay any more. It is asked after every step, and looks after some.
    fn has_settled<T: Training>(
        &self,
        (steps, share): (usize, f32),
        training: &mut T,
    ) -> Result<bool, T::Error> {
        if self.settled == 0.0 || share == 0.0 || !steps.is_multiple_of(LOOK) {
            return Ok(false);
        }
        Ok(training.expected_gain()?.is_some_and(|gain| gain < self.settled))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts its steps, and expects less from one step to the next.
    #[derive(Default)]
    struct Declining {
        steps: usize,
        shares: Vec<f32>,
    }

    impl Training for Declining {
        type Error = std::convert::Infallible;

        fn forward(&mut self, _: usize, _: RenderOptions) -> Result<(), Self::Error> {
            self.steps += 1;
            Ok(())
        }

        fn backward(&mut self) -> Result<(), Self::Error> {
            Ok(())
        }

        fn step(&mut self, _: &LearningRates) -> Result<(), Self::Error> {
            unreachable!("all steps are natural")
        }

        fn step_naturally(&mut self, share: f32, _: &LearningRates) -> Result<(), Self::Error> {
            self.shares.push(share);
            Ok(())
        }

        fn expected_gain(&mut self) -> Result<Option<f64>, Self::Error> {
            Ok(Some(1.0 / self.steps as f64))
        }
    }

    #[test]
    fn a_settled_training_takes_every_other_step() {
        let share = |iteration: usize| 1.0 / (1.0 + iteration as f32);
        let taken = |iterations: usize, settled: f64| {
            let mut training = Declining::default();
            let mut places = Vec::new();
            let schedule = Schedule { iterations, natural: &share, settled, ..Schedule::default() };
            let note = |place: usize, _: &mut Declining| {
                places.push(place);
                Ok(())
            };
            let Ok(steps) = schedule.run(&mut training, &mut Epochs::new(3, 1), note, &mut |_| ());
            assert_eq!((steps, steps), (training.steps, places.len()));
            assert_eq!(places.last(), Some(&iterations), "it ends where it should");
            (steps, training.shares[steps - 1])
        };
        assert_eq!(taken(100, 0.0), (100, share(99)));
        assert_eq!(taken(100, 0.01), (100, share(99)), "it never settles");
        // Less than 1 / 15 is expected after 20 steps.
        assert_eq!(taken(100, 1.0 / 15.0), (60, share(98)));
        assert_eq!(taken(33, 1.0 / 15.0), (27, share(32)));
    }

    #[test]
    fn parts_of_a_schedule_are_all_of_it() {
        let mut training = Declining::default();
        let (mut views, mut places) = (Epochs::new(3, 1), Vec::new());
        let schedule =
            Schedule { iterations: 7, natural: &|iteration| 1.0 + iteration as f32, ..Schedule::default() };
        for part in [0..0, 0..3, 3..7, 7..7] {
            let note = |place: usize, _: &mut Declining| {
                places.push(place);
                Ok(())
            };
            let count = part.len();
            let Ok(steps) = schedule.run_part(part, &mut training, &mut views, note, &mut |_| ());
            assert_eq!(steps, count);
        }
        assert_eq!(places, [1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(training.shares, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    }

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

    #[test]
    fn items_are_drawn_as_often_as_they_weigh() {
        let mut epochs = Epochs::weighted(&[1.0, 2.5, 0.0, 0.1], 1);
        let mut drawn = [0; 4];
        (0..3600).for_each(|_| drawn[epochs.draw().unwrap()] += 1);
        let wanted = [1000.0, 2500.0, 0.0, 100.0];
        assert!(drawn.iter().zip(wanted).all(|(n, want)| (f64::from(*n) - want).abs() < 5.0), "{drawn:?}");
        let mut alike = Epochs::weighted(&[3.0; 3], 1);
        let mut seen: Vec<_> = (0..3).map(|_| alike.draw().unwrap()).collect();
        seen.sort_unstable();
        assert_eq!(seen, [0, 1, 2]);
        assert_eq!(Epochs::weighted(&[], 1).draw(), None);
        assert!(Epochs::weighted(&[0.0; 2], 1).draw().is_some(), "without any weight they are alike");
    }
}
