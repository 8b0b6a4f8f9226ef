//! Step sizes, and how they fall over a training.

/// Step sizes per column of a Gaussian set; 0 freezes a column.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LearningRates {
    /// Positions (m).
    pub means: f32,
    /// Quaternions.
    pub quats: f32,
    /// Log scales.
    pub scales: f32,
    /// Opacity logits.
    pub opacities: f32,
    /// SH coefficient 0.
    pub sh0: f32,
    /// SH coefficients of degree 1 and above.
    pub sh_rest: f32,
}

impl LearningRates {
    /// 3DGS defaults with the given position rate (m), usually a schedule times the scene's extent.
    pub const fn with_means(means: f32) -> Self {
        Self { means, quats: 1e-3, scales: 5e-3, opacities: 5e-2, sh0: 2.5e-3, sh_rest: 1.25e-4 }
    }

    /// All of them times `factor`.
    #[must_use]
    pub fn scaled(self, factor: f32) -> Self {
        let Self { means, quats, scales, opacities, sh0, sh_rest } = self;
        let [means, quats, scales, opacities, sh0, sh_rest] =
            [means, quats, scales, opacities, sh0, sh_rest].map(|rate| rate * factor);
        Self { means, quats, scales, opacities, sh0, sh_rest }
    }
}

/// Log-linear interpolation from `start` to `end`.
pub fn decay(start: f32, end: f32, iteration: usize, iterations: usize) -> f32 {
    let t = iteration as f32 / iterations.max(1) as f32;
    (start.ln() * (1.0 - t) + end.ln() * t).exp()
}

/// Factor on the rates of the step after `iteration` ones, of `iterations`: 1, and over the last `share` of the steps it falls linearly to 0.
pub(crate) fn cool_down(share: f32, iteration: usize, iterations: usize) -> f32 {
    let left = 1.0 - (iteration as f32 + 0.5) / iterations.max(1) as f32;
    if left < share { left / share } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_cool_down_over_the_last_steps_only() {
        let factors = |share: f32| [0, 49, 50, 74, 99].map(|iteration| cool_down(share, iteration, 100));
        assert_eq!(factors(0.0), [1.0; 5]);
        let expected = [1.0, 1.0, 0.99, 0.51, 0.01];
        for (factor, expected) in factors(0.5).into_iter().zip(expected) {
            assert!((factor - expected).abs() < 1e-5, "{factor} instead of {expected}");
        }
        let all = factors(1.0);
        assert!(all.is_sorted_by(|a, b| a > b) && all.iter().all(|&factor| factor > 0.0), "{all:?}");
    }

    #[test]
    fn a_factor_is_on_every_rate() {
        let rates = LearningRates::with_means(2.0);
        let half = rates.scaled(0.5);
        let columns = |r: LearningRates| [r.means, r.quats, r.scales, r.opacities, r.sh0, r.sh_rest];
        for (half, whole) in columns(half).into_iter().zip(columns(rates)) {
            assert!(half > 0.0 && half == 0.5 * whole, "{half} and {whole}");
        }
    }
}
