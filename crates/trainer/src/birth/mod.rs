//! Birth: moving Gaussians where masks are not explained, trained in full before the lanes of a frame begin
//! (docs/adr/0049-birth.md).

mod unexplained;

pub use unexplained::{Standing, unexplained};

use crate::backend::TrainBackend;
use crate::lengths::robust_extent;
use crate::rates::LearningRates;
use crate::rates::decay;
use crate::schedule::Schedule;
use crate::subset::{Subset, shown, train_subset};
use crate::view::Progress;
use ffgs_core::{Gaussians, Mask, Scene, TrainingView};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How moving Gaussians are born where masks are not explained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BirthConfig {
    /// Steps of the training before they join the layer, one view each; 0 = nothing is born.
    pub iterations: usize,
    /// Most Gaussians born in a frame.
    pub most: usize,
    /// Position rate at the first step, as a share of the extent of what is born.
    pub position_rate: f32,
    /// Position rate at the last step, likewise.
    pub position_rate_end: f32,
    /// Rate of log scales.
    pub scale_rate: f32,
    /// Rate of opacity logits.
    pub opacity_rate: f32,
    /// Rate of SH coefficient 0.
    pub sh0_rate: f32,
    /// Rate of the other SH coefficients.
    pub sh_rest_rate: f32,
}

impl Default for BirthConfig {
    fn default() -> Self {
        Self {
            iterations: 150,
            most: 8000,
            position_rate: 1e-3,
            position_rate_end: 1e-5,
            scale_rate: 1.5e-2,
            opacity_rate: 5e-2,
            sh0_rate: 1e-2,
            sh_rest_rate: 5e-4,
        }
    }
}

impl BirthConfig {
    fn rates(&self, iteration: usize, extent: f32) -> LearningRates {
        let rate = decay(self.position_rate, self.position_rate_end, iteration, self.iterations);
        LearningRates {
            scales: self.scale_rate,
            opacities: self.opacity_rate,
            sh0: self.sh0_rate,
            sh_rest: self.sh_rest_rate,
            ..LearningRates::with_means(rate * extent)
        }
    }
}

/// What is born, and where it is seen.
pub struct Newborn<'a> {
    /// As they start.
    pub gaussians: Gaussians,
    /// Photographs at t.
    pub views: &'a [TrainingView],
    /// The pixels of each that they are to explain.
    pub unexplained: &'a [Mask],
}

/// Trains `newborn` in `scene`, which stays. `None` when too few pixels show them.
///
/// # Errors
/// When the device fails or has too little memory.
pub fn train_newborn<B: TrainBackend>(
    backend: &B,
    config: &BirthConfig,
    newborn: Newborn,
    scene: &Scene,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<Option<Gaussians>, B::Error> {
    let extent = robust_extent(&newborn.gaussians);
    let region = |(view, unexplained): (&TrainingView, &Mask)| {
        let mut data = shown(view, &newborn.gaussians).data().to_vec();
        data.iter_mut().zip(unexplained.data()).for_each(|(shown, open)| *shown |= open);
        Mask::new(unexplained.size(), data).expect("one value per pixel")
    };
    let regions = newborn.views.par_iter().zip(newborn.unexplained).map(region).collect();
    let subset = Subset {
        fixed: scene.joint(),
        trained: newborn.gaussians,
        views: newborn.views,
        regions,
        sky: &scene.sky,
    };
    let schedule = Schedule {
        iterations: config.iterations,
        rates: &|iteration| config.rates(iteration, extent),
        ..Schedule::default()
    };
    train_subset(backend, &schedule, subset, seed, report)
}
