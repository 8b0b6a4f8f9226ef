//! Correspondences of sparse and semi-dense trackers.

use crate::error::TracksError;
use ffgs_arrays::{Array, NpzFile};
use ffgs_core::{ImageSize, TrackSet, ViewMotion};
use ffgs_method::{Fault, PixelCenter, Plugin, TrackFormat, Tracked};
use std::path::Path;

/// Most correspondences: so many per pixel, and for small images so many besides.
const MAX_ROWS_PER_PIXEL: usize = 4;
const MAX_ROWS_BESIDES: usize = 1 << 16;

/// Correspondences in a numpy archive.
pub(crate) struct Npz;

impl Plugin for Npz {
    fn name(&self) -> &'static str {
        "npz"
    }

    fn summary(&self) -> &'static str {
        "correspondences: src, tgt (N, 2) px, optional visibility, score (N)"
    }
}

impl TrackFormat for Npz {
    fn is_dense(&self) -> bool {
        false
    }

    fn read(&self, file: &Path, size: ImageSize, center: PixelCenter) -> Result<Tracked, Fault> {
        read(file, size, center).map_err(|error| error.in_file(file))
    }
}

/// Rows that are not finite are dropped and counted.
fn read(file: &Path, size: ImageSize, center: PixelCenter) -> Result<Tracked, TracksError> {
    let most = MAX_ROWS_PER_PIXEL * size.pixels() + MAX_ROWS_BESIDES;
    let npz = NpzFile::open_within(file, most * size_of::<[f64; 2]>())?;
    let positions = |name: &str| npz.shaped::<f32>(name, &[None, Some(2)]);
    let (src, tgt) = (positions("src")?, positions("tgt")?);
    same_rows(file, "tgt", &src, &tgt)?;
    let visibility = column(&npz, file, "visibility", &src)?;
    let score = column(&npz, file, "score", &src)?;
    let rows = src.rows::<2>().unwrap_or_default().iter().zip(tgt.rows::<2>().unwrap_or_default());
    let mut out = TrackSet::default();
    for (i, (src, tgt)) in rows.enumerate() {
        let visible = visibility.as_ref().map_or(1.0, |v| v.data[i]);
        let scored = score.as_ref().map_or(1.0, |s| s.data[i]);
        if src.iter().chain(tgt).chain([&visible, &scored]).all(|v| v.is_finite()) {
            out.src.push(to_half_centers(*src, center));
            out.tgt.push(to_half_centers(*tgt, center));
            out.visibility.push(visible.clamp(0.0, 1.0));
        }
    }
    let (read, kept) = (src.shape[0], out.src.len());
    Ok(Tracked { motion: ViewMotion::Tracks(out), read, dropped: read - kept })
}

/// The one place where a tracker's pixel convention becomes ours (centre of the first pixel at (0.5, 0.5)).
/// Displacements are the same in both.
fn to_half_centers([x, y]: [f32; 2], center: PixelCenter) -> [f32; 2] {
    match center {
        PixelCenter::Integer => [x + 0.5, y + 0.5],
        PixelCenter::Half => [x, y],
    }
}

/// A column (N) or (N, 1); `None` when the file has none.
fn column(
    npz: &NpzFile,
    file: &Path,
    name: &'static str,
    src: &Array<f32>,
) -> Result<Option<Array<f32>>, TracksError> {
    if !npz.has(name) {
        return Ok(None);
    }
    let values = npz.shaped(name, &[None, Some(1)]).or_else(|_| npz.shaped(name, &[None]))?;
    same_rows(file, name, src, &values)?;
    Ok(Some(values))
}

fn same_rows(
    file: &Path,
    column: &'static str,
    src: &Array<f32>,
    other: &Array<f32>,
) -> Result<(), TracksError> {
    let (expected, found) = (src.shape[0], other.shape[0]);
    if expected == found {
        return Ok(());
    }
    Err(TracksError::Columns { file: file.to_owned(), column, expected, found })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integer_centres_shift_by_half_a_pixel_and_flows_stay() {
        let (a, b) = ([3.0, 4.0], [13.0, -6.0]);
        let (c, d) = (to_half_centers(a, PixelCenter::Integer), to_half_centers(b, PixelCenter::Integer));
        assert_eq!((c, d), ([3.5, 4.5], [13.5, -5.5]));
        assert_eq!([d[0] - c[0], d[1] - c[1]], [b[0] - a[0], b[1] - a[1]]);
        assert_eq!(to_half_centers(a, PixelCenter::Half), a);
    }
}
