//! How far trackers agree at each pixel, as a factor of their confidence (Algorithm 1, line 12).

use crate::MotionError;
use crate::exponential::exp_negative;
use crate::normalised::any;
use ffgs_core::{DenseMotion, Mask, instructions};
use pulp::{Simd, WithSimd};
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
    bands.into_par_iter().enumerate().for_each(|(band, confidences)| {
        let start = band * PIXELS;
        let pixels = start..start + confidences[0].len();
        let flows: Vec<_> = fields.iter().map(|field| &field[pixels.clone()]).collect();
        let region = region.map(|mask| &mask.data()[pixels]);
        instructions().dispatch(Band { flows: &flows, confidences, region, config });
    });
    Ok(())
}

/// Pixels a task scores.
const PIXELS: usize = 1 << 12;
/// Pixels scored side by side. Plain loops over them become vectors of the dispatched instruction set.
const LANES: usize = 64;
type Column = [f64; LANES];

struct Band<'a> {
    /// (L) flows, confidences and the region at the same pixels.
    flows: &'a [&'a [[f32; 2]]],
    confidences: Vec<&'a mut [f32]>,
    region: Option<&'a [u8]>,
    config: &'a AgreementConfig,
}

/// What a tracker says at some pixels.
#[derive(Clone)]
struct Tracker {
    x: Column,
    y: Column,
    /// 1 where it counts, 0 where not.
    known: Column,
    /// Sum of the distances from the flows of the others that count.
    disagreement: Column,
}

impl WithSimd for Band<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        let blank =
            Tracker { x: [0.0; LANES], y: [0.0; LANES], known: [0.0; LANES], disagreement: [0.0; LANES] };
        let mut trackers = vec![blank; self.flows.len()];
        let pixels = self.flows[0].len();
        for start in (0..pixels).step_by(LANES) {
            let part = start..(start + LANES).min(pixels);
            let region = self.region.map(|region| &region[part.clone()]);
            if region.is_some_and(|region| !any(region)) {
                continue;
            }
            for (l, tracker) in trackers.iter_mut().enumerate() {
                let ignore_unknown = self.config.ignore_unknown;
                tracker.load(
                    &self.flows[l][part.clone()],
                    &self.confidences[l][part.clone()],
                    ignore_unknown,
                );
            }
            compare(&mut trackers);
            let scale = scale(&trackers, self.config.magnitude_floor_px.into());
            for (tracker, confidences) in trackers.iter().zip(&mut self.confidences) {
                tracker.weigh(&scale, region, &mut confidences[part.clone()]);
            }
        }
    }
}

impl Tracker {
    #[inline(always)]
    fn load(&mut self, flows: &[[f32; 2]], confidences: &[f32], ignore_unknown: bool) {
        let n = flows.len().min(LANES);
        let (flows, confidences) = (&flows[..n], &confidences[..n]);
        for k in 0..n {
            let counts = confidences[k] > 0.0 || !ignore_unknown;
            // An unknown flow may be anything.
            let [x, y] = if counts { flows[k] } else { [0.0; 2] };
            self.known[k] = if counts { 1.0 } else { 0.0 };
            (self.x[k], self.y[k]) = (x.into(), y.into());
        }
        self.disagreement = [0.0; LANES];
    }

    /// Multiplies confidences in the region by `exp(-D / max(M, floor))`.
    #[inline(always)]
    fn weigh(&self, scale: &Column, region: Option<&[u8]>, confidences: &mut [f32]) {
        let mut factors = [1.0; LANES];
        for k in 0..LANES {
            let disagreement = self.disagreement[k] * self.known[k];
            let factor = exp_negative(disagreement / scale[k]) as f32;
            // Equal flows agree perfectly, also where nothing moves and there is no floor (0 / 0).
            factors[k] = if disagreement > 0.0 { factor } else { 1.0 };
        }
        if let Some(region) = region {
            for (factor, inside) in factors.iter_mut().zip(region) {
                *factor = if *inside != 0 { *factor } else { 1.0 };
            }
        }
        for (confidence, factor) in confidences.iter_mut().zip(factors) {
            *confidence *= factor;
        }
    }
}

/// Adds the distance between the flows of each two to the disagreement of both.
#[inline(always)]
fn compare(trackers: &mut [Tracker]) {
    for second in 1..trackers.len() {
        let (firsts, seconds) = trackers.split_at_mut(second);
        let b = &mut seconds[0];
        for a in firsts {
            for k in 0..LANES {
                let distance = length([a.x[k] - b.x[k], a.y[k] - b.y[k]]);
                a.disagreement[k] += b.known[k] * distance;
                b.disagreement[k] += a.known[k] * distance;
            }
        }
    }
}

/// What the sum of a tracker's distances is divided by: `max(M, floor)` times the number of the others.
#[inline(always)]
fn scale(trackers: &[Tracker], floor: f64) -> Column {
    let (mut magnitude, mut count) = ([0.0; LANES], [0.0; LANES]);
    for tracker in trackers {
        for k in 0..LANES {
            magnitude[k] += tracker.known[k] * length([tracker.x[k], tracker.y[k]]);
            count[k] += tracker.known[k];
        }
    }
    for k in 0..LANES {
        let mean = magnitude[k] / count[k];
        magnitude[k] = if mean > floor { mean } else { floor } * (count[k] - 1.0);
    }
    magnitude
}

/// Of f32 numbers, whose squares f64 holds without overflow.
#[inline(always)]
fn length([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_testkit::vectorised;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const N: usize = 5 * LANES + 7;

    /// (3) flows and confidences of trackers that agree in part; some know nothing, some say what is no number.
    fn trackers() -> (Vec<Vec<[f32; 2]>>, Vec<Vec<f32>>) {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut flow = |k: usize| match k % 7 {
            0 => [0.0; 2],
            1 => [2.0, -1.0],
            _ => [rng.random_range(-9.0..9.0), rng.random_range(-9.0..9.0)],
        };
        let mut flows: Vec<Vec<[f32; 2]>> = (0..3).map(|_| (0..N).map(&mut flow).collect()).collect();
        let mut confidences = vec![vec![0.75; N]; 3];
        for k in (0..N).step_by(11) {
            (flows[k % 3][k], confidences[k % 3][k]) = ([f32::NAN; 2], 0.0);
        }
        (flows, confidences)
    }

    #[test]
    fn every_instruction_set_scores_the_same_bits() {
        let (flows, confidences) = trackers();
        let flows: Vec<&[[f32; 2]]> = flows.iter().map(Vec::as_slice).collect();
        let region: Vec<u8> = (0..N).map(|k| u8::from(k % 13 != 0)).collect();
        let configs = [
            (AgreementConfig::default(), None),
            (AgreementConfig::default(), Some(region.as_slice())),
            (AgreementConfig { magnitude_floor_px: 0.0, ignore_unknown: true }, None),
        ];
        for (config, region) in configs {
            let score = |set| {
                let mut out = confidences.clone();
                let confidences = out.iter_mut().map(Vec::as_mut_slice).collect();
                vectorised(set, Band { flows: &flows, confidences, region, config: &config })?;
                Some(out)
            };
            let expected = score(0).unwrap();
            assert!(expected.iter().flatten().all(|c| (0.0..=0.75).contains(c)));
            assert!(expected[0].iter().any(|c| *c < 0.1) && expected[0].contains(&0.75));
            assert!((1..3).filter_map(score).all(|other| other == expected), "{config:?}");
        }
    }
}
