//! Frames of a run fitted to plain viewers: the static layer once, the dynamic one in each frame.

use crate::job::frame::{init_views, select_views, training_views};
use crate::outputs::exposure_files::load_equal;
use crate::outputs::finished_run::FinishedRun;
use anyhow::Result;
use ffgs_bake::{FinetuneConfig, conserve_weight, finetune};
use ffgs_core::{Camera, Gaussians, PixelFilter, Scene, TrainingView};
use ffgs_trainer::CpuBackend;

/// The share of the first frame's steps that a later frame takes: only the dynamic layer is fitted there.
const LATER_SHARE: usize = 3;

/// Bakes frames in any order; what a frame gets does not depend on those before it, except on the first.
pub(crate) struct Baker<'a> {
    run: &'a FinishedRun,
    first: usize,
    iterations: usize,
    still: Option<Still>,
}

/// The static layer as baked, and what baking added to its colours.
struct Still {
    baked: Gaussians,
    colour_change: Vec<[f32; 3]>,
}

impl Still {
    /// The layer of a later frame: shapes and opacities do not change, colours do.
    fn at(&self, layer: &Gaussians) -> Gaussians {
        let mut out = self.baked.clone();
        let colours = layer.sh.iter().zip(&self.colour_change);
        out.sh = colours.map(|(sh, change)| [0, 1, 2].map(|c| sh[c] + change[c])).collect();
        out
    }
}

impl<'a> Baker<'a> {
    /// The static layer is baked in frame `first`.
    pub(crate) fn new(run: &'a FinishedRun, first: usize, iterations: usize) -> Self {
        Self { run, first, iterations, still: None }
    }

    /// Static and dynamic Gaussians of a frame, in this order, for viewers without compensation.
    pub(crate) fn bake(&mut self, scene: &Scene, frame: usize) -> Result<Gaussians> {
        let trained = scene.joint();
        if trained.filter == PixelFilter::Plain {
            return Ok(trained);
        }
        if self.still.is_none() {
            let first = self.run.scene(self.first)?;
            self.still = Some(self.bake_first(&first)?);
        }
        let Some(still) = &self.still else { return Ok(trained) };
        let mut joint = still.at(&scene.static_layer);
        let range = joint.len()..trained.len();
        joint.extend(&plain(&scene.dynamic.gaussians));
        let views = self.views(frame)?;
        conserve_weight(&mut joint, &trained, range.clone(), &cameras(&views));
        let config =
            FinetuneConfig { iterations: self.iterations / LATER_SHARE, ..FinetuneConfig::default() };
        let Ok(()) =
            finetune(&CpuBackend, &mut joint, range.start, &views, &scene.sky, &config, frame as u64);
        Ok(joint)
    }

    /// All of the first frame together, of which the static layer is kept.
    fn bake_first(&self, scene: &Scene) -> Result<Still> {
        let trained = scene.joint();
        let mut joint = plain(&trained);
        let views = self.views(self.first)?;
        conserve_weight(&mut joint, &trained, 0..trained.len(), &cameras(&views));
        let config = FinetuneConfig { iterations: self.iterations, ..FinetuneConfig::default() };
        let Ok(()) = finetune(&CpuBackend, &mut joint, 0, &views, &scene.sky, &config, self.first as u64);
        let indices: Vec<usize> = (0..scene.static_layer.len()).collect();
        let baked = joint.select(&indices);
        let colours = baked.sh.iter().zip(&scene.static_layer.sh);
        let colour_change = colours.map(|(new, old)| [0, 1, 2].map(|c| new[c] - old[c])).collect();
        Ok(Still { baked, colour_change })
    }

    /// The training views of a frame, and in frame 0 the initialisation views as well.
    fn views(&self, frame: usize) -> Result<Vec<TrainingView>> {
        let capture = &*self.run.capture;
        let selected = select_views(capture, self.run.manifest.train_views.as_deref())?;
        let views = [training_views(&selected, frame), init_views(capture, frame)].concat();
        load_equal(capture, &self.run.exposures, &views).map(|(views, _)| views)
    }
}

fn plain(gaussians: &Gaussians) -> Gaussians {
    gaussians.clone().with_filter(PixelFilter::Plain)
}

fn cameras(views: &[TrainingView]) -> Vec<Camera> {
    views.iter().map(|view| view.camera).collect()
}
