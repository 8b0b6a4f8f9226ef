//! How much the errors of two trackers have in common.

use crate::evidence::{Evidence, TrackerEstimate};
use crate::prior::Prior;
use glam::DVec3;
use rayon::prelude::*;

/// Largest normalised error that counts; outliers say nothing of the correlation.
const CLIP: f64 = 3.0;

/// Gaussians that one thread adds up.
const CHUNK: usize = 4096;

/// Mean product of two trackers' normalised errors about the priors.
pub(crate) fn correlation(evidence: &Evidence, priors: &[Option<Prior>], scales: &[Vec<f64>]) -> f64 {
    let of_chunk = |(chunk, priors): (usize, &[Option<Prior>])| {
        let mut sums = Products::default();
        let mut errors = Vec::new();
        for (k, prior) in priors.iter().enumerate() {
            let Some(prior) = prior else { continue };
            let error = |(l, told): (usize, &TrackerEstimate)| {
                let variance = 3.0 * scales[prior.scales][l] / told.information.trace();
                ((told.mean - prior.mean) * variance.sqrt().recip()).clamp_length_max(CLIP)
            };
            errors.clear();
            errors.extend(evidence.of(chunk * CHUNK + k).map(error));
            sums.add(&errors);
        }
        sums
    };
    let chunks: Vec<Products> = priors.par_chunks(CHUNK).enumerate().map(of_chunk).collect();
    chunks.into_iter().fold(Products::default(), Products::merged).correlation()
}

/// Sums over the errors of Gaussians.
#[derive(Clone, Copy, Default)]
struct Products {
    squares: f64,
    count: f64,
    /// Of two trackers' errors.
    of_pairs: f64,
    pairs: f64,
}

impl Products {
    /// The errors of one Gaussian's trackers.
    fn add(&mut self, errors: &[DVec3]) {
        for (a, left) in errors.iter().enumerate() {
            self.squares += left.length_squared();
            self.count += 1.0;
            self.of_pairs += errors[..a].iter().map(|right| left.dot(*right)).sum::<f64>();
            self.pairs += a as f64;
        }
    }

    fn merged(self, other: Self) -> Self {
        Self {
            squares: self.squares + other.squares,
            count: self.count + other.count,
            of_pairs: self.of_pairs + other.of_pairs,
            pairs: self.pairs + other.pairs,
        }
    }

    fn correlation(self) -> f64 {
        let Self { squares, count, of_pairs, pairs } = self;
        if pairs > 0.0 && squares > 0.0 {
            (of_pairs / pairs / (squares / count)).clamp(0.0, 0.95)
        } else {
            0.0
        }
    }
}
