//! `params.npz`, the file of Dynamic 3D Gaussians, for one frame.

use anyhow::Result;
use ffgs_arrays::NpzWriter;
use ffgs_core::{Gaussians, SH_C0};
use std::path::Path;

/// Writes what a frame changes: `means3D` (1, N, 3), `rgb_colors` (1, N, 3) and `unnorm_rotations` (1, N, 4), f32.
///
/// # Errors
/// When the file cannot be written.
pub(super) fn write(path: &Path, gaussians: &Gaussians) -> Result<()> {
    let count = gaussians.len();
    let colours = gaussians.sh.iter().step_by(gaussians.sh_stride()).map(|sh| sh.map(|v| 0.5 + SH_C0 * v));
    let mut out = NpzWriter::new();
    out.f32("means3D", &[1, count, 3], gaussians.means.as_flattened())
        .f32("rgb_colors", &[1, count, 3], colours.collect::<Vec<_>>().as_flattened())
        .f32("unnorm_rotations", &[1, count, 4], gaussians.quats.as_flattened());
    Ok(out.write(path)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::World;
    use ffgs_arrays::NpzFile;

    #[test]
    fn arrays_have_the_names_and_shapes_of_the_official_code() {
        let folder = tempfile::tempdir().unwrap();
        let (path, gaussians) = (folder.path().join("params.npz"), World::new().gaussians());
        write(&path, &gaussians).unwrap();
        let file = NpzFile::open(&path).unwrap();
        let read = |name: &str, width| {
            file.shaped::<f32>(name, &[Some(1), Some(gaussians.len()), Some(width)]).unwrap().data
        };
        assert_eq!(read("means3D", 3), gaussians.means.as_flattened());
        assert_eq!(read("unnorm_rotations", 4), gaussians.quats.as_flattened());
        let colours: Vec<f32> = gaussians.sh.as_flattened().iter().map(|sh| 0.5 + SH_C0 * sh).collect();
        assert_eq!(read("rgb_colors", 3), colours);
    }
}
