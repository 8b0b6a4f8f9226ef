//! Density as Markov chain Monte Carlo (Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo").
//!
//! Nothing is split or pruned by thresholds. Transparent Gaussians are relocated onto others, drawn in proportion to
//! opacity, so that the image stays what it was; the set grows in the same way up to a hard cap; noise lets faint
//! Gaussians wander to where they are needed, and regularisers of opacity and scale make those that are not needed faint.

use crate::densify::IndexMap;
use ffgs_core::{Gaussians, logit, sigmoid};
use glam::{Mat3, Quat, Vec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Opacity below which a Gaussian is dead; the centre of the noise's switch as well.
const DEAD: f32 = 0.005;
/// A round adds one in so many: 5 %.
const GROWTH: usize = 20;
/// Most Gaussians that one is divided into in a round.
const MOST_SHARES: usize = 51;
/// Opacities are kept below 1 where their logit is taken.
const MOST_OPACITY: f64 = 1.0 - 1e-6;
/// Steepness of the noise's switch.
const NOISE_STEEPNESS: f32 = 100.0;
/// Noise per position rate; the rate is in scene units.
const NOISE: f32 = 5e5;
/// Weights of mean opacity and mean standard deviation in the loss.
const REGULARISER: f32 = 0.01;
/// Radius of the cameras in the paper's scenes: noise and scale regulariser have a unit, taken as the extent by this.
const PAPER_EXTENT: f32 = 5.0;

/// One round: the dead are removed, and as many copies of living ones made, and 5 % more up to `cap`. `seed` fixes which. The caller passes the
/// map on to `Adam::remap`: Gaussians that were divided start with new moments.
pub(crate) fn relocate(gaussians: &mut Gaussians, cap: usize, seed: u64) -> IndexMap {
    let opacity = |i: usize| f64::from(sigmoid(gaussians.opacity_logits[i]));
    let n = gaussians.len();
    let living: Vec<usize> = (0..n).filter(|&i| opacity(i) >= f64::from(DEAD)).collect();
    if living.is_empty() {
        return IndexMap::identity(n);
    }
    let target = (n + n / GROWTH).min(cap).max(living.len());
    let mut shares = vec![0_usize; n];
    living.iter().for_each(|&i| shares[i] = 1);
    draw(&living, opacity, target - living.len(), seed).for_each(|i| shares[i] += 1);
    let (whole, divided): (Vec<usize>, Vec<usize>) = living.iter().partition(|&&i| shares[i] == 1);
    let copies = divided.iter().flat_map(|&i| std::iter::repeat_n(i, shares[i]));
    let sources: Vec<usize> = whole.iter().copied().chain(copies).collect();
    *gaussians = gaussians.select(&sources);
    for (k, &source) in sources.iter().enumerate().skip(whole.len()) {
        divide(gaussians, k, shares[source]);
    }
    let keeps_moments = (0..sources.len()).map(|k| k < whole.len()).collect();
    IndexMap { sources, keeps_moments }
}

/// `count` of the `living` in proportion to their opacity, with replacement.
fn draw(
    living: &[usize],
    opacity: impl Fn(usize) -> f64,
    count: usize,
    seed: u64,
) -> impl Iterator<Item = usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut sum = 0.0;
    let up_to = |&i: &usize| {
        sum += opacity(i);
        sum
    };
    let sums: Vec<f64> = living.iter().map(up_to).collect();
    (0..count).map(move |_| {
        let at = rng.random::<f64>() * sum;
        living[sums.partition_point(|&s| s <= at).min(living.len() - 1)]
    })
}

/// Gives Gaussian `i` the opacity and scale with which `shares` of it look like one.
fn divide(gaussians: &mut Gaussians, i: usize, shares: usize) {
    let whole = f64::from(sigmoid(gaussians.opacity_logits[i]));
    let (part, shrink) = share_of(whole.min(MOST_OPACITY), shares);
    gaussians.opacity_logits[i] = logit(part.max(f64::from(DEAD)) as f32);
    gaussians.log_scales[i] = gaussians.log_scales[i].map(|s| s + (shrink as f32).ln());
}

/// Opacity of each of `shares` Gaussians in one place that together have opacity `whole` at the centre, and the factor of
/// their scale that keeps the integral of the opacity along a line (equation 9 of the paper).
fn share_of(whole: f64, shares: usize) -> (f64, f64) {
    let shares = shares.min(MOST_SHARES);
    let part = 1.0 - (1.0 - whole).powf(1.0 / shares as f64);
    let mut sum = 0.0;
    for i in 0..shares {
        let mut term = part;
        for k in 0..=i {
            sum += term / ((k + 1) as f64).sqrt();
            // The next term of binomial(i, k) (-1)^k part^(k + 1).
            term *= -part * (i - k) as f64 / (k + 1) as f64;
        }
    }
    (part, whole / sum)
}

