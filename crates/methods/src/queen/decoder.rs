//! Linear decoders: small integers per Gaussian to the residual of an attribute.

use ffgs_trainer::normal;
use nalgebra::{DMatrix, DVector};
use rand::Rng;
use rayon::prelude::*;

/// Rows summed by one task.
const CHUNK: usize = 4096;

/// How an attribute is coded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shape {
    /// Values of the attribute.
    pub width: usize,
    /// Latents that stand for them.
    pub latents: usize,
    /// Standard deviation of the matrix before training.
    pub deviation: f32,
    /// Whether all latents have one weight (the official DFT matrix, which has a single column of ones here, times a scale).
    pub shared: bool,
}

/// A matrix (latents, width), or one row where it is shared, and behind it a shift (width).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decoder {
    pub shape: Shape,
    pub weights: Vec<f32>,
}

impl Decoder {
    pub(super) fn new(shape: Shape, rng: &mut impl Rng) -> Self {
        let mut out = Self { shape, weights: vec![0.0; Self::count(shape)] };
        let matrix = out.weights.len() - shape.width;
        out.weights[..matrix].iter_mut().for_each(|weight| *weight = shape.deviation * normal(rng));
        out
    }

    /// Number of its weights.
    pub(super) fn count(shape: Shape) -> usize {
        shape.width * (1 + if shape.shared { 1 } else { shape.latents })
    }

    fn index(&self, latent: usize, value: usize) -> usize {
        if self.shape.shared { value } else { latent * self.shape.width + value }
    }

    /// Writes the residual of one Gaussian into `out` (width). Latents are rounded.
    pub(super) fn decode(&self, latents: &[f32], out: &mut [f32]) {
        let width = self.shape.width;
        out.copy_from_slice(&self.weights[self.weights.len() - width..]);
        for (l, latent) in latents.iter().enumerate() {
            let whole = latent.round_ties_even();
            for (c, out) in out.iter_mut().enumerate() {
                *out += whole * self.weights[self.index(l, c)];
            }
        }
    }

    /// Derivatives by `latents` (N, latents), through the rounding as if there were none, and by the weights, given those by the
    /// residuals (N, width).
    pub(super) fn backward(&self, latents: &[f32], by: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let Shape { width, latents: count, .. } = self.shape;
        let by_latent = |i: usize| {
            let row = &by[i / count * width..][..width];
            row.iter().enumerate().map(|(c, by)| by * self.weights[self.index(i % count, c)]).sum::<f32>()
        };
        let by_latents = (0..latents.len()).into_par_iter().map(by_latent).collect();
        let chunks = latents.par_chunks(CHUNK * count).zip(by.par_chunks(CHUNK * width));
        let sums: Vec<Vec<f64>> = chunks.map(|(latents, by)| self.by_weights(latents, by)).collect();
        let mut total = vec![0.0; self.weights.len()];
        sums.iter().for_each(|sum| total.iter_mut().zip(sum).for_each(|(total, sum)| *total += sum));
        (by_latents, total.into_iter().map(|sum| sum as f32).collect())
    }

    fn by_weights(&self, latents: &[f32], by: &[f32]) -> Vec<f64> {
        let Shape { width, latents: count, .. } = self.shape;
        let mut sum = vec![0.0; self.weights.len()];
        let shift = sum.len() - width;
        for (latents, by) in latents.chunks(count).zip(by.chunks(width)) {
            for (c, by) in by.iter().enumerate() {
                sum[shift + c] += f64::from(*by);
                for (l, latent) in latents.iter().enumerate() {
                    sum[self.index(l, c)] += f64::from(latent.round_ties_even() * by);
                }
            }
        }
        sum
    }

