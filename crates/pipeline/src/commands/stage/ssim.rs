//! `ffgs stage ssim`: the similarity that a run reports and the loss that it trains with; literally, SSIM of any images in
//! f64 with its maps and gradients.

use super::input::{ANY, Input, narrow};
use anyhow::{Result, ensure};
use ffgs_arrays::NpzWriter;
use ffgs_core::{ImageRgb8, ImageSize, PlanarImage};
use ffgs_metrics::{Border, LossAndGradient, SsimError, SsimMap, SsimPair, loss_3dgs, ssim_and_gradient};
use ffgs_trainer::{LossRegion, PhotometricLoss};

/// Pixels that a map with `Border::Valid` is smaller by.
const VALID_MARGIN: usize = ffgs_metrics::WINDOW - 1;

/// As a run has it: `img2` is a photograph, rounded to 8 bit.
pub(super) fn run(input: &Input) -> Result<NpzWriter> {
    let rendered = planar(input, "img1")?;
    let target = ImageRgb8::from(&planar(input, "img2")?);
    ensure!(rendered.size() == target.size(), input.fault("img2", "another size than img1"));
    let ImageSize { width, height } = rendered.size();
    let mut gradient = PlanarImage::zeros(rendered.size());
    let loss = PhotometricLoss::new().evaluate(&rendered, &target, LossRegion::Full, &mut gradient);
    let mut results = NpzWriter::new();
    results.f32("ssim", &[], &[SsimMap::new(&rendered, &target)?.mean() as f32]);
    results.f32("loss", &[], &[loss.total as f32]);
    results.f32("loss_grad", &[3, height, width], gradient.data());
    Ok(results)
}

fn planar(input: &Input, key: &str) -> Result<PlanarImage> {
    let image = input.finite::<f32>(key, &[Some(3), ANY, ANY])?;
    let mut out = PlanarImage::zeros(input.image_size(key, image.shape[1] as i64, image.shape[2] as i64)?);
    out.data_mut().copy_from_slice(&image.data);
    Ok(out)
}

/// To the letter.
pub(super) fn run_literal(input: &Input) -> Result<NpzWriter> {
    let rendered = input.finite::<f32>("img1", &[ANY, ANY, ANY])?;
    let shape = [rendered.shape[0], rendered.shape[1], rendered.shape[2]];
    let target = input.finite::<f32>("img2", &shape.map(Some))?;
    let pair = SsimPair::new(shape, &rendered.data, &target.data)?;
    let mut results = NpzWriter::new();
    add(&mut results, "same", shape, shape, &ssim_and_gradient(pair, Border::Same)?);
    match ssim_and_gradient(pair, Border::Valid) {
        Ok(valid) => {
            let map = [shape[0], shape[1] - VALID_MARGIN, shape[2] - VALID_MARGIN];
            add(&mut results, "valid", shape, map, &valid);
        }
        Err(error @ SsimError::SmallerThanWindow { .. }) => {
            tracing::warn!("valid_* left out: {error}");
        }
        Err(error) => return Err(error.into()),
    }
    let loss = loss_3dgs(pair)?;
    results.f32("loss3dgs_value", &[], &[loss.value as f32]);
    results.f32("loss3dgs_grad", &shape, &narrow(&loss.gradient));
    Ok(results)
}

fn add(results: &mut NpzWriter, name: &str, shape: [usize; 3], map: [usize; 3], found: &LossAndGradient) {
    results.f32(&format!("{name}_value"), &[], &[found.value as f32]);
    results.f32(&format!("{name}_map"), &map, &narrow(&found.map));
    results.f32(&format!("{name}_grad"), &shape, &narrow(&found.gradient));
}
