//! A layer under training on the device: one submission per step, which reads nothing back.

use crate::optimiser::Optimiser;
use crate::prior::GpuPrior;
use crate::sky::GpuSky;
use crate::surroundings::{Surroundings, cut};
use crate::target::{Shared, Target, leave_device};
use crate::workspace::{OPTIONS, Workspace, in_short_memory, largest_view};
use ffgs_core::{Gaussians, SkyCube};
use ffgs_gpu::{Commands, GpuError};
use ffgs_rasterizer::RenderOptions;
use ffgs_rasterizer_gpu::{GpuScene, Place, SceneDevice, backward, prepare, render};
use ffgs_trainer::{
    Around, Columns, GradientSums, IndexMap, LayerTask, LayerTraining, LearningRates, Progress, Revision,
    SKY_DOUBT, Training, mean_pixels,
};
use std::sync::Arc;

/// Gaussians under training on the GPU. A step is one submission and reads nothing back.
pub struct GpuLayer<'a> {
    device: &'a SceneDevice,
    layer: &'a mut Arc<Gaussians>,
    /// As the host has it, where it is trained.
    sky: Option<&'a mut SkyCube>,
    columns: Columns,
    on_device: OnDevice<'a>,
    /// Number of the step; a Gaussian's gradient with another stamp is stale.
    stamp: u32,
    /// The view at hand.
    at: usize,
    /// What the step at hand has recorded so far.
    commands: Option<Commands<'a>>,
}

/// What a training has on the device.
struct OnDevice<'a> {
    targets: Vec<Target<'a>>,
    around: Surroundings,
    prior: Option<GpuPrior<'a>>,
    workspace: Workspace<'a>,
    optimiser: Optimiser<'a>,
}

impl<'a> OnDevice<'a> {
    fn new(device: &'a SceneDevice, task: &LayerTask<'a>, place: Place) -> Result<Self, GpuError> {
        let LayerTask { layer, columns, views, around, prior, fixed, coasts, .. } = task;
        let gpu = &device.gpu;
        let mut workspace = Workspace::new(gpu, layer.len(), largest_view(views))?;
        // Cut layers are a view's own; a sky is drawn anew in each step, into layers that all views share.
        let shared = Shared::new(gpu, views, place, !matches!(around, Around::Cut(_)))?;
        let mut targets = Target::all(gpu, views, &shared)?;
        let optimiser = Optimiser::new(gpu, start(device, layer, *columns)?, *columns)?;
        let optimiser = optimiser.moving(*fixed, *coasts);
        let seen = gpu.buffer("views of each Gaussian", optimiser.scene.count as u64 * 4)?;
        let around = match around {
            Around::Sky(sky) => Surroundings::Sky(GpuSky::fixed(gpu, sky)?),
            Around::TrainedSky(sky, rate) => {
                // A mean over pixels: the derivative of one is about this large.
                let typical = 1.0 / (3 * largest_view(views)) as f32;
                let trained = GpuSky::trained(gpu, sky)?;
                trained.prepare(gpu, *rate, typical, SKY_DOUBT * typical);
                Surroundings::Trained(trained)
            }
            Around::Cut(layers) => {
                cut(device, *layers, &optimiser.scene, views, (&mut targets, &mut workspace), &seen)?;
                Surroundings::Cut
            }
        };
        let prior = match prior {
            Some(prior) => Some(GpuPrior::new(gpu, *prior, &optimiser.scene, (seen, mean_pixels(views)))?),
            None => None,
        };
        let mut made = Self { targets, around, prior, workspace, optimiser };
        made.fit()?;
        Ok(made)
    }

    fn fit(&mut self) -> Result<(), GpuError> {
        self.workspace.fit(&self.optimiser.scene, &self.targets, OPTIONS)
    }
}

