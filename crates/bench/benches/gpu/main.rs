//! A training step on the GPU, kernel by kernel, beside the same forward pass on the CPU: `cargo xtask bench --device gpu`
//! runs this and compares it with the adapter's own rates, which are measured in the same pass.

mod lanes;
mod machine;
mod rows;
// The scenes of the CPU's benchmarks: the cases are the same.
#[allow(dead_code, reason = "the CPU's benchmarks need more of it")]
#[path = "../cpu/scene.rs"]
mod scene;
mod stages;
mod steps;

use anyhow::{Context, Result};
use clap::Parser;
use ffgs_gpu::Gpu;
use ffgs_rasterizer_gpu::SceneDevice;
use rows::Rows;
use std::path::PathBuf;

/// What to time.
#[derive(Parser)]
pub struct Options {
    /// Adapter, as `ffgs devices` numbers them.
    #[arg(long)]
    adapter: Option<usize>,
    /// Image sizes.
    #[arg(long, value_delimiter = ',', default_value = "320x180,1280x720,1920x1080")]
    sizes: Vec<String>,
    /// Gaussians.
    #[arg(long, value_delimiter = ',', default_value = "20000,200000,1000000")]
    counts: Vec<usize>,
    /// Foreground shares of the dynamic lane (percent).
    #[arg(long, value_delimiter = ',', default_value = "1,5,20,50")]
    shares: Vec<u32>,
    /// Samples of each case; the median counts.
    #[arg(long, default_value_t = 9)]
    samples: usize,
    /// Where the rows go.
    #[arg(long)]
    out: Option<PathBuf>,
    /// What cargo adds.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let device = SceneDevice::new(Gpu::open(options.adapter)?);
    let gpu = &device.gpu;
    let mut rows = Rows::new(gpu, options.samples);
    machine::rates(gpu, &mut rows)?;
    for size in &options.sizes {
        let size = image_size(size)?;
        for &count in &options.counts {
            steps::step(gpu, size, count, &mut rows)?;
        }
    }
    stages::stages(&device, &mut rows)?;
    for &share in &options.shares {
        lanes::dynamic(&device, share, &mut rows)?;
    }
    match &options.out {
        Some(path) => std::fs::write(path, rows.text())?,
        None => print!("{}", rows.text()),
    }
    Ok(())
}

fn image_size(text: &str) -> Result<ffgs_core::ImageSize> {
    let (width, height) = text.split_once('x').with_context(|| format!("{text} is not WIDTHxHEIGHT"))?;
    Ok(ffgs_core::ImageSize { width: width.parse()?, height: height.parse()? })
}
