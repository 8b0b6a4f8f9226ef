//! Training of some Gaussians with all their parameters, among others that are drawn along and stay.

use crate::backend::{Around, LayerTask, LayerTraining, Revision, TaskView, TrainBackend};
use crate::density_control::{DensityConfig, DensityControl};
use crate::lengths::robust_extent;
use crate::schedule::{Epochs, Schedule};
use crate::view::Progress;
use ffgs_core::{Gaussians, Mask, SkyCube, TrainingView};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, TileMask, View};
use std::sync::Arc;

/// Alpha from which a pixel shows a Gaussian.
const SHOWN: f32 = 0.02;
/// Fewest pixels of a view that counts.
const LEAST_PIXELS: usize = 16;
/// Share of the steps after which invisible Gaussians are used elsewhere.
const REUSE_AT: f32 = 0.4;

/// What is trained, what is drawn with it, and what both are compared with.
pub(crate) struct Subset<'a> {
    /// These stay.
    pub fixed: Gaussians,
    /// These are trained.
    pub trained: Gaussians,
    /// Photographs.
    pub views: &'a [TrainingView],
    /// Pixels of each of them that count.
    pub regions: Vec<Mask>,
    /// Behind everything.
    pub sky: &'a SkyCube,
}

/// Trains them; `None` when too few pixels count.
///
/// # Errors
/// When the device fails or has too little memory.
pub(crate) fn train_subset<B: TrainBackend>(
    backend: &B,
    schedule: &Schedule,
    subset: Subset,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<Option<Gaussians>, B::Error> {
    let used: Vec<usize> =
        (0..subset.regions.len()).filter(|&v| subset.regions[v].count() >= LEAST_PIXELS).collect();
    if used.is_empty() {
        return Ok(None);
    }
    let extent = robust_extent(&subset.trained);
    let fixed = subset.fixed.len();
    let mut all = subset.fixed;
    all.extend(&subset.trained);
    let mut all = Arc::new(all);
    let task = |&v: &usize| TaskView {
        view: &subset.views[v],
        tiles: Some(TileMask::covering(&subset.regions[v])),
        region: Some(subset.regions[v].clone()),
    };
    let task = LayerTask::new(&mut all, used.iter().map(task).collect(), Around::Sky(subset.sky));
    let mut training = backend.upload_layer(LayerTask { fixed, sums_gradients: true, ..task })?;
    let mut density = DensityControl::new(DensityConfig::default(), seed);
    let reuse_at = (REUSE_AT * schedule.iterations as f32) as usize;
    let mut reuse = |done, training: &mut B::Layer<'_>| {
        if done != reuse_at {
            return Ok(());
        }
        training.revise(&mut |gaussians, sums| {
            density.reuse(gaussians, sums, fixed, extent);
            Revision::default()
        })
    };
    schedule.run(&mut training, &mut Epochs::new(used.len(), seed), &mut reuse, report)?;
    training.download()?;
    Ok(Some(all.select(&(fixed..all.len()).collect::<Vec<_>>())))
}

/// The pixels that show any of `gaussians`, if nothing stood before them.
pub(crate) fn shown(view: &TrainingView, gaussians: &Gaussians) -> Mask {
    let size = view.camera.size();
    let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: None };
    let mut tape = RenderTape::default();
    CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() })
        .render(gaussians, &frame, &mut tape);
    let shown = tape.transmittance().iter().map(|t| u8::from(1.0 - t > SHOWN));
    Mask::new(size, shown.collect()).expect("one value per pixel")
}
