//! The inner loop of [`crate::GaussianKnn`]: the pixels of a tile side by side. Plain loops over a fixed number of pixels,
//! long enough that the compiler turns them into vectors of the dispatched instruction set rather than unrolling them.

use pulp::{Simd, WithSimd};

/// Pixels at once: a tile of 8 x 8.
pub const LANES: usize = 64;
/// Pixels are worked on in steps of so many: one AVX-512 register of f64.
const STEP: usize = 8;

/// One value of each pixel.
pub type Column = [f64; LANES];

/// A track: where it begins (normalised) and what is averaged.
#[derive(Clone, Copy)]
pub struct Candidate {
    pub point: [f64; 2],
    pub values: [f64; 3],
}

/// Means over the K nearest of the candidates, weighted by `exp(-(d^2 - d_1^2) half_precision)`, and the confidence
/// `exp(-d_1^2 half_precision)`. Weights are relative to the nearest, whose own weight is then 1: the sum can neither
/// underflow nor be 0 / 0 however far the tracks are.
pub struct KernelMean<'a> {
    /// Places of the pixels (normalised).
    pub x: &'a Column,
    pub y: &'a Column,
    /// How many of them count.
    pub pixels: usize,
    /// At least K; of equally distant ones the first count.
    pub candidates: &'a [Candidate],
    pub half_precision: f64,
    /// (K) scratch.
    pub nearest: &'a mut [Column],
}

/// What [`KernelMean`] finds.
pub struct Means {
    pub values: [Column; 3],
    pub confidence: Column,
}

impl WithSimd for KernelMean<'_> {
    type Output = Means;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Means {
        let Self { x, y, pixels, candidates, half_precision, nearest } = self;
        let n = pixels.next_multiple_of(STEP).min(LANES);
        let (x, y) = (&x[..n], &y[..n]);
        sort_nearest(x, y, candidates, nearest);
        let (first, last) = (nearest[0], nearest[nearest.len() - 1]);
        // How many of those at the distance of the K-th still count.
        let mut ties = [0.0; LANES];
        for slot in nearest.iter() {
            for k in 0..n {
                ties[k] += if slot[k] < last[k] { 0.0 } else { 1.0 };
            }
        }
        let (mut sums, mut total) = ([[0.0; LANES]; 3], [0.0; LANES]);
        for candidate in candidates {
            let ([px, py], [a, b, c]) = (candidate.point, candidate.values);
            let [sum_a, sum_b, sum_c] = &mut sums;
            for k in 0..n {
                let d2 = squared_distance(x[k] - px, y[k] - py);
                let tie = if d2 == last[k] { 1.0 } else { 0.0 };
                let open = if ties[k] > 0.0 { tie } else { 0.0 };
                let counts = if d2 < last[k] { 1.0 } else { open };
                ties[k] -= tie;
                let weight = counts * exp_negative((d2 - first[k]).max(0.0) * half_precision);
                total[k] += weight;
                sum_a[k] += weight * a;
                sum_b[k] += weight * b;
                sum_c[k] += weight * c;
            }
        }
        let mut confidence = [0.0; LANES];
        for k in 0..n {
            for sum in &mut sums {
                sum[k] /= total[k];
            }
            confidence[k] = exp_negative(first[k] * half_precision);
        }
        Means { values: sums, confidence }
    }
}

/// The K least squared distances of each pixel, ascending.
#[inline(always)]
fn sort_nearest(x: &[f64], y: &[f64], candidates: &[Candidate], nearest: &mut [Column]) {
    nearest.fill([f64::INFINITY; LANES]);
    let mut distances = [0.0; LANES];
    for candidate in candidates {
        let [px, py] = candidate.point;
        let d2 = &mut distances[..x.len()];
        for k in 0..x.len() {
            d2[k] = squared_distance(x[k] - px, y[k] - py);
        }
        for slot in nearest.iter_mut() {
            for (d, s) in d2.iter_mut().zip(slot) {
                let (low, high) = if *d < *s { (*d, *s) } else { (*s, *d) };
                *s = low;
                *d = high;
            }
        }
    }
}

#[inline(always)]
fn squared_distance(dx: f64, dy: f64) -> f64 {
    dx * dx + dy * dy
}

/// `exp(-x)` for `x >= 0`, relative error below 1e-11; 0 beyond the normal numbers. No call, so that it runs in lanes.
#[inline(always)]
fn exp_negative(x: f64) -> f64 {
    /// Adding this rounds to a whole number, which is then in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const INVERSE_FACTORIALS: [f64; 10] = [
        1.0,
        1.0,
        1.0 / 2.0,
        1.0 / 6.0,
        1.0 / 24.0,
        1.0 / 120.0,
        1.0 / 720.0,
        1.0 / 5040.0,
        1.0 / 40320.0,
        1.0 / 362_880.0,
    ];
    let octaves = if x < 700.0 { x } else { 700.0 } * -std::f64::consts::LOG2_E;
    let rounded = octaves + ROUND;
    let rest = (octaves - (rounded - ROUND)) * std::f64::consts::LN_2;
    let mut power = INVERSE_FACTORIALS[9];
    for i in (0..9).rev() {
        power = power * rest + INVERSE_FACTORIALS[i];
    }
    let scale = f64::from_bits((rounded.to_bits() << 52).wrapping_add(1023 << 52));
    if x < 700.0 { power * scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_accurate_and_ends_at_zero() {
        for i in 0..70_000 {
            let x = f64::from(i) * 0.01;
            let exact = (-x).exp();
            assert!((exp_negative(x) - exact).abs() <= 2e-11 * exact, "exp(-{x})");
        }
        assert_eq!(exp_negative(0.0), 1.0);
        assert_eq!(exp_negative(1e300), 0.0);
    }

    #[test]
    fn ties_at_the_last_neighbour_go_to_the_first_tracks() {
        // Four tracks at one distance of the pixel at 0; two count.
        let track = |point, value| Candidate { point, values: [value, 0.0, 0.0] };
        let candidates = [
            track([0.1, 0.0], 1.0),
            track([-0.1, 0.0], 2.0),
            track([0.0, 0.1], 30.0),
            track([0.0, -0.1], 40.0),
        ];
        let mut nearest = [[0.0; LANES]; 2];
        let mean = KernelMean {
            x: &[0.0; LANES],
            y: &[0.0; LANES],
            pixels: 3,
            candidates: &candidates,
            half_precision: 1.0,
            nearest: &mut nearest,
        };
        assert_eq!(pulp::Arch::new().dispatch(mean).values[0][..3], [1.5; 3]);
    }
}