impl<'a> GpuLayer<'a> {
    pub(crate) fn new(device: &'a SceneDevice, task: LayerTask<'a>) -> Result<Self, GpuError> {
        let on_device = in_short_memory(device, |place| OnDevice::new(device, &task, place))?;
        let LayerTask { layer, columns, around, .. } = task;
        let sky = if let Around::TrainedSky(sky, _) = around { Some(sky) } else { None };
        Ok(Self { device, layer, sky, columns, on_device, stamp: 0, at: 0, commands: None })
    }

    /// Does what needs memory, and once more without photographs on the device where that is full.
    fn with_room(
        &mut self,
        act: &mut dyn FnMut(&mut OnDevice<'a>) -> Result<(), GpuError>,
    ) -> Result<(), GpuError> {
        match act(&mut self.on_device) {
            Err(GpuError::OutOfMemory) => {
                self.device.leave_photographs();
                let left = leave_device(&mut self.on_device.targets, &self.device.gpu)?;
                if left { act(&mut self.on_device) } else { Err(GpuError::OutOfMemory) }
            }
            result => result,
        }
    }

    /// The commands of the step at hand.
    fn recording(&mut self) -> Commands<'a> {
        let device = self.device;
        self.commands.take().unwrap_or_else(|| device.gpu.commands())
    }

    /// Room is made for half as much again as was needed at the start; beyond that the farthest splats of a view are left
    /// out, until the next revision.
    fn warn_of_missing_room(&self) -> Result<(), GpuError> {
        if !self.on_device.workspace.was_enough()? {
            tracing::warn!("training: the farthest splats of some views were left out of some steps");
        }
        Ok(())
    }

    /// Takes the step at hand, by Adam or by a share of the natural step where there is a prior.
    fn descend(&mut self, natural: Option<f32>, rates: &LearningRates) -> Result<(), GpuError> {
        let mut commands = self.recording();
        let Self { on_device, stamp, at, .. } = self;
        let OnDevice { targets, around, prior, workspace, optimiser } = on_device;
        let target = &targets[*at];
        if let (Some(share), Some(prior)) = (natural, &prior) {
            prior.prepare(workspace.gpu, (share, rates), *stamp, optimiser.fixed);
            prior.step(&mut commands, optimiser);
        } else {
            optimiser.prepare(rates, *stamp);
            optimiser.step(&mut commands);
        }
        around.step(&mut commands, target, workspace, optimiser.corrections());
        workspace.gpu.submit(commands)
    }

    fn sums(&self) -> Result<GradientSums, GpuError> {
        let ledger = self.on_device.optimiser.ledger()?;
        Ok(GradientSums {
            norms: ledger.iter().map(|l| l.gradient_norm).collect(),
            views: ledger.iter().map(|l| l.views).collect(),
        })
    }
}

/// The layer as training finds it: columns that do not move are shared with what the device keeps.
fn start(device: &SceneDevice, layer: &Arc<Gaussians>, columns: Columns) -> Result<GpuScene, GpuError> {
    if columns.geometry() {
        return GpuScene::upload(&device.gpu, layer);
    }
    let kept = device.layer(layer)?;
    let sh = device.gpu.buffer("spherical harmonics", kept.sh.bytes())?;
    let mut commands = device.gpu.commands();
    commands.copy(&kept.sh, &sh, kept.sh.bytes());
    device.gpu.submit(commands)?;
    Ok(GpuScene { sh, ..kept })
}

