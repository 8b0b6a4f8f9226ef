//! The dynamic lane of a streamed frame, on both devices.

use crate::rows::Rows;
use crate::scene::{camera, discs, training_view};
use anyhow::Result;
use ffgs_core::{Gaussians, ImageSize, Mask, SkyCube, TrainingView};
use ffgs_gpu::GpuError;
use ffgs_rasterizer_gpu::SceneDevice;
use ffgs_trainer::{CpuBackend, DynamicLaneConfig, Surroundings, train_dynamic};
use ffgs_trainer_gpu::GpuBackend;
use std::sync::Arc;

/// As the CPU's case: 640x360, three views, 100 000 Gaussians, 40 steps, uploads and caches included.
pub(crate) const SIZE: ImageSize = ImageSize { width: 640, height: 360 };
const GAUSSIANS: usize = 100_000;
const STEPS: usize = 40;

/// Rows `gpu/dynamic_lane/SHARE%` and `cpu/dynamic_lane/SHARE%`, SHARE = foreground in the image.
pub(crate) fn dynamic(device: &SceneDevice, percent: u32, rows: &mut Rows) -> Result<()> {
    let (all, sky) = (discs(GAUSSIANS, 3, 0.45), SkyCube::filled(64, [0.5; 3]));
    let mask = disc(f64::from(percent) / 100.0);
    let (moving, still) = split(&all, &mask);
    let views: Vec<TrainingView> =
        [-0.2, 0.0, 0.2].map(|x| training_view(&all, camera(SIZE, x), mask.clone())).into();
    let config = DynamicLaneConfig { iterations: STEPS, ..DynamicLaneConfig::default() };
    let still = Arc::new(still);
    let around = Surroundings { static_layer: &still, sky: &sky, prior: None };
    let mut failed: Option<GpuError> = None;
    let seconds = rows.time(|| {
        let mut layer = moving.clone();
        let ran = train_dynamic(&GpuBackend(device), &config, &views, around, &mut layer, 1, &mut |_| {});
        failed = failed.take().or(ran.err());
    });
    failed.map_or(Ok(()), Err)?;
    rows.add(&format!("gpu/dynamic_lane/{percent}%"), seconds, None);
    let seconds = rows.time(|| {
        let mut layer = moving.clone();
        let Ok(_) = train_dynamic(&CpuBackend, &config, &views, around, &mut layer, 1, &mut |_| {});
    });
    rows.add(&format!("cpu/dynamic_lane/{percent}%"), seconds, None);
    Ok(())
}

/// An ellipse with the given share of the image.
pub(crate) fn disc(share: f64) -> Mask {
    let radius = (share / std::f64::consts::PI).sqrt();
    let inside = |i: usize| {
        let x = (i % SIZE.width) as f64 / SIZE.width as f64 - 0.5;
        let y = (i / SIZE.width) as f64 / SIZE.height as f64 - 0.5;
        u8::from(x.hypot(y) < radius)
    };
    Mask::new(SIZE, (0..SIZE.pixels()).map(inside).collect()).expect("one byte per pixel")
}

/// Gaussians whose centres fall into the mask of the middle camera, and the others.
fn split(all: &Gaussians, mask: &Mask) -> (Gaussians, Gaussians) {
    let camera = camera(SIZE, 0.0);
    let inside = |i: &usize| {
        let mean = glam::Vec3::from(all.means[*i]).as_dvec3();
        camera.pixel_of(mean).is_some_and(|(x, y)| mask.contains(x, y))
    };
    let (moving, still): (Vec<usize>, Vec<usize>) = (0..all.len()).partition(inside);
    (all.select(&moving), all.select(&still))
}
