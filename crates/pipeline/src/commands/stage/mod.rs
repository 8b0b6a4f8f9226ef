//! Single stages on numpy arrays: what `ffgs stage` does.
//!
//! Inputs may be of any float width, integer type and byte order; arrays that a stage does not know are ignored.

mod agreement;
mod associate;
mod contributors;
mod fuse;
mod input;
mod rasterize;
mod ssim;
mod triangulate;
mod validate;
mod voronoi;

use crate::job::device::Device;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use ffgs_arrays::NpzWriter;
use ffgs_fusion::FusionConfig;
use input::Input;
use std::path::Path;

/// A stage that runs alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Stage {
    /// Tracks to a dense motion field: src, tgt (N,2), visibility (N), size (H,W), k, sigma -> flow, visibility,
    /// confidence. Pixel centres at whole numbers (Algorithm 2)
    Voronoi,
    /// Agreement between trackers: flow (L,H,W,2), confidence (L,H,W), magnitude_floor (px) -> confidence
    Agreement,
    /// Motion to Gaussians: in_means, in_quats, in_log_scales, in_opacity_logits, in_sh, in_viewmat, in_K, width, height, flow
    /// (L,H,W,2), confidence (L,H,W), mask (H,W) -> weight (L,N), target (L,N,2). To the letter: top_indices, top_weights
    /// (H,W,K), flow, confidence, mask, projected (N,2), flow_floor (px) -> also coverage (N)
    Associate,
    /// Displaced projections to positions: means (N,3), targets (V,N,2), weights (V,N), intrinsics (V,4),
    /// camera_from_world (V,4,4) -> means, covariances, valid
    Triangulate,
    /// Trackers with the temporal prior: prior_means, prior_covariances, means (L,N,3), covariances (L,N,3,3),
    /// valid (L,N) -> means, covariances, q
    Fuse,
    /// Positions against masks: means (N,3), intrinsics, camera_from_world, masks (V,H,W), slack -> valid, inside,
    /// seen
    Validate,
    /// Gaussians to an image, and its gradients: in_means, in_quats, in_log_scales, in_opacity_logits, in_sh,
    /// in_viewmat, in_K, in_background, width, height, sh_degree, antialiased, w_rgb, w_alpha -> image, alpha, grad_*
    Rasterize,
    /// Similarity of images: img1, img2 (3,H,W) -> ssim, loss, loss_grad. To the letter: img1, img2 (C,H,W) -> same_*, valid_*,
    /// loss3dgs_* (value, map, grad)
    Ssim,
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let value = self.to_possible_value().expect("no stage is hidden");
        f.write_str(value.get_name())
    }
}

/// Whether a stage does what a run does with the default settings, or our most literal reading of the paper. They differ for
/// [`Stage::Associate`], [`Stage::Fuse`] and [`Stage::Ssim`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// As a run.
    Run,
    /// To the letter, and for SSIM in f64.
    Literal,
}

/// Runs one stage on the arrays of `input` and writes its results to `output` (.npz), whole or not at all.
///
/// # Errors
/// Names the file and the array that cannot be used, or the device that cannot run the stage.
pub fn run(stage: Stage, form: Form, input: &Path, output: &Path, device: &Device) -> Result<()> {
    if stage != Stage::Rasterize && matches!(device, Device::Gpu(_)) {
        bail!("--device: stage {stage} runs on the CPU only; rasterize runs on a GPU");
    }
    let arrays = Input::open(input)?;
    let results: Result<NpzWriter> = match stage {
        Stage::Voronoi => voronoi::run(&arrays),
        Stage::Agreement => agreement::run(&arrays),
        Stage::Associate if form == Form::Literal => contributors::run(&arrays),
        Stage::Associate => associate::run(&arrays),
        Stage::Triangulate => triangulate::run(&arrays),
        Stage::Fuse if form == Form::Literal => fuse::run(&arrays, FusionConfig::literal()),
        Stage::Fuse => fuse::run(&arrays, FusionConfig::default()),
        Stage::Validate => validate::run(&arrays),
        Stage::Rasterize => rasterize::run(&arrays, device),
        Stage::Ssim if form == Form::Literal => ssim::run_literal(&arrays),
        Stage::Ssim => ssim::run(&arrays),
    };
    results.with_context(|| format!("stage {stage} on {}", input.display()))?.write(output)?;
    Ok(())
}
