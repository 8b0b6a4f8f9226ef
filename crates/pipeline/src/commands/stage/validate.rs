//! `ffgs stage validate`.

use super::input::{ANY, Input, points3};
use anyhow::Result;
use ffgs_arrays::NpzWriter;
use ffgs_core::Mask;
use ffgs_fusion::{Slack, count_views, validate};

pub(super) fn run(input: &Input) -> Result<NpzWriter> {
    let means = points3(&input.array("means", &[ANY, Some(3)])?.data);
    let masks = masks(input)?;
    let cameras = input.cameras(masks[0].size())?;
    let slack = input.count("slack")?;
    let counts = count_views(&means, &cameras, &masks).map_err(|e| input.fault("masks", e))?;
    let slack = Slack { views: u32::try_from(slack).unwrap_or(u32::MAX), share: 0.0, all_views: false };
    let n = counts.len();
    let valid: Vec<u8> = counts.iter().map(|&c| u8::from(validate(c, slack))).collect();
    let mut results = NpzWriter::new();
    results.u8("valid", &[n], &valid);
    results.i32("inside", &[n], &counts.iter().map(|c| c.inside as i32).collect::<Vec<_>>());
    results.i32("seen", &[n], &counts.iter().map(|c| c.seen as i32).collect::<Vec<_>>());
    Ok(results)
}

/// (V,H,W), of any numeric type; positive = foreground. At least one.
fn masks(input: &Input) -> Result<Vec<Mask>> {
    let array = input.array::<f32>("masks", &[ANY, ANY, ANY])?;
    let size = input.image_size("masks", array.shape[1] as i64, array.shape[2] as i64)?;
    let mask = |values: &[f32]| Mask::new(size, values.iter().map(|&v| u8::from(v > 0.0)).collect());
    let masks: Option<Vec<Mask>> = array.data.chunks(size.pixels()).map(mask).collect();
    masks.ok_or_else(|| input.fault("masks", "not whole masks"))
}
