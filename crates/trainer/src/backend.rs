//! Where training is computed. Schedules, the order of views, density control and the loops of the lanes exist once, in
//! this crate; a backend has the memory and the arithmetic of single steps (docs/adr/0032-where-training-is-computed.md).

use crate::adam::Columns;
use crate::density_control::{GradientSums, IndexMap};
use crate::rates::LearningRates;
use crate::{Prior, Progress};
use ffgs_core::{Gaussians, Mask, SkyCube, TrainingView};
use ffgs_rasterizer::{RenderOptions, TileMask};
use std::sync::Arc;

/// A device that trains.
pub trait TrainBackend: Sync {
    /// What can go wrong on the device.
    type Error: std::error::Error + Send + Sync + 'static;
    /// Gaussians under training.
    type Layer<'a>: LayerTraining<Error = Self::Error>
    where
        Self: 'a;
    /// A sky under training behind a layer that stays.
    type Sky<'a>: SkyTraining<Error = Self::Error>
    where
        Self: 'a;

    /// Brings all that the steps of `task` need to the device.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    fn upload_layer<'a>(&'a self, task: LayerTask<'a>) -> Result<Self::Layer<'a>, Self::Error>;

    /// Likewise.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    fn upload_sky<'a>(&'a self, task: SkyTask<'a>) -> Result<Self::Sky<'a>, Self::Error>;
}

/// What a [`Schedule`](crate::Schedule) steps: [`forward`](Self::forward), [`backward`](Self::backward), [`step`](Self::step), as often
/// as the schedule says.
pub trait Training {
    /// What can go wrong in a step.
    type Error;

    /// Draws a view with `options`, and differentiates the loss by its pixels.
    ///
    /// # Errors
    /// When the device fails.
    fn forward(&mut self, view: usize, options: RenderOptions) -> Result<(), Self::Error>;

    /// Differentiates by what is trained, and adds the derivatives of the terms of the loss that are not photometric.
    ///
    /// # Errors
    /// When the device fails.
    fn backward(&mut self) -> Result<(), Self::Error>;

    /// One step of Adam down these derivatives.
    ///
    /// # Errors
    /// When the device fails.
    fn step(&mut self, rates: &LearningRates) -> Result<(), Self::Error>;

    /// One step of `share` of the way to where the prior expects the minimum ([`LayerTask::prior`]), in which no value changes by
    /// more than [`LONGEST`](crate::constants::LONGEST) of its rate. Without a prior a step of Adam.
    ///
    /// # Errors
    /// When the device fails.
    fn step_naturally(&mut self, _share: f32, rates: &LearningRates) -> Result<(), Self::Error> {
        self.step(rates)
    }

    /// What the positions alone could still gain by natural steps (nats; mean over the Gaussians that steps have moved): half the
    /// squared Newton decrement (Boyd and Vandenberghe 2004, section 9.5). `None` where there is no prior to expect it by.
    ///
    /// # Errors
    /// When the device fails.
    fn expected_gain(&mut self) -> Result<Option<f64>, Self::Error> {
        Ok(None)
    }

    /// How far the training has come after `done` steps of `all`; `None` where a look at the device would cost more than
    /// it is worth.
    ///
    /// # Errors
    /// When the device fails.
    fn progress(&mut self, _done: usize, _all: usize) -> Result<Option<Progress>, Self::Error> {
        Ok(None)
    }
}

/// Gaussians under training on a backend. [`backward`](Training::backward) adds the derivative of the task's prior,
/// [`step`](Training::step) moves the Gaussians that were drawn, others where the task says so, and the sky where it is trained. Between steps
/// [`revise`](Self::revise) and [`revise_sky`](Self::revise_sky) may be called, at the end [`download`](Self::download). Until then the layer of the task is as it was, or of
/// no meaning after an error.
pub trait LayerTraining: Training {
    /// Hands the Gaussians and their gradient sums to `decide`, which may change them, and goes on with what it leaves.
    ///
    /// # Errors
    /// When the device fails.
    fn revise(
        &mut self,
        decide: &mut dyn FnMut(&mut Gaussians, &GradientSums) -> Revision,
    ) -> Result<(), Self::Error>;

    /// Hands the Gaussians and the sky to `decide`, which may change the sky, where it is trained.
    ///
    /// # Errors
    /// When the device fails.
    fn revise_sky(&mut self, decide: &mut dyn FnMut(&Gaussians, &mut SkyCube)) -> Result<(), Self::Error>;

