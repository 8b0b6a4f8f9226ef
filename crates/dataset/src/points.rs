//! Initial points.

use crate::error::DatasetError;
use ffgs_arrays::NpzFile;
use ffgs_method::Points;
use std::path::Path;

/// More points than any scene starts from: as many Gaussians take four gigabytes.
const MAX_POINTS: usize = 1 << 24;

/// Reads `data` (N, 7) of the file.
pub(crate) fn read(file: &Path) -> Result<Points, DatasetError> {
    let data = NpzFile::open_within(file, MAX_POINTS * size_of::<[f64; 7]>())?
        .shaped::<f32>("data", &[None, Some(7)])?;
    let mut cloud = Points::default();
    for row in data.rows::<7>().unwrap_or_default() {
        if row.iter().all(|v| v.is_finite()) {
            let [x, y, z, r, g, b, foreground] = *row;
            cloud.push([x, y, z, r, g, b], foreground > 0.5);
        } else {
            cloud.dropped += 1;
        }
    }
    Ok(cloud)
}
