//! A layer that is to be written, and how much each of its Gaussians matters.

use crate::harmonics::PRICE;
use crate::steps::{Measures, Steps};
use ffgs_core::Gaussians;

/// Of the mean importance that every Gaussian counts for, shown or not: other viewpoints show what these views do not.
const UNSEEN: f64 = 0.5;

/// A layer in steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target<'a> {
    pub(crate) layer: &'a Gaussians,
    steps: &'a Steps,
    importance: Option<&'a [f32]>,
    /// Mean importance.
    mean: f64,
}

impl<'a> Target<'a> {
    pub(crate) fn new(layer: &'a Gaussians, steps: &'a Steps, importance: Option<&'a [f32]>) -> Self {
        let all = importance.unwrap_or_default();
        let mean = all.iter().map(|&v| f64::from(v)).sum::<f64>() / all.len().max(1) as f64;
        Self { layer, steps, importance: importance.filter(|_| mean > 0.0), mean }
    }

    /// Gaussian `i` in steps, not rounded.
    pub(crate) fn measures(&self, i: usize) -> Measures {
        let mut out = self.steps.measures(self.layer, i);
        out.price = self.price(i);
        out
    }

    /// A bit must gain the more, the less errors of its Gaussian show.
    fn price(&self, i: usize) -> f64 {
        let share = |all: &[f32]| (f64::from(all[i].max(0.0)) / self.mean + UNSEEN) / (1.0 + UNSEEN);
        PRICE / self.importance.map_or(1.0, share)
    }
}
