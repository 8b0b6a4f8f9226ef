//! The static lane as the paper has it: steps of Adam on the SH coefficients, one view each.

use super::StaticTargets;
use crate::adam::Columns;
use crate::backend::{Around, LayerTask, LayerTraining, TaskView, TrainBackend};
use crate::background::{BackgroundConfig, outside};
use crate::schedule::{Epochs, Schedule};
use crate::view::Progress;
use ffgs_core::Gaussians;
use std::sync::Arc;

/// Finetunes the SH colours of the static layer; geometry and opacity do not change.
pub(super) fn train<B: TrainBackend>(
    backend: &B,
    config: &BackgroundConfig,
    StaticTargets { views, sky }: StaticTargets,
    layer: &mut Arc<Gaussians>,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<(), B::Error> {
    if config.static_iterations == 0 {
        return Ok(());
    }
    let outside = |view| TaskView::of_region(view, outside(view, config.mask_dilation));
    let task = LayerTask::new(layer, views.iter().map(outside).collect(), Around::Sky(sky));
    let mut training = backend.upload_layer(LayerTask { columns: Columns::COLOURS, ..task })?;
    let schedule = Schedule {
        iterations: config.static_iterations,
        rates: &|_| config.static_rates(),
        ..Schedule::default()
    };
    schedule.run(&mut training, &mut Epochs::new(views.len(), seed), |_, _| Ok(()), report)?;
    training.download()
}
