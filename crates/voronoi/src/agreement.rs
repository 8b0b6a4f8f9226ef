use crate::MotionError;
use ffgs_core::DenseMotion;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How the agreement between trackers is scored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AgreementConfig {
    /// Least mean flow magnitude the disagreement is divided by (px); 0 = literal Algorithm 1.
    pub magnitude_floor_px: f32,
    /// Leave out trackers that know no motion at a pixel (confidence 0) instead of counting their zero flow as a
    /// disagreement; `false` = literal Algorithm 1.
    pub ignore_unknown: bool,
}

impl Default for AgreementConfig {
    fn default() -> Self {
        Self { magnitude_floor_px: 0.5, ignore_unknown: true }
    }
}

/// Scales the confidence of every tracker of one view by its agreement with the others (Algorithm 1, line 12).
///
/// `flows` holds the L trackers' fields of one view, all of one size. With `D_l` the mean over the other trackers of
/// `|F_l - F_m|` (px) and `M` the mean of `|F_m|` over all, `C_l = C_vor_l exp(-D_l / max(M, floor))`; one tracker
/// alone keeps its confidence.
///
/// # Errors
/// [`MotionError::Size`] when sizes differ, [`MotionError::Floor`] for a negative floor.
pub fn agreement(flows: &mut [DenseMotion], config: &AgreementConfig) -> Result<(), MotionError> {
    let Some(size) = flows.first().map(|f| f.size) else { return Ok(()) };
    if let Some(other) = flows.iter().find(|f| f.size != size) {
        return Err(MotionError::Size { expected: size, found: other.size });
    }
    let floor = config.magnitude_floor_px;
    if !(floor >= 0.0 && floor.is_finite()) {
        return Err(MotionError::Floor(floor));
    }
    let fields: Vec<&[[f32; 2]]> = flows.iter().map(|f| f.flow.as_slice()).collect();
    let known: Vec<Vec<bool>> = (flows.iter())
        .map(|f| f.confidence.iter().map(|&c| c > 0.0 || !config.ignore_unknown).collect())
        .collect();
    let factors: Vec<Vec<f32>> = (0..fields.len())
        .map(|l| {
            (0..size.pixels())
                .into_par_iter()
                .map(|p| factor(&fields, &known, l, p, f64::from(floor)))
                .collect()
        })
        .collect();
    for (flow, factor) in flows.iter_mut().zip(&factors) {
        flow.confidence.iter_mut().zip(factor).for_each(|(c, f)| *c *= f);
    }
    Ok(())
}

/// `exp(-D_l / max(M, floor))` of tracker `l` at `pixel`.
fn factor(fields: &[&[[f32; 2]]], known: &[Vec<bool>], l: usize, pixel: usize, floor: f64) -> f32 {
    if !known[l][pixel] {
        return 1.0;
    }
    let own = fields[l][pixel].map(f64::from);
    let (mut disagreement, mut magnitude, mut others, mut trackers) = (0.0, 0.0, 0.0_f64, 0.0_f64);
    for (m, field) in fields.iter().enumerate() {
        if !known[m][pixel] {
            continue;
        }
        let flow = field[pixel].map(f64::from);
        magnitude += flow[0].hypot(flow[1]);
        trackers += 1.0;
        if m != l {
            disagreement += (own[0] - flow[0]).hypot(own[1] - flow[1]);
            others += 1.0;
        }
    }
    // Equal flows agree perfectly, also where nothing moves and there is no floor (0 / 0).
    if others == 0.0 || disagreement == 0.0 {
        return 1.0;
    }
    (-(disagreement / others) / (magnitude / trackers).max(floor)).exp() as f32
}