/// Adds the derivatives of 0.01 mean(opacity) + 0.01 mean(standard deviation) to those of the Gaussians in view.
pub(crate) fn regularise(gaussians: &Gaussians, touched: &[bool], extent: f32, gradient: &mut Gaussians) {
    let weight = REGULARISER / gaussians.len() as f32;
    for i in (0..gaussians.len()).filter(|&i| touched[i]) {
        let opacity = sigmoid(gaussians.opacity_logits[i]);
        gradient.opacity_logits[i] += weight * opacity * (1.0 - opacity);
        for (gradient, scale) in gradient.log_scales[i].iter_mut().zip(gaussians.log_scales[i]) {
            *gradient += weight / 3.0 * (PAPER_EXTENT / extent) * scale.exp();
        }
    }
}

/// Moves faint Gaussians at random, by normal noise times covariance; `rate` is the position rate as a share of `extent` (m).
/// The noise of a Gaussian depends on `seed` (other in every step) and its index only.
pub(crate) fn wander(gaussians: &mut Gaussians, rate: f32, extent: f32, seed: u64) {
    let strength = NOISE * rate * PAPER_EXTENT * PAPER_EXTENT / extent;
    let Gaussians { means, quats, log_scales, opacity_logits, .. } = gaussians;
    means.par_iter_mut().enumerate().for_each(|(i, mean)| {
        let switch = sigmoid(-NOISE_STEEPNESS * (sigmoid(opacity_logits[i]) - DEAD));
        if switch > f32::EPSILON {
            let noise = covariance(quats[i], log_scales[i]) * normal3(seed, i);
            *mean = (Vec3::from(*mean) + strength * switch * noise).to_array();
        }
    });
}

/// Covariance of the splat (m^2).
fn covariance([w, x, y, z]: [f32; 4], log_scales: [f32; 3]) -> Mat3 {
    let rotation = Quat::from_xyzw(x, y, z, w);
    let rotation =
        Mat3::from_quat(if rotation.length_squared() > 0.0 { rotation.normalize() } else { Quat::IDENTITY });
    rotation * Mat3::from_diagonal((2.0 * Vec3::from(log_scales)).exp()) * rotation.transpose()
}

/// Three standard normal samples (Box-Muller) of the counter `i`.
fn normal3(seed: u64, i: usize) -> Vec3 {
    let uniform = |k: u64| (mix(seed ^ mix(4 * i as u64 + k)) >> 40) as f32 / (1 << 24) as f32;
    let polar = |k: u64| {
        // 1 - u lies in (0, 1], so that the logarithm is finite.
        let radius = (-2.0 * (1.0 - uniform(k)).ln()).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * uniform(k + 1)).sin_cos();
        (radius * cos, radius * sin)
    };
    let ((x, y), (z, _)) = (polar(0), polar(2));
    Vec3::new(x, y, z)
}

