//! A short training of an export as its viewer draws it, without opacity compensation; positions and rotations stay.

use ffgs_core::{Gaussians, SkyCube, TrainingView};
use ffgs_rasterizer::TileMask;
use ffgs_trainer::{
    Around, Columns, Epochs, LayerTask, LayerTraining, LearningRates, Schedule, TILE_DILATION, TaskView,
    TrainBackend, decay,
};
use std::sync::Arc;

/// How exports are finetuned. Positions and rotations stay: they hold the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinetuneConfig {
    /// Steps, one view each.
    pub iterations: usize,
    /// Rate of log scales at the first step; all rates fall to a tenth.
    pub scale_rate: f32,
    /// Rate of opacity logits at the first step.
    pub opacity_rate: f32,
    /// Rate of SH coefficient 0 at the first step.
    pub sh0_rate: f32,
    /// Rate of the other SH coefficients at the first step.
    pub sh_rest_rate: f32,
}

impl Default for FinetuneConfig {
    /// The rates of frame 0's training.
    fn default() -> Self {
        Self {
            iterations: 600,
            scale_rate: 1.5e-2,
            opacity_rate: 3e-2,
            sh0_rate: 2.5e-3,
            sh_rest_rate: 1.25e-4,
        }
    }
}

impl FinetuneConfig {
    fn rates(&self, iteration: usize) -> LearningRates {
        let fall = decay(1.0, 0.1, iteration, self.iterations);
        LearningRates {
            means: 0.0,
            quats: 0.0,
            scales: fall * self.scale_rate,
            opacities: fall * self.opacity_rate,
            sh0: fall * self.sh0_rate,
            sh_rest: fall * self.sh_rest_rate,
        }
    }
}

/// Pixels by which masks are grown for the loss, so that outlines are learnt from both sides.
const LOSS_DILATION: usize = 2;

/// Fits the Gaussians from number `first` on to the photographs, in front of `sky`; those before it are
/// drawn and stay. Where some stay only the neighbourhood of the foreground counts. Equal inputs and seeds give equal
/// bytes.
///
/// # Errors
/// When the device fails or has too little memory; `gaussians` are then as they were.
pub fn finetune<B: TrainBackend>(
    backend: &B,
    gaussians: &mut Gaussians,
    first: usize,
    views: &[TrainingView],
    sky: &SkyCube,
    config: &FinetuneConfig,
    seed: u64,
) -> Result<(), B::Error> {
    let views: Vec<TaskView> = views.iter().filter_map(|view| task_view(view, first == 0)).collect();
    let schedule = Schedule {
        iterations: config.iterations,
        rates: &|iteration| config.rates(iteration),
        ..Schedule::default()
    };
    let count = views.len();
    let mut layer = Arc::new(std::mem::take(gaussians));
    let task = LayerTask {
        columns: Columns::IN_PLACE,
        fixed: first,
        ..LayerTask::new(&mut layer, views, Around::Sky(sky))
    };
    let trained = backend.upload_layer(task).and_then(|mut training| {
        schedule.run(&mut training, &mut Epochs::new(count, seed), |_, _| Ok(()), &mut |_| {})?;
        training.download()
    });
    *gaussians = Arc::unwrap_or_clone(layer);
    trained
}

/// A photograph and which of it counts: everything, or what is near the foreground.
fn task_view(view: &TrainingView, whole: bool) -> Option<TaskView<'_>> {
    if whole {
        return Some(TaskView { view, region: None, tiles: None });
    }
    (view.mask.count() > 0).then(|| TaskView {
        view,
        region: Some(view.mask.dilated(LOSS_DILATION)),
        tiles: Some(TileMask::covering(&view.mask.dilated(TILE_DILATION))),
    })
}
