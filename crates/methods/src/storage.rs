//! Frames of HiCoM and ReCon-GS as they store them: the deltas of their nodes, and the Gaussians that were added.

use anyhow::Result;
use ffgs_arrays::NpzWriter;
use ffgs_core::Gaussians;
use std::path::{Path, PathBuf};

/// Writes `frame.npz` into `folder`: `deltas` (M, 7), those that moved the Gaussians, and the columns of the Gaussians behind the first
/// `kept`. Arrays are f32, deflated.
///
/// # Errors
/// When the file cannot be written.
pub(crate) fn write(
    folder: &Path,
    deltas: &[[f32; 7]],
    gaussians: &Gaussians,
    kept: usize,
) -> Result<PathBuf> {
    let added = gaussians.select(&(kept..gaussians.len()).collect::<Vec<_>>());
    let (path, count, stride) = (folder.join("frame.npz"), added.len(), added.sh_stride());
    NpzWriter::new()
        .f32("deltas", &[deltas.len(), 7], deltas.as_flattened())
        .f32("means", &[count, 3], added.means.as_flattened())
        .f32("quats", &[count, 4], added.quats.as_flattened())
        .f32("log_scales", &[count, 3], added.log_scales.as_flattened())
        .f32("opacity_logits", &[count], &added.opacity_logits)
        .f32("sh", &[count, stride, 3], added.sh.as_flattened())
        .write(&path)?;
    Ok(path)
}
