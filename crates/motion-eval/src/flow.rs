//! True optical flow of a rendered capture, and the errors of motion fields against it.

use crate::score::quantile;
use ffgs_arrays::{ArraysError, NpzFile};
use ffgs_core::{DenseMotion, ImageSize, Mask, is_present};
use serde::Serialize;
use std::path::Path;

/// Exact flow of one view from t-1 to t.
#[derive(Clone, Debug)]
pub struct TrueFlow {
    size: ImageSize,
    flow: Vec<[f32; 2]>,
    /// Pixels whose point is still visible at t.
    visible: Vec<bool>,
}

impl TrueFlow {
    /// Reads `flow` (H, W, 2), `valid` and `visible_next` (H, W); `None` when there is no such file.
    ///
    /// # Errors
    /// [`ArraysError`] when the file does not have that form.
    pub fn read(file: &Path, size: ImageSize) -> Result<Option<Self>, ArraysError> {
        if !is_present(file) {
            return Ok(None);
        }
        let npz = NpzFile::open(file)?;
        let (h, w) = (Some(size.height), Some(size.width));
        let flow = npz.shaped::<f32>("flow", &[h, w, Some(2)])?;
        let valid = npz.shaped::<u8>("valid", &[h, w])?.data;
        let next = npz.shaped::<u8>("visible_next", &[h, w])?.data;
        let visible = valid.iter().zip(&next).map(|(&v, &n)| v != 0 && n != 0).collect();
        Ok(Some(Self { size, flow: flow.data.as_chunks::<2>().0.to_vec(), visible }))
    }
}

/// Two-dimensional end-point errors of a motion field.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FlowSummary {
    /// Pixels in the mask, still visible at t, where the field knows a motion.
    pub pixels: usize,
    /// Median error (px).
    pub median_px: f64,
    /// 90th percentile (px).
    pub p90_px: f64,
    /// Share of the errors under 1 px.
    pub below_1px: f64,
}

/// Appends the errors (px) of `field` inside `mask` to `out`.
pub fn flow_error(field: &DenseMotion, truth: &TrueFlow, mask: &Mask, out: &mut Vec<f64>) {
    if field.size != truth.size || mask.size() != truth.size {
        return;
    }
    for (p, &inside) in mask.data().iter().enumerate() {
        if inside != 0 && truth.visible[p] && field.confidence[p] > 0.0 {
            let [x, y] = [0, 1].map(|a| f64::from(field.flow[p][a] - truth.flow[p][a]));
            out.push(x.hypot(y));
        }
    }
}

impl FlowSummary {
    /// Summary of errors (px) in any order.
    pub fn of(errors: &mut [f64]) -> Self {
        errors.sort_by(f64::total_cmp);
        let below = errors.partition_point(|&e| e < 1.0);
        Self {
            pixels: errors.len(),
            median_px: quantile(errors, 0.5),
            p90_px: quantile(errors, 0.9),
            below_1px: below as f64 / errors.len().max(1) as f64,
        }
    }
}
