//! Random omission of Gaussians during training with few cameras (DropGaussian).

/// A random part of the Gaussians is left out, and the others' opacities are raised so that the expectation stays: training
/// so keeps views that few photographs show from being explained by Gaussians that only one of them needs (Park et al.,
/// "DropGaussian: Structural Regularization for Sparse-view Gaussian Splatting", CVPR 2025).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dropout {
    /// Share that is left out (0 to below 1).
    pub share: f32,
    /// Number of the draw: with another, others are left out.
    pub draw: u32,
}

impl Dropout {
    /// Hashes below this are left out.
    pub fn threshold(self) -> u32 {
        (f64::from(self.share) * 2f64.powi(32)) as u32
    }

    /// Factor of the opacities of those that are kept.
    pub fn gain(self) -> f32 {
        1.0 / (1.0 - self.share)
    }

    /// Factor of the opacity of Gaussian `index`: 0 where it is left out. The product is at most 1.
    #[inline(always)]
    pub(crate) fn factor(self, index: usize) -> f32 {
        let left_out = hash((index as u32).wrapping_add(hash(self.draw))) < self.threshold();
        if left_out { 0.0 } else { self.gain() }
    }
}

/// PCG-RXS-M-XS (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 2020); `hash` of `ewa.wgsl`.
#[inline(always)]
fn hash(value: u32) -> u32 {
    let state = value.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_expectation_of_the_factor_is_one() {
        let n = 100_000;
        for share in [0.0, 0.1, 0.4] {
            for draw in [0, 1, 77] {
                let sum: f64 = (0..n).map(|i| f64::from(Dropout { share, draw }.factor(i))).sum();
                assert!((sum / f64::from(n as u32) - 1.0).abs() < 0.01, "{share}, draw {draw}");
            }
        }
    }

    #[test]
    fn draws_differ_independently() {
        let out = |i, draw| Dropout { share: 0.5, draw }.factor(i) == 0.0;
        let same = (0..100_000).filter(|&i| out(i, 3) == out(i, 4)).count();
        assert!((49_000..51_000).contains(&same), "{same}");
    }
}
