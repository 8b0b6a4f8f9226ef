//! `ffgs stage voronoi`.

use super::input::{ANY, Input};
use anyhow::{Result, ensure};
use ffgs_arrays::NpzWriter;
use ffgs_voronoi::{GaussianKnn, IntegerCentredTracks, MotionInterpolator};

pub(super) fn run(input: &Input) -> Result<NpzWriter> {
    let tracks = tracks(input)?;
    let size = input.array::<i64>("size", &[Some(2)])?.data;
    let size = input.image_size("size", size[0], size[1])?;
    let (k, sigma) = (input.count("k")?, input.number("sigma")?);
    ensure!(k > 0, input.fault("k", "must be at least 1"));
    ensure!(sigma > 0.0, input.fault("sigma", "must be positive"));
    if tracks.src.is_empty() {
        tracing::warn!("no tracks: the motion is unknown everywhere (confidence 0)");
    }
    let out = GaussianKnn { k, sigma }.densify_integer_centred(&tracks, size, None)?;
    let (h, w) = (size.height, size.width);
    let mut results = NpzWriter::new();
    results.f32("flow", &[h, w, 2], out.flow.as_flattened());
    results.f32("visibility", &[h, w], &out.visibility);
    results.f32("confidence", &[h, w], &out.confidence);
    Ok(results)
}

fn tracks(input: &Input) -> Result<IntegerCentredTracks> {
    let src = input.maybe_empty::<f64>("src", &[ANY, Some(2)])?;
    let n = src.shape[0];
    let tgt = input.maybe_empty::<f64>("tgt", &[Some(n), Some(2)])?;
    let visibility = input.maybe_empty::<f64>("visibility", &[Some(n)])?;
    for (key, array) in [("src", &src), ("tgt", &tgt), ("visibility", &visibility)] {
        input.check_finite(key, array)?;
    }
    let pairs = |values: &[f64]| values.as_chunks::<2>().0.to_vec();
    Ok(IntegerCentredTracks { src: pairs(&src.data), tgt: pairs(&tgt.data), visibility: visibility.data })
}
