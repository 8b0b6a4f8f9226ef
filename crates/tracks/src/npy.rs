//! Optical flow as a numpy array.

use crate::error::TracksError;
use crate::flow::{FlowFormat, RawFlow};
use ffgs_arrays::read_npy;
use ffgs_core::ImageSize;
use std::path::Path;

/// A flow of another size than its camera is still read, so that the error names the size, up to so many times its
/// pixels.
const MAX_LARGER: usize = 16;

/// Flow as a numpy array.
pub(crate) const NPY: FlowFormat =
    FlowFormat { name: "npy", summary: "optical flow as a numpy array (H, W, 2) px", read };

fn read(file: &Path, expected: ImageSize) -> Result<RawFlow, TracksError> {
    let most = expected.pixels().saturating_mul(MAX_LARGER * size_of::<[f64; 2]>());
    let array = read_npy::<f32>(file, &[None, None, Some(2)], most)?;
    let size = ImageSize { width: array.shape[1], height: array.shape[0] };
    Ok(RawFlow { size, flow: array.rows::<2>().unwrap_or_default().to_vec() })
}
