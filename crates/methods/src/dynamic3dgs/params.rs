//! `params.npz`, the file of Dynamic 3D Gaussians: all frames in one, or one frame alone.

use super::SH0;
use anyhow::{Result, ensure};
use ffgs_arrays::{NpzFile, NpzWriter};
use ffgs_core::Gaussians;
use std::path::Path;

/// Writes what a frame changes: `means3D` (1, N, 3), `rgb_colors` (1, N, 3) and `unnorm_rotations` (1, N, 4), f32. With `still`, also what no
/// frame changes: `logit_opacities` (N, 1), `log_scales` (N, 3) and `seg_colors` (N, 3), of which the first `foreground` are red.
///
/// # Errors
/// When the file cannot be written.
pub(super) fn write(path: &Path, gaussians: &Gaussians, still: Option<usize>) -> Result<()> {
    let count = gaussians.len();
    let colours = gaussians.sh.iter().step_by(gaussians.sh_stride()).map(|sh| sh.map(|v| 0.5 + SH0 * v));
    let mut out = NpzWriter::new();
    out.f32("means3D", &[1, count, 3], gaussians.means.as_flattened())
        .f32("rgb_colors", &[1, count, 3], colours.collect::<Vec<_>>().as_flattened())
        .f32("unnorm_rotations", &[1, count, 4], gaussians.quats.as_flattened());
    if let Some(foreground) = still {
        let segments = (0..count).map(|i| if i < foreground { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] });
        out.f32("logit_opacities", &[count, 1], &gaussians.opacity_logits)
            .f32("log_scales", &[count, 3], gaussians.log_scales.as_flattened())
            .f32("seg_colors", &[count, 3], segments.collect::<Vec<_>>().as_flattened());
    }
    Ok(out.write(path)?)
}

/// The frames of a `params.npz` with everything in it, as the official code writes it; colours become SH of degree 0.
///
/// # Errors
/// When the file is none, or its arrays do not fit together.
pub fn read_params(path: &Path) -> Result<Vec<Gaussians>> {
    let file = NpzFile::open(path)?;
    let means = file.shaped::<f32>("means3D", &[None, None, Some(3)])?;
    let (frames, count) = (means.shape[0], means.shape[1]);
    let per_frame = |name: &str, width| file.shaped::<f32>(name, &[Some(frames), Some(count), Some(width)]);
    let (colours, turns) = (per_frame("rgb_colors", 3)?, per_frame("unnorm_rotations", 4)?);
    let opacities = file.shaped::<f32>("logit_opacities", &[Some(count), Some(1)])?;
    let scales = file.shaped::<f32>("log_scales", &[Some(count), Some(3)])?;
    let frame = |t: usize| {
        let mut out = Gaussians::zeros(count, 0);
        out.means.copy_from_slice(means.data.as_chunks().0[t * count..].split_at(count).0);
        out.quats.copy_from_slice(turns.data.as_chunks().0[t * count..].split_at(count).0);
        out.log_scales.copy_from_slice(scales.data.as_chunks().0);
        out.opacity_logits.copy_from_slice(&opacities.data);
        let colours: &[[f32; 3]] = colours.data.as_chunks().0;
        for (sh, colour) in out.sh.iter_mut().zip(&colours[t * count..]) {
            *sh = colour.map(|v| (v - 0.5) / SH0);
        }
        out
    };
    let out: Vec<Gaussians> = (0..frames).map(frame).collect();
    ensure!(out.iter().all(Gaussians::is_finite), "{}: a value is not finite", path.display());
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::World;

    #[test]
    fn what_is_written_is_read() {
        let folder = std::env::temp_dir().join(format!("ffgs-params-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (file, gaussians) = (folder.join("params.npz"), World::new().gaussians());
        write(&file, &gaussians, Some(7)).unwrap();
        let read = read_params(&file).unwrap();
        assert_eq!(read.len(), 1);
        assert_eq!((&read[0].means, &read[0].quats), (&gaussians.means, &gaussians.quats));
        assert_eq!(
            (&read[0].log_scales, &read[0].opacity_logits),
            (&gaussians.log_scales, &gaussians.opacity_logits)
        );
        let far = ffgs_testkit::largest_difference(read[0].sh.as_flattened(), gaussians.sh.as_flattened());
        assert!(far < 1e-6, "{far}");
        write(&file, &gaussians, None).unwrap();
        assert!(read_params(&file).unwrap_err().to_string().contains("logit_opacities"), "a frame alone");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
