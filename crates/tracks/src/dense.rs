use crate::{LoadStats, TracksError};
use ffgs_arrays::read_npy;
use ffgs_core::{DenseMotion, ImageSize};
use std::path::Path;

/// Middlebury's convention: a larger component means that the flow is unknown.
const UNKNOWN_FLOW: f32 = 1e9;

/// Displacements (px) of a file, row-major.
pub(crate) struct RawFlow {
    pub size: ImageSize,
    pub flow: Vec<[f32; 2]>,
}

impl RawFlow {
    /// Confidence 1 where there is motion (standing still included); unknown and non-finite pixels get 0 and count.
    pub fn into_motion(
        self,
        file: &Path,
        expected: ImageSize,
        stats: &mut LoadStats,
    ) -> Result<DenseMotion, TracksError> {
        if self.size != expected {
            return Err(TracksError::Size { file: file.to_owned(), expected, found: self.size });
        }
        let mut motion = DenseMotion::unknown(expected);
        stats.read += self.flow.len();
        for (i, flow) in self.flow.iter().enumerate() {
            if flow.iter().all(|v| v.abs() <= UNKNOWN_FLOW) {
                motion.flow[i] = *flow;
                motion.visibility[i] = 1.0;
                motion.confidence[i] = 1.0;
            } else {
                stats.dropped += 1;
            }
        }
        Ok(motion)
    }
}

/// A flow of another size than its camera is still read, so that the error names the size, up to so many times its
/// pixels.
const MAX_LARGER: usize = 16;

/// Reads a numpy array (H, W, 2). `expected` is the camera's image size.
pub(crate) fn read_npy_flow(file: &Path, expected: ImageSize) -> Result<RawFlow, TracksError> {
    let most = expected.pixels().saturating_mul(MAX_LARGER * size_of::<[f64; 2]>());
    let array = read_npy::<f32>(file, &[None, None, Some(2)], most)?;
    let size = ImageSize { width: array.shape[1], height: array.shape[0] };
    Ok(RawFlow { size, flow: array.rows::<2>().unwrap_or_default().to_vec() })
}
