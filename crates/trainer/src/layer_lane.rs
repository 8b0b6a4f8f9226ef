//! Training of a layer whose Gaussians stay the same ones.

use crate::adam::LearningRates;
use crate::backend::{LayerTask, LayerTraining, TrainBackend};
use crate::schedule::Epochs;
use crate::view::Progress;

/// How long a layer is trained, and how fast.
pub struct LayerSchedule<'a> {
    /// Steps, one view each.
    pub iterations: usize,
    /// Step sizes at a step.
    pub rates: &'a dyn Fn(usize) -> LearningRates,
    /// Of the order of the views.
    pub seed: u64,
}

/// Trains `task`, without density control.
///
/// # Errors
/// When the device fails or has too little memory.
pub fn train_layer<B: TrainBackend>(
    backend: &B,
    task: LayerTask,
    schedule: &LayerSchedule,
    report: &mut dyn FnMut(Progress),
) -> Result<(), B::Error> {
    let (views, iterations) = (task.views.len(), schedule.iterations);
    let mut training = backend.upload_layer(task)?;
    loop {
        let mut epochs = Epochs::new((0..views).collect(), schedule.seed);
        for iteration in 0..iterations {
            let Some(view) = epochs.draw() else { break };
            training.forward(view, None)?;
            training.backward()?;
            training.step(&(schedule.rates)(iteration))?;
            training.progress(iteration + 1, iterations)?.into_iter().for_each(&mut *report);
        }
        if !training.must_repeat()? {
            return training.download();
        }
    }
}
