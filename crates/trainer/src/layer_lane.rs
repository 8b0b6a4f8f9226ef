//! Training of a layer whose Gaussians stay the same ones.

use crate::backend::{LayerTask, LayerTraining, TrainBackend};
use crate::schedule::{Epochs, Schedule};
use crate::view::Progress;

/// Trains `task`, without density control, on its views as `order` draws them. Says how many steps were taken.
///
/// # Errors
/// When the device fails or has too little memory.
pub fn train_layer<B: TrainBackend>(
    backend: &B,
    task: LayerTask,
    schedule: &Schedule,
    order: &Epochs,
    report: &mut dyn FnMut(Progress),
) -> Result<usize, B::Error> {
    let mut training = backend.upload_layer(task)?;
    loop {
        let steps = schedule.run(&mut training, &mut order.clone(), |_, _| Ok(()), report)?;
        if !training.must_repeat()? {
            return training.download().map(|()| steps);
        }
    }
}
