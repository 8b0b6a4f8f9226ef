//! The fixed surroundings of a layer under training, on the device.

use crate::kernels;
use crate::sky::GpuSky;
use crate::target::Target;
use crate::workspace::{OPTIONS, Workspace};
use ffgs_gpu::{Buffer, Commands, GpuError, Groups};
use ffgs_rasterizer_gpu::{
    GpuScene, SceneDevice, bin_to_tiles, count_views, prepare, render_split, tile_depths,
};
use ffgs_trainer::{CutLayers, TaskView};

/// [`ffgs_trainer::Around`] with its content on the device; cut layers are in the targets.
pub(crate) enum Surroundings {
    Sky(GpuSky),
    Trained(GpuSky),
    Cut,
}

impl Surroundings {
    /// Puts the sky into the layers of a target's view.
    pub(crate) fn draw(&self, commands: &mut Commands, target: &Target) {
        match self {
            Self::Sky(sky) | Self::Trained(sky) => sky.draw(commands, target),
            Self::Cut => {}
        }
    }

    /// One step of the sky, if it is trained.
    pub(crate) fn step(
        &self,
        commands: &mut Commands,
        target: &Target,
        workspace: &Workspace,
        corrections: &Buffer,
    ) {
        if let Self::Trained(sky) = self {
            sky.step(commands, target, &workspace.scratch, corrections);
        }
    }

    /// The sky, if it is trained.
    pub(crate) fn trained(&self) -> Option<&GpuSky> {
        if let Self::Trained(sky) = self { Some(sky) } else { None }
    }
}

/// Renders sky and static layer once per view into what is in front of and behind `layer`. Counts in `seen` the views that
/// see each Gaussian of it.
pub(crate) fn cut(
    device: &SceneDevice,
    layers: CutLayers,
    layer: &GpuScene,
    views: &[TaskView],
    (targets, workspace): (&mut [Target], &mut Workspace),
    seen: &Buffer,
) -> Result<(), GpuError> {
    let gpu = &device.gpu;
    let static_layer = device.layer(layers.static_layer)?;
    for scene in [&static_layer, layer] {
        workspace.fit(scene, targets, OPTIONS)?;
    }
    let sky = GpuSky::fixed(gpu, layers.sky)?;
    for (target, task) in targets.iter_mut().zip(views) {
        let weight = layers.outside_alpha / task.view.mask.count() as f32;
        let weight = gpu.uniform("penalty", &[weight, 0.0, 0.0, 0.0])?;
        let (view, scratch) = (&target.view, &workspace.scratch);
        let depths = gpu.buffer("tile depths", view.slots() as u64 * 4)?;
        // Two scenes share the view's uniform, so they take two submissions.
        let submit = |scene: &GpuScene, record: &dyn Fn(&mut Commands)| {
            scratch.restart(gpu, scene.count);
            prepare(gpu, scene, view, scratch, OPTIONS, 0);
            let mut commands = gpu.commands();
            bin_to_tiles(&mut commands, scene, view, scratch);
            record(&mut commands);
            gpu.submit(commands)
        };
        submit(layer, &|commands| {
            tile_depths(commands, view, scratch, &depths);
            count_views(commands, layer, view, scratch, seen);
        })?;
        submit(&static_layer, &|commands| {
            sky.draw(commands, target);
            render_split(commands, view, scratch, &depths);
            let buffers = [view.uniform(), &weight, view.slot_list(), &target.region, &view.layers];
            commands.run(&kernels::ALPHA_PENALTY, &buffers, Groups::of(view.slots(), 1));
        })?;
        target.keep_layers(gpu)?;
    }
    Ok(())
}
