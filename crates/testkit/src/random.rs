//! Normal random numbers for tests.

use glam::DVec3;
use rand::Rng;

/// A standard normal sample (Box and Muller).
pub fn normal(rng: &mut impl Rng) -> f64 {
    let (u, v): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Three of them.
pub fn normal3(rng: &mut impl Rng) -> DVec3 {
    DVec3::new(normal(rng), normal(rng), normal(rng))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// Mean 0, variance 1, kurtosis 3, within five standard errors of 40 000 samples.
    #[test]
    fn samples_have_the_moments_of_the_normal_distribution() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let samples: Vec<f64> = (0..40_000).map(|_| normal(&mut rng)).collect();
        let moment = |p: i32| samples.iter().map(|x| x.powi(p)).sum::<f64>() / samples.len() as f64;
        let error = |variance: f64| 5.0 * (variance / samples.len() as f64).sqrt();
        assert!(moment(1).abs() < error(1.0));
        assert!((moment(2) - 1.0).abs() < error(2.0));
        assert!((moment(4) - 3.0).abs() < error(96.0));
    }
}
