//! The methods that move the scene, as they are registered.

use crate::plugins::method::{Method, MethodContext};
use anyhow::{Result, bail};
use ffgs_method::MotionMethod;
use ffgs_methods::{Dynamic3dgs, Queen, Trackersplat, TrainLayer, hicom, recongs};
use ffgs_motion::{Standstill, TrackerMotion};
use ffgs_trainer::{CpuBackend, Epochs, train_layer};
use ffgs_trainer_gpu::GpuBackend;

/// The paper's method with all trackers.
pub(crate) const TRACKERS: Method = Method {
    usage: "trackers",
    former: Some("fused"),
    summary: "moved by all trackers, fused (the paper's method)",
    build: all_trackers,
};

/// The same with one tracker.
pub(crate) const TRACKER: Method = Method {
    usage: "tracker:NAME",
    former: None,
    summary: "moved by one tracker of the capture",
    build: one_tracker,
};

/// No motion initialisation.
pub(crate) const NONE: Method = Method {
    usage: "none",
    former: None,
    summary: "where the last frame ended: training alone follows what moves",
    build: |_, _| Ok(Box::new(Standstill)),
};

/// HiCoM.
pub(crate) const HICOM: Method = Method {
    usage: "hicom",
    former: None,
    summary: "grids of cubes that move all Gaussians, then Gaussians added (HiCoM, 2024)",
    build: |context, _| Ok(trained_here(context, hicom(context.config.method.hicom))),
};

/// Dynamic 3D Gaussians.
pub(crate) const DYNAMIC3DGS: Method = Method {
    usage: "dynamic3dgs",
    former: None,
    summary: "the last velocities, then training with rigid neighbours (Dynamic 3D Gaussians, 2024)",
    build: |context, _| Ok(trained_here(context, Dynamic3dgs::new(context.config.method.dynamic3dgs))),
};

/// QUEEN.
pub(crate) const QUEEN: Method = Method {
    usage: "queen",
    former: None,
    summary: "gated displacements and integers that decode to residuals, trained and coded (QUEEN, 2024)",
    build: |context, _| Ok(trained_here(context, Queen::new(context.config.method.queen))),
};

/// ReCon-GS.
pub(crate) const RECONGS: Method = Method {
    usage: "recongs",
    former: None,
    summary: "anchors that move all Gaussians, then Gaussians added (ReCon-GS, 2025)",
    build: |context, _| Ok(trained_here(context, recongs(context.config.method.recongs))),
};

/// TrackerSplat.
pub(crate) const TRACKERSPLAT: Method = Method {
    usage: "trackersplat",
    former: None,
    summary: "affine motions under footprints, solved in space and spread, then training (TrackerSplat, 2025)",
    build: trackersplat,
};

fn trackersplat<'a>(context: &MethodContext<'a>, _: &str) -> Result<Box<dyn MotionMethod + 'a>> {
    if context.tracks.is_empty() {
        bail!(
            "the capture has no trackers (tracks/tracks.json), and TrackerSplat moves Gaussians by tracks; add one"
        );
    }
    let gpu = context.gpu;
    let train: Box<TrainLayer> = Box::new(move |task, schedule, seed| {
        let order = Epochs::new(task.views.len(), seed);
        match gpu {
            None => train_layer(&CpuBackend, task, schedule, &order, &mut |_| {})?,
            Some(gpu) => train_layer(&GpuBackend(gpu), task, schedule, &order, &mut |_| {})?,
        };
        Ok(())
    });
    let config = context.config.method.trackersplat;
    Ok(Box::new(Trackersplat { config, voronoi: context.config.voronoi, train }))
}

/// A method that trains every Gaussian in its own way, on the CPU.
fn trained_here<'a>(context: &MethodContext, method: impl MotionMethod + 'a) -> Box<dyn MotionMethod + 'a> {
    if context.gpu.is_some() {
        tracing::info!(
            "this method trains on the CPU; the first frame and the scores are computed on the GPU"
        );
    }
    Box::new(method)
}

fn moved_by<'a>(context: &MethodContext<'a>, only: Option<String>) -> Box<dyn MotionMethod + 'a> {
    Box::new(TrackerMotion { config: context.config.motion(), only, gpu: context.gpu })
}

fn all_trackers<'a>(context: &MethodContext<'a>, _: &str) -> Result<Box<dyn MotionMethod + 'a>> {
    if context.tracks.is_empty() {
        bail!(
            "the capture has no trackers (tracks/tracks.json), so nothing says how things move; `ffgs prepare` \
             makes some, --method none starts each frame where the last one ended"
        );
    }
    Ok(moved_by(context, None))
}

fn one_tracker<'a>(context: &MethodContext<'a>, name: &str) -> Result<Box<dyn MotionMethod + 'a>> {
    let known: Vec<&str> = context.tracks.iter().map(|source| source.name()).collect();
    if !known.contains(&name) {
        bail!("there is no tracker '{name}'; tracks/tracks.json names: {}", known.join(", "));
    }
    Ok(moved_by(context, Some(name.to_owned())))
}