    /// The shortest latents that decode to `residual` (width), were they not rounded.
    pub(super) fn invert(&self, residual: &[f32]) -> Vec<f32> {
        let Shape { width, latents, .. } = self.shape;
        let shift = &self.weights[self.weights.len() - width..];
        let matrix = DMatrix::from_fn(width, latents, |c, l| f64::from(self.weights[self.index(l, c)]));
        let wanted = DVector::from_fn(width, |c, _| f64::from(residual[c] - shift[c]));
        // A matrix without any weight reaches nothing: zero.
        let solved = matrix.svd(true, true).solve(&wanted, 1e-12);
        solved.map_or_else(|_| vec![0.0; latents], |solved| solved.iter().map(|v| *v as f32).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::waves;
    use ffgs_testkit::largest_difference;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    const SHAPES: [Shape; 2] = [
        Shape { width: 3, latents: 8, deviation: 0.5, shared: false },
        Shape { width: 1, latents: 3, deviation: 0.5, shared: true },
    ];
    const ROWS: usize = 6000;

    fn case(shape: Shape) -> (Decoder, Vec<f32>, Vec<f32>) {
        let decoder = Decoder::new(shape, &mut ChaCha8Rng::seed_from_u64(3));
        let (mut latents, mut by) = (vec![0.0; ROWS * shape.latents], vec![0.0; ROWS * shape.width]);
        waves(&mut latents, 0.3);
        latents.iter_mut().for_each(|latent| *latent = (4.0 * *latent).round());
        waves(&mut by, 1.1);
        (decoder, latents, by)
    }

    /// The linear function of the residuals whose derivatives by them are `by`.
    fn value(decoder: &Decoder, latents: &[f32], by: &[f32]) -> f64 {
        let Shape { width, latents: count, .. } = decoder.shape;
        let mut out = vec![0.0; width];
        let rows = latents.chunks(count).zip(by.chunks(width));
        let row = |(latents, by): (&[f32], &[f32])| {
            decoder.decode(latents, &mut out);
            out.iter().zip(by).map(|(out, by)| f64::from(*out) * f64::from(*by)).sum::<f64>()
        };
        rows.map(row).sum()
    }

    /// Latents are moved by whole numbers, which the rounding leaves as they are.
    #[test]
    fn derivatives_are_those_of_differences() {
        for shape in SHAPES {
            let (decoder, latents, by) = case(shape);
            let (by_latents, by_weights) = decoder.backward(&latents, &by);
            let difference = |change: &dyn Fn(f32) -> (Decoder, Vec<f32>)| {
                let [ahead, behind] = [1.0, -1.0].map(|step| {
                    let (decoder, latents) = change(step);
                    value(&decoder, &latents, &by)
                });
                (ahead - behind) / 2.0
            };
            for k in 0..by_weights.len() {
                let numeric = difference(&|step| {
                    let mut decoder = decoder.clone();
                    decoder.weights[k] += step;
                    (decoder, latents.clone())
                });
                // Residuals are sums of f32 over thousands of rows.
                assert!((f64::from(by_weights[k]) - numeric).abs() < 2e-2, "{shape:?} {k}: {numeric}");
            }
            for k in [0, 1, 7, latents.len() - 1] {
                let numeric = difference(&|step| {
                    let mut latents = latents.clone();
                    latents[k] += step;
                    (decoder.clone(), latents)
                });
                assert!((f64::from(by_latents[k]) - numeric).abs() < 1e-4, "{shape:?} {k}: {numeric}");
            }
        }
    }

    #[test]
    fn latents_of_a_residual_decode_to_it() {
        for shape in SHAPES {
            let (mut decoder, _, mut by) = case(shape);
            // Fine weights, so that rounding is small.
            decoder.weights.iter_mut().for_each(|weight| *weight *= 1e-3);
            by.truncate(shape.width);
            let mut out = vec![0.0; shape.width];
            decoder.decode(&decoder.invert(&by), &mut out);
            assert!(largest_difference(&out, &by) < 3e-3, "{out:?} {by:?}");
        }
        let empty = Decoder { weights: vec![0.0; Decoder::count(SHAPES[0])], shape: SHAPES[0] };
        assert_eq!(empty.invert(&[1.0, 2.0, 3.0]), [0.0; 8]);
    }
}