/// The finaliser of SplitMix64 (Steele et al. 2014).
pub(crate) fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gaussians of different opacity along x, 0.1 m in size.
    fn scene(opacities: &[f32]) -> Gaussians {
        let mut g = Gaussians::zeros(opacities.len(), 0);
        g.quats.fill([1.0, 0.0, 0.0, 0.0]);
        g.log_scales.fill([0.1_f32.ln(); 3]);
        g.means.iter_mut().enumerate().for_each(|(i, m)| m[0] = i as f32);
        g.opacity_logits = opacities.iter().map(|&o| logit(o)).collect();
        g
    }

    /// Integral over a line of the opacity of `shares` equal Gaussians in one place, by the trapezium rule.
    fn line_integral(opacity: f64, sigma: f64, shares: i32) -> f64 {
        let at = |x: f64| 1.0 - (1.0 - opacity * (-0.5 * (x / sigma).powi(2)).exp()).powi(shares);
        (-8000..=8000).map(|i| at(f64::from(i) * 1e-3) * 1e-3).sum()
    }

    #[test]
    fn shares_keep_centre_and_integral() {
        for whole in [0.01, 0.3, 0.9, 0.999] {
            for shares in [1, 2, 5, 51] {
                let (part, shrink) = share_of(whole, shares);
                assert!((1.0 - (1.0 - part).powi(shares as i32) - whole).abs() < 1e-12);
                let (one, many) = (line_integral(whole, 1.0, 1), line_integral(part, shrink, shares as i32));
                assert!((one - many).abs() < 1e-6 * one, "{whole} in {shares}: {one} became {many}");
            }
        }
        assert_eq!(share_of(0.9, 60), share_of(0.9, 51));
    }

    #[test]
    fn the_dead_move_onto_the_living_in_proportion_to_opacity() {
        let mut opacities = vec![0.001; 10_000];
        opacities[7] = 0.2;
        opacities[8] = 0.6;
        let mut g = scene(&opacities);
        let map = relocate(&mut g, 10_000, 3);
        assert_eq!((g.len(), map.len(), map.kept()), (10_000, 10_000, 0));
        let on_8 = map.sources.iter().filter(|&&i| i == 8).count();
        assert!((on_8 as f64 / 10_000.0 - 0.75).abs() < 0.02, "{on_8} of 10000");
        assert!(g.means.iter().zip(&map.sources).all(|(m, &s)| m[0] == s as f32));
        assert!(g.opacity_logits.iter().all(|&o| sigmoid(o) > 0.999 * DEAD));
    }

    #[test]
    fn growth_is_a_twentieth_and_ends_at_the_cap() {
        let mut g = scene(&[0.5; 200]);
        let map = relocate(&mut g, 1000, 3);
        assert_eq!((g.len(), map.sources.len()), (210, 210));
        assert!(map.kept() >= 190 && map.kept() < 200);
        relocate(&mut g, 215, 3);
        assert_eq!(g.len(), 215);
        relocate(&mut g, 100, 3);
        assert_eq!(g.len(), 215, "the living are never removed");
        let before = g.clone();
        g.opacity_logits.fill(logit(0.001));
        assert_eq!(relocate(&mut g, 1000, 3), IndexMap::identity(before.len()));
    }

    #[test]
    fn regularisers_are_the_derivatives_of_the_means() {
        let g = scene(&[0.3, 0.7]);
        let value = |g: &Gaussians| {
            let opacity: f32 = g.opacity_logits.iter().map(|&o| sigmoid(o)).sum();
            let scale: f32 = g.log_scales.as_flattened().iter().map(|s| s.exp()).sum();
            0.01 * (opacity / 2.0 + scale / 6.0)
        };
        let mut gradient = Gaussians::zeros(2, 0);
        regularise(&g, &[false, true], PAPER_EXTENT, &mut gradient);
        let mut moved = g.clone();
        moved.opacity_logits[1] += 0.01;
        let by_opacity = (value(&moved) - value(&g)) / 0.01;
        assert!((by_opacity - gradient.opacity_logits[1]).abs() < 1e-2 * by_opacity);
        moved = g.clone();
        moved.log_scales[1][2] += 0.01;
        let by_scale = (value(&moved) - value(&g)) / 0.01;
        assert!((by_scale - gradient.log_scales[1][2]).abs() < 1e-2 * by_scale);
        assert_eq!((gradient.opacity_logits[0], gradient.log_scales[0]), (0.0, [0.0; 3]));
    }

    #[test]
    fn faint_gaussians_wander_within_their_shape_and_opaque_ones_stay() {
        let n = 20_000;
        let mut g = scene(&vec![DEAD; n]);
        g.opacity_logits[0] = logit(0.5);
        g.log_scales.fill([0.1_f32.ln(), 0.2_f32.ln(), -20.0]);
        let before = g.clone();
        wander(&mut g, 1.0 / NOISE, 25.0, 11);
        assert_eq!(g.means[0], before.means[0]);
        let moves =
            || g.means.iter().zip(&before.means).skip(1).map(|(a, b)| Vec3::from(*a) - Vec3::from(*b));
        let mean = moves().sum::<Vec3>() / n as f32;
        let deviation = (moves().map(|m| m * m).sum::<Vec3>() / n as f32).map(f32::sqrt);
        // Half of the covariance at the switch's centre.
        assert!((deviation - Vec3::new(0.005, 0.02, 0.0)).length() < 5e-4, "{deviation}");
        assert!(mean.length() < 5e-4, "{mean}");
        let mut again = before.clone();
        wander(&mut again, 1.0 / NOISE, 25.0, 11);
        assert_eq!(again.means, g.means);
        wander(&mut again, 1.0 / NOISE, 25.0, 12);
        assert_ne!(again.means, g.means);
    }
}