    /// Whether some step lacked memory on the device. If so there is more of it now, the layer is back at its start, and
    /// all steps must be taken again.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    fn must_repeat(&mut self) -> Result<bool, Self::Error> {
        Ok(false)
    }

    /// Writes what was trained into the task's layer, and into its sky.
    ///
    /// # Errors
    /// When the device fails.
    fn download(self) -> Result<(), Self::Error>;
}

/// A sky under training.
pub trait SkyTraining {
    /// What can go wrong on the device.
    type Error;

    /// One step of Adam on the texels that a view sees.
    ///
    /// # Errors
    /// When the device fails.
    fn step(&mut self, view: usize) -> Result<(), Self::Error>;

    /// Writes the texels into the task's sky.
    ///
    /// # Errors
    /// When the device fails.
    fn download(self) -> Result<(), Self::Error>;
}

/// What to train Gaussians with.
pub struct LayerTask<'a> {
    /// The Gaussians. A device that holds this very `Arc` need not be told its content again.
    pub layer: &'a mut Arc<Gaussians>,
    /// Parameters that move.
    pub columns: Columns,
    /// Photographs, in the order that steps count them.
    pub views: Vec<TaskView<'a>>,
    /// What stands around the layer.
    pub around: Around<'a>,
    /// What is known of the layer; `None` = nothing.
    pub prior: Option<Prior<'a>>,
    /// Whether density control will ask for gradient sums.
    pub sums_gradients: bool,
    /// Number of Gaussians at the front that are drawn and stay as they are.
    pub fixed: usize,
    /// Whether a step of Adam also moves Gaussians that it does not draw, by their momentum ([`Update::Coasting`](crate::Update::Coasting)).
    pub coasts: bool,
}

impl<'a> LayerTask<'a> {
    /// All parameters of the Gaussians that a step draws, without a prior and without density control.
    pub fn new(layer: &'a mut Arc<Gaussians>, views: Vec<TaskView<'a>>, around: Around<'a>) -> Self {
        let columns = Columns::ALL;
        Self { layer, columns, views, around, prior: None, sums_gradients: false, fixed: 0, coasts: false }
    }
}

/// What to train a sky with.
pub struct SkyTask<'a> {
    /// The texels.
    pub sky: &'a mut SkyCube,
    /// Step size.
    pub rate: f32,
    /// What stands before the sky.
    pub layer: &'a Arc<Gaussians>,
    /// Photographs, each with a region.
    pub views: Vec<TaskView<'a>>,
}

/// A photograph, and how much of it counts.
pub struct TaskView<'a> {
    /// Camera and photograph.
    pub view: &'a TrainingView,
    /// Pixels of the loss; `None` = all.
    pub region: Option<Mask>,
    /// Tiles to draw, which hold the region; `None` = all.
    pub tiles: Option<TileMask>,
}

impl<'a> TaskView<'a> {
    /// Pixels of the loss.
    pub fn pixels(&self) -> usize {
        self.region.as_ref().map_or(self.view.camera.size().pixels(), Mask::count)
    }

    /// A view of which the pixels of `region` count.
    pub(crate) fn of_region(view: &'a TrainingView, region: Mask) -> Self {
        Self { view, region: Some(region), tiles: None }
    }
}

/// Mean over views of the pixels that count.
pub fn mean_pixels(views: &[TaskView]) -> usize {
    views.iter().map(TaskView::pixels).sum::<usize>() / views.len().max(1)
}

/// What stands around a layer under training.
pub enum Around<'a> {
    /// A sky behind it, which stays.
    Sky(&'a SkyCube),
    /// A sky behind it that is trained along, with this step size.
    TrainedSky(&'a mut SkyCube, f32),
    /// Both, as they look from every view at the start, cut at the depth of the layer (docs/adr/0003).
    Cut(CutLayers<'a>),
}

/// What is cut at the depth of the layer under training.
#[derive(Clone, Copy)]
pub struct CutLayers<'a> {
    /// Gaussians in front of and behind the layer.
    pub static_layer: &'a Arc<Gaussians>,
    /// Behind everything.
    pub sky: &'a SkyCube,
    /// Weight of the layer's mean alpha outside a view's region.
    pub outside_alpha: f32,
}

/// What was changed between two steps.
#[derive(Clone, Debug, Default)]
pub struct Revision {
    /// Where the Gaussians came from; their gradient sums start anew. `None` = they are the same ones in the same order.
    pub map: Option<IndexMap>,
    /// The moments of all opacities start anew.
    pub opacities_reset: bool,
}
