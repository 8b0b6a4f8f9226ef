//! Trains the first frame of a capture and writes it as a PLY:
//! `cargo run --release --example train_frame -- CAPTURE OUT.ply [ITERATIONS]`

use anyhow::{Context, Result, bail};
use ffgs_core::{SkyCube, StageLog};
use ffgs_pipeline::job::frame;
use ffgs_pipeline::plugins::registry::open_capture;
use ffgs_trainer::{
    CpuBackend, FirstFrame, FirstFrameConfig, FirstFrameTask, INITIAL_OPACITY, camera_extent, from_points,
    train_first_frame,
};
use std::path::Path;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let (capture, out, iterations) = match words.as_slice() {
        [capture, out] => (capture, out, 200),
        [capture, out, iterations] => (capture, out, iterations.parse()?),
        _ => bail!("CAPTURE OUT.ply [ITERATIONS]"),
    };
    let capture = open_capture(Path::new(capture))?;
    let views = frame::first_views(&*capture, &frame::select_views(&*capture, None)?, 0)?.views;
    let points = capture.points()?.context("the capture has no initial points")?;
    let config = FirstFrameConfig { iterations, ..FirstFrameConfig::default() };
    let gaussians = from_points(&points.positions, &points.colours, config.sh_degree, INITIAL_OPACITY);
    let start = FirstFrame { gaussians, sky: SkyCube::filled(64, [0.5; 3]) };
    let task = FirstFrameTask { views: &views, start, extent: camera_extent(&views), seed: 1 };
    let mut log = StageLog::default();
    let trained = train_first_frame(&CpuBackend, &config, task, &mut |_| None, &mut log, &mut |step| {
        if step.iteration % 50 == 0 {
            println!("step {}: PSNR {:.2} dB, {} Gaussians", step.iteration, step.psnr, step.gaussians);
        }
    })?;
    ffgs_splats::write_ply(Path::new(out), &trained.gaussians, None)?;
    Ok(())
}
