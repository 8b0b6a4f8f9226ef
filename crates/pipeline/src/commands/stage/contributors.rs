//! Motion fields to displaced projections of Gaussians (Algorithm 1, lines 15 to 19) from lists of the largest
//! contributors of every pixel; `ffgs stage associate --literal`.

use super::agreement::motions;
use super::input::{ANY, Input, narrow, points2};
use anyhow::{Result, ensure};
use ffgs_arrays::NpzWriter;
use ffgs_core::{ImageSize, Mask};
use ffgs_rasterizer::{ContributorLists, associate_lists};
use glam::DVec2;

pub(super) fn run(input: &Input) -> Result<NpzWriter> {
    let flows = motions(input)?;
    let size = flows[0].size;
    let [h, w] = [Some(size.height), Some(size.width)];
    let indices = input.array::<i32>("top_indices", &[h, w, ANY])?;
    let count = indices.shape[2];
    let weights = input.finite::<f32>("top_weights", &[h, w, Some(count)])?;
    let mask = mask(input, size)?;
    let projected = points2(&input.finite("projected", &[ANY, Some(2)])?.data);
    let floor = input.number("flow_floor")?;
    ensure!(floor >= 0.0, input.fault("flow_floor", "must not be negative"));
    let (indices, weights, projected) = (&indices.data, &weights.data, &projected);
    let lists = ContributorLists { count, indices, weights, mask: &mask, projected };
    let out = associate_lists(&lists, &flows, floor).map_err(|e| input.fault("top_indices", e))?;
    let (l, n) = (flows.len(), projected.len());
    let targets: Vec<f64> = out.targets.iter().flat_map(DVec2::to_array).collect();
    let mut results = NpzWriter::new();
    results.f32("weight", &[l, n], &narrow(&out.weights));
    results.f32("target", &[l, n, 2], &narrow(&targets));
    results.f32("coverage", &[n], &narrow(&out.coverage));
    Ok(results)
}

/// `mask` (H,W), of any numeric type; positive = counts.
pub(super) fn mask(input: &Input, size: ImageSize) -> Result<Mask> {
    let values = input.array::<f32>("mask", &[Some(size.height), Some(size.width)])?.data;
    let bytes = values.iter().map(|&v| u8::from(v > 0.0)).collect();
    Mask::new(size, bytes).ok_or_else(|| input.fault("mask", "another size than the flow"))
}
