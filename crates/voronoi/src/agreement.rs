use crate::MotionError;
use ffgs_core::{DenseMotion, Mask};
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
/// `flows` holds the L trackers' fields of one view, all of one size; `region` restricts the work to its foreground
/// pixels (`None` = every pixel). With `D_l` the mean over the other trackers of `|F_l - F_m|` (px) and `M` the mean of
/// `|F_m|` over all, `C_l = C_vor_l exp(-D_l / max(M, floor))`; one tracker alone keeps its confidence.
///
/// # Errors
/// [`MotionError::Size`] when sizes differ, [`MotionError::Floor`] for a negative floor.
pub fn agreement(
    flows: &mut [DenseMotion],
    region: Option<&Mask>,
    config: &AgreementConfig,
) -> Result<(), MotionError> {
    let Some(size) = flows.first().map(|f| f.size) else { return Ok(()) };
    let sizes = flows.iter().map(|f| f.size).chain(region.map(Mask::size));
    if let Some(found) = sizes.into_iter().find(|s| *s != size) {
        return Err(MotionError::Size { expected: size, found });
    }
    let floor = config.magnitude_floor_px;
    if !(floor >= 0.0 && floor.is_finite()) {
        return Err(MotionError::Floor(floor));
    }
    let mut fields = Vec::with_capacity(flows.len());
    let mut bands: Vec<Vec<&mut [f32]>> = vec![];
    bands.resize_with(size.pixels().div_ceil(PIXELS), Vec::new);
    for flow in flows {
        fields.push(flow.flow.as_slice());
        bands.iter_mut().zip(flow.confidence.chunks_mut(PIXELS)).for_each(|(band, part)| band.push(part));
    }
    let pixels = Pixels { fields, ignore_unknown: config.ignore_unknown, floor: floor.into() };
    bands.into_par_iter().enumerate().for_each(|(b, mut confidences)| {
        let mut factors = vec![0.0; confidences.len()];
        for k in (0..confidences[0].len()).filter(|k| region.is_none_or(|m| m.data()[b * PIXELS + k] != 0)) {
            pixels.factors(b * PIXELS + k, |l| confidences[l][k], &mut factors);
            confidences.iter_mut().zip(&factors).for_each(|(c, f)| c[k] *= f);
        }
    });
    Ok(())
}

/// Pixels a task scores.
const PIXELS: usize = 1 << 12;

struct Pixels<'a> {
    fields: Vec<&'a [[f32; 2]]>,
    ignore_unknown: bool,
    floor: f64,
}

impl Pixels<'_> {
    /// `exp(-D_l / max(M, floor))` of every tracker l at `pixel`, given their confidences.
    fn factors(&self, pixel: usize, confidence: impl Fn(usize) -> f32, out: &mut [f32]) {
        let known = |m: &usize| confidence(*m) > 0.0 || !self.ignore_unknown;
        let trackers = || (0..self.fields.len()).filter(known);
        let flow = |m: usize| self.fields[m][pixel].map(f64::from);
        let magnitude: f64 = trackers().map(|m| length(flow(m))).sum();
        let count = trackers().count() as f64;
        out.fill(1.0);
        for l in trackers() {
            let [x, y] = flow(l);
            let disagreement: f64 = trackers().map(flow).map(|[u, v]| length([x - u, y - v])).sum();
            // Equal flows agree perfectly, also where nothing moves and there is no floor (0 / 0).
            if disagreement > 0.0 {
                let mean = disagreement / (count - 1.0);
                out[l] = (-mean / (magnitude / count).max(self.floor)).exp() as f32;
            }
        }
    }
}

/// Of f32 numbers, whose squares f64 holds without overflow.
fn length([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}
