//! Initial points of a capture: positions and colours, from which the first frame is trained.

use crate::error::DatasetError;
use ffgs_arrays::NpzFile;
use ffgs_method::Points;
use glam::DVec3;
use std::path::Path;

/// More points than any scene starts from: as many Gaussians take four gigabytes.
const MAX_POINTS: usize = 1 << 24;
/// So many any capture may have; beyond them no more than [`POINTS_PER_PIXEL`], so that a small file cannot pretend to hold
/// millions.
const ALWAYS: usize = 1 << 20;
/// Points per pixel of the training images of a frame: these have much fewer even where each pixel was triangulated twice.
const POINTS_PER_PIXEL: usize = 4;

/// Reads `data` (N, 7) of the file, with positions relative to `origin` (m), for training images of so many pixels in all.
pub(crate) fn read(file: &Path, origin: DVec3, pixels: usize) -> Result<Points, DatasetError> {
    let most = pixels.saturating_mul(POINTS_PER_PIXEL).clamp(ALWAYS, MAX_POINTS);
    let data =
        NpzFile::open_within(file, most * size_of::<[f64; 7]>())?.shaped::<f64>("data", &[None, Some(7)])?;
    let mut cloud = Points::default();
    for row in data.rows::<7>().unwrap_or_default() {
        let [x, y, z, r, g, b, foreground] = *row;
        let near = DVec3::new(x, y, z) - origin;
        // A mark that is NaN makes the point worthless too.
        let red = if foreground.is_finite() { r } else { f64::NAN };
        cloud.push([near.x, near.y, near.z, red, g, b].map(|v| v as f32), foreground > 0.5);
    }
    Ok(cloud)
}
