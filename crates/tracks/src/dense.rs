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

/// Reads a numpy array (H, W, 2).
pub(crate) fn read_npy_flow(file: &Path) -> Result<RawFlow, TracksError> {
    let array = read_npy::<f32>(file)?.expect_shape(&[None, None, Some(2)])?;
    let size = ImageSize { width: array.shape[1], height: array.shape[0] };
    Ok(RawFlow { size, flow: array.rows::<2>().unwrap_or_default().to_vec() })
}
