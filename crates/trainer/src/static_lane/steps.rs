//! The static lane as the paper has it: steps of Adam on the SH coefficients, one view each.

use super::Photographed;
use crate::adam::Columns;
use crate::backend::{Around, LayerTask, LayerTraining, TaskView, TrainBackend};
use crate::background::{BackgroundConfig, outside};
use crate::schedule::Epochs;
use crate::view::Progress;
use ffgs_core::Gaussians;
use std::sync::Arc;

/// Finetunes the SH colours of the static layer; geometry and opacity do not change.
pub(super) fn train<B: TrainBackend>(
    backend: &B,
    config: &BackgroundConfig,
    Photographed { views, sky }: Photographed,
    layer: &mut Arc<Gaussians>,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<(), B::Error> {
    if config.static_iterations == 0 {
        return Ok(());
    }
    let mut training = backend.upload_layer(LayerTask {
        layer,
        columns: Columns::COLOURS,
        views: views
            .iter()
            .map(|view| TaskView::of_region(view, outside(view, config.mask_dilation)))
            .collect(),
        around: Around::Sky(sky),
        prior: None,
        sums_gradients: false,
    })?;
    let rates = config.static_rates();
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    for iteration in 0..config.static_iterations {
        let Some(view) = epochs.draw() else { break };
        training.forward(view, None)?;
        training.backward()?;
        training.step(&rates)?;
        training.progress(iteration + 1, config.static_iterations)?.into_iter().for_each(&mut *report);
    }
    training.download()
}
