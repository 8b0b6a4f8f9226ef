//! Renders a PLY of this program (trained with opacity compensation) into a PNG, as seen by a camera of a capture:
//! `cargo run --release --example render_ply -- PLY CAPTURE CAMERA OUT.png`

use anyhow::{Context, Result};
use ffgs_core::ImageRgb8;
use ffgs_dataset::write_image;
use ffgs_method::{Split, ViewAt};
use ffgs_pipeline::plugins::registry::open_capture;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use std::path::Path;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [ply, capture, name, out] = words.as_slice() else { anyhow::bail!("PLY CAPTURE CAMERA OUT.png") };
    let capture = open_capture(Path::new(capture))?;
    let view = capture.views(Split::Train).iter().position(|view| view == name).context("no such camera")?;
    let camera = capture.camera(ViewAt { split: Split::Train, view, frame: 0 })?;
    let splats = ffgs_splats::read_ply(Path::new(ply))?;
    let mut tape = RenderTape::default();
    let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
    CpuRasterizer::default().render(&splats.gaussians, &view, &mut tape);
    Ok(write_image(Path::new(out), &ImageRgb8::from(tape.image()))?)
}
