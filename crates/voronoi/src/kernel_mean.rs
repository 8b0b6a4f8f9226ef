//! The inner loop of [`crate::GaussianKnn`].

use crate::exponential::exp_negative;
use crate::nearest::{Candidate, Keys, LANES, SLOTS};
use pulp::{Simd, WithSimd};

/// What is averaged, the number 1 last: its sum is that of the weights.
pub(crate) type Values = [f64; 4];

/// Means over the K nearest of the candidates, weighted by `exp(-(d^2 - d_1^2) half_precision)`, and the confidence
/// `exp(-d_1^2 half_precision)`. Weights are relative to the nearest, whose own weight is then 1: the sum can neither
/// underflow nor be 0 / 0 however far the tracks are.
pub(crate) struct KernelMean<'a> {
    /// Places of the pixels (normalised), whole vectors of them.
    pub x: &'a [f64],
    pub y: &'a [f64],
    /// At least K; of equally distant ones the first tracks count.
    pub candidates: &'a [Candidate],
    /// (N) values of all tracks.
    pub values: &'a [Values],
    pub keys: Keys,
    pub k: usize,
    pub half_precision: f64,
    /// One for each pixel; may be fewer than places.
    pub out: &'a mut [Mean],
}

/// What [`KernelMean`] finds of a pixel.
#[derive(Clone, Copy, Default)]
pub(crate) struct Mean {
    pub values: [f64; 3],
    pub confidence: f64,
}

impl WithSimd for KernelMean<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let out = std::mem::take(&mut self.out);
        let places = S::as_simd_f64s(self.x).0.iter().zip(S::as_simd_f64s(self.y).0);
        for ((&x, &y), out) in places.zip(out.chunks_mut(S::F64_LANES)) {
            self.vector(simd, [x, y], out);
        }
    }
}

impl KernelMean<'_> {
    /// The pixels of one vector.
    #[inline(always)]
    fn vector<S: Simd>(&self, simd: S, place: [S::f64s; 2], out: &mut [Mean]) {
        let mut sums = [[0.0; 4]; LANES];
        let (mut first, mut after) = (simd.splat_f64s(0.0), simd.splat_f64s(-1.0));
        let mut confidence = [0.0; LANES];
        for pass in (0..self.k).step_by(SLOTS) {
            let slots = self.keys.nearest(simd, place, self.candidates, after);
            after = slots[SLOTS - 1];
            if pass == 0 {
                first = self.keys.squared_distances(simd, slots[0]);
            }
            let (mut keys, mut weights) = ([[0.0; LANES]; SLOTS], [[0.0; LANES]; SLOTS + 1]);
            for slot in 0..SLOTS {
                let d2 = self.keys.squared_distances(simd, slots[slot]);
                put::<S>(&mut keys[slot], slots[slot]);
                put::<S>(&mut weights[slot], simd.sub_f64s(d2, first));
            }
            put::<S>(&mut weights[SLOTS], first);
            // One long loop over all, or the compiler would turn it inside out.
            for weight in weights.as_flattened_mut() {
                *weight = exp_negative(*weight * self.half_precision);
            }
            confidence = weights[SLOTS];
            let count = (self.k - pass).min(SLOTS);
            for (lane, sum) in sums[..out.len()].iter_mut().enumerate() {
                *sum = self.add(*sum, lane, &keys[..count], &weights[..count]);
            }
        }
        for ((out, [a, b, c, total]), confidence) in out.iter_mut().zip(sums).zip(confidence) {
            *out = Mean { values: [a / total, b / total, c / total], confidence };
        }
    }

    /// Adds the weighted values of a lane's neighbours.
    #[inline(always)]
    fn add(&self, mut sum: Values, lane: usize, keys: &[[f64; LANES]], weights: &[[f64; LANES]]) -> Values {
        for (keys, weights) in keys.iter().zip(weights) {
            let values = &self.values[self.keys.track(keys[lane])];
            for v in 0..4 {
                sum[v] += weights[lane] * values[v];
            }
        }
        sum
    }
}

/// One vector at the front of a row.
#[inline(always)]
fn put<S: Simd>(row: &mut [f64; LANES], vector: S::f64s) {
    S::as_mut_simd_f64s(row).0[0] = vector;
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::instructions;

    /// The mean of values 1, 2, 4, ... over the K nearest of some tracks, at the origin and far too narrow or wide a kernel.
    fn mean(points: &[[f64; 2]], k: usize, half_precision: f64) -> Mean {
        let candidate = |(track, &point): (usize, &[f64; 2])| Candidate { point, track: track as u32 };
        let candidates: Vec<Candidate> = points.iter().enumerate().rev().map(candidate).collect();
        let values: Vec<Values> = (0..points.len()).map(|t| [(1_u64 << t) as f64, 0.0, 0.0, 1.0]).collect();
        let mut out = [Mean::default(); 3];
        instructions().dispatch(KernelMean {
            x: &[0.0; LANES],
            y: &[0.0; LANES],
            candidates: &candidates,
            values: &values,
            keys: Keys::new(points.len()),
            k,
            half_precision,
            out: &mut out,
        });
        assert!(out.iter().all(|m| m.values == out[0].values));
        out[0]
    }

    #[test]
    fn ties_at_the_last_neighbour_go_to_the_first_tracks() {
        let points = [[0.1, 0.0], [-0.1, 0.0], [0.0, 0.1], [0.0, -0.1]];
        assert_eq!(mean(&points, 2, 1.0).values[0], 1.5);
        assert_eq!(mean(&[[0.0; 2]; 30], 2, 1.0).values[0], 1.5);
    }

    #[test]
    fn more_neighbours_than_one_pass_finds() {
        // The nearest 20 of 30 have the values 2^10 to 2^29 and, under so wide a kernel, equal weights.
        let points: Vec<[f64; 2]> = (0..30).map(|t| [0.0, f64::from(30 - t)]).collect();
        let expected = f64::from((1 << 30) - (1 << 10)) / 20.0;
        assert!((mean(&points, 20, 1e-16).values[0] / expected - 1.0).abs() < 1e-9);
    }
}