impl Training for GpuLayer<'_> {
    type Error = GpuError;

    fn forward(&mut self, view: usize, options: RenderOptions) -> Result<(), GpuError> {
        self.stamp += 1;
        self.at = view;
        let mut commands = self.recording();
        let OnDevice { targets, around, workspace, optimiser, .. } = &self.on_device;
        let (scene, target) = (&optimiser.scene, &targets[view]);
        target.bring(workspace.gpu);
        prepare(workspace.gpu, scene, &target.view, &workspace.scratch, options, self.stamp);
        around.draw(&mut commands, target);
        render(&mut commands, scene, &target.view, &workspace.scratch);
        workspace.loss(&mut commands, target);
        self.commands = Some(commands);
        Ok(())
    }

    fn backward(&mut self) -> Result<(), GpuError> {
        let mut commands = self.recording();
        let OnDevice { targets, prior, workspace, optimiser, .. } = &self.on_device;
        let target = &targets[self.at];
        backward(&mut commands, &optimiser.scene, &target.view, &workspace.scratch, &optimiser.gradients);
        if let Some(prior) = prior {
            prior.pull(&mut commands, target, optimiser);
        }
        self.commands = Some(commands);
        Ok(())
    }

    fn step(&mut self, rates: &LearningRates) -> Result<(), GpuError> {
        self.descend(None, rates)
    }

    fn step_naturally(&mut self, share: f32, rates: &LearningRates) -> Result<(), GpuError> {
        self.descend(Some(share), rates)
    }

    /// Decided on the host: a few times in a training, 60 bytes per Gaussian.
    fn expected_gain(&mut self) -> Result<Option<f64>, GpuError> {
        let OnDevice { prior, optimiser, .. } = &self.on_device;
        let gain = prior.as_ref().map(|prior| prior.expected_gain(optimiser));
        gain.transpose().map(Option::flatten)
    }

    fn progress(&mut self, done: usize, all: usize) -> Result<Option<Progress>, GpuError> {
        let OnDevice { workspace, optimiser, .. } = &self.on_device;
        workspace.progress(done, all, optimiser.scene.count)
    }
}

impl LayerTraining for GpuLayer<'_> {
    /// Decided on the host: a few times in a training, 300 bytes per Gaussian.
    fn revise(
        &mut self,
        decide: &mut dyn FnMut(&mut Gaussians, &GradientSums) -> Revision,
    ) -> Result<(), GpuError> {
        self.warn_of_missing_room()?;
        let mut gaussians = self.on_device.optimiser.download()?;
        let Revision { map, opacities_reset } = decide(&mut gaussians, &self.sums()?);
        let same = map.is_none();
        let map = map.unwrap_or_else(|| IndexMap::identity(gaussians.len()));
        self.with_room(&mut |on| on.optimiser.replace(&gaussians, &map, (!opacities_reset, same)))?;
        self.with_room(&mut OnDevice::fit)
    }

    /// Decided on the host: once in a training.
    fn revise_sky(&mut self, decide: &mut dyn FnMut(&Gaussians, &mut SkyCube)) -> Result<(), GpuError> {
        let Self { device, sky, on_device, .. } = self;
        let (Some(texels), Some(sky)) = (on_device.around.trained(), sky) else { return Ok(()) };
        texels.download(&device.gpu, sky)?;
        decide(&on_device.optimiser.download()?, sky);
        texels.replace(&device.gpu, sky);
        Ok(())
    }

    fn must_repeat(&mut self) -> Result<bool, GpuError> {
        if self.on_device.workspace.was_enough()? {
            return Ok(false);
        }
        self.with_room(&mut |on| on.workspace.grow())?;
        let (device, layer, columns) = (self.device, self.layer.clone(), self.columns);
        self.with_room(&mut |on| {
            let Optimiser { fixed, coasts, .. } = on.optimiser;
            let scene = start(device, &layer, columns)?;
            on.optimiser = Optimiser::new(&device.gpu, scene, columns)?.moving(fixed, coasts);
            Ok(())
        })?;
        self.stamp = 0;
        self.with_room(&mut OnDevice::fit)?;
        Ok(true)
    }

    fn download(self) -> Result<(), GpuError> {
        self.warn_of_missing_room()?;
        let Self { device, layer, sky, columns, on_device, .. } = self;
        let OnDevice { around, optimiser, .. } = on_device;
        let trained = optimiser.download()?;
        if let (Some(texels), Some(sky)) = (around.trained(), sky) {
            texels.download(&device.gpu, sky)?;
        }
        *layer = Arc::new(trained);
        if !columns.geometry() {
            device.keep(layer, optimiser.scene);
        }
        device.gpu.release_unused();
        Ok(())
    }
}
