//! `ffgs stage ssim`.

use super::input::{ANY, Input, narrow};
use anyhow::Result;
use ffgs_arrays::NpzWriter;
use ffgs_metrics::{Border, LossAndGradient, SsimError, SsimPair, loss_3dgs, ssim_and_gradient};

/// Pixels that a map with `Border::Valid` is smaller by.
const VALID_MARGIN: usize = ffgs_metrics::WINDOW - 1;

pub(super) fn run(input: &Input) -> Result<NpzWriter> {
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
