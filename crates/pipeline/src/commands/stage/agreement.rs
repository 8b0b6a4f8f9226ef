//! `ffgs stage agreement`.

use super::input::{ANY, Input};
use anyhow::{Result, ensure};
use ffgs_arrays::NpzWriter;
use ffgs_core::DenseMotion;
use ffgs_voronoi::{AgreementConfig, agreement};

pub(super) fn run(input: &Input) -> Result<NpzWriter> {
    let mut flows = motions(input)?;
    let floor = input.number("magnitude_floor")?;
    ensure!(floor >= 0.0, input.fault("magnitude_floor", "must not be negative"));
    // Every tracker counts at every pixel, as Algorithm 1 has it.
    let config = AgreementConfig { magnitude_floor_px: floor as f32, ignore_unknown: false };
    agreement(&mut flows, None, &config)?;
    let size = flows[0].size;
    let confidence: Vec<f32> = flows.iter().flat_map(|f| f.confidence.iter().copied()).collect();
    let mut results = NpzWriter::new();
    results.f32("confidence", &[flows.len(), size.height, size.width], &confidence);
    Ok(results)
}

/// The trackers' fields: `flow` (L,H,W,2) with `confidence` (L,H,W). At least one.
pub(super) fn motions(input: &Input) -> Result<Vec<DenseMotion>> {
    let flow = input.finite::<f32>("flow", &[ANY, ANY, ANY, Some(2)])?;
    let [l, h, w] = [flow.shape[0], flow.shape[1], flow.shape[2]];
    let confidence = input.finite::<f32>("confidence", &[Some(l), Some(h), Some(w)])?.data;
    let size = input.image_size("flow", h as i64, w as i64)?;
    let pixels = size.pixels();
    let fields = flow.data.as_chunks::<2>().0.chunks(pixels).zip(confidence.chunks(pixels));
    let motion = |(flow, confidence): (&[[f32; 2]], &[f32])| DenseMotion {
        size,
        flow: flow.to_vec(),
        visibility: vec![1.0; pixels],
        confidence: confidence.to_vec(),
    };
    Ok(fields.map(motion).collect())
}
