//! The prior of a frame: a quadratic penalty on the change of every parameter.
//!
//! Between two frames the information fades by a drift, `(1 / information + drift)^-1`, which is learnt from how far parameters
//! that the photographs see well moved (an extended Kalman filter whose process noise follows from its innovations).

use crate::gain::PixelNoise;
use crate::loss::SSIM_WEIGHT;
use crate::natural::{Curvature, Damping, turn_rows};
use ffgs_core::Gaussians;
use ffgs_rasterizer::{Gradients, Information};
use glam::{DVec3, Quat};
use rayon::prelude::*;

/// Parameters at most that a drift is learnt from, spread evenly over all.
const SAMPLES: usize = 1 << 14;
/// Fewer tell nothing.
const MIN_SAMPLES: usize = 64;
/// Median of the square of a standard normal variable.
const MEDIAN_SQUARE: f64 = 0.4549;

/// Variance that each kind of parameter gains from one frame to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// Turns about the body's axes (rad^2).
    pub turns: f64,
    /// Log scales.
    pub log_scales: f64,
    /// Opacity logits.
    pub opacities: f64,
    /// SH coefficient 0.
    pub sh0: f64,
    /// The other SH coefficients.
    pub sh_rest: f64,
}

/// Entries of the columns of one kind of parameter, flattened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Turns about the body's axes.
    Turns,
    /// Log scales.
    LogScales,
    /// Opacity logits.
    Opacities,
    /// SH coefficient 0.
    Sh0,
    /// The other SH coefficients.
    ShRest,
}

/// All kinds.
pub const KINDS: [Kind; 5] = [Kind::Turns, Kind::LogScales, Kind::Opacities, Kind::Sh0, Kind::ShRest];

impl Drift {
    /// From the values of [`KINDS`].
    pub fn from_array([turns, log_scales, opacities, sh0, sh_rest]: [f64; 5]) -> Self {
        Self { turns, log_scales, opacities, sh0, sh_rest }
    }

    /// The values of [`KINDS`].
    pub fn to_array(mut self) -> [f64; 5] {
        KINDS.map(|kind| *self.of(kind))
    }

    /// Of a kind.
    pub fn of(&mut self, kind: Kind) -> &mut f64 {
        match kind {
            Kind::Turns => &mut self.turns,
            Kind::LogScales => &mut self.log_scales,
            Kind::Opacities => &mut self.opacities,
            Kind::Sh0 => &mut self.sh0,
            Kind::ShRest => &mut self.sh_rest,
        }
    }

    /// What is left of `known` (diagonals, shaped like Gaussians) a frame later.
    pub fn fade(mut self, known: &Gaussians) -> Gaussians {
        let mut out = known.clone();
        for kind in KINDS {
            let drift = *self.of(kind) as f32;
            for_kind(&mut out, kind, |v| *v /= 1.0 + *v * drift);
        }
        out
    }

    /// The drift that explains how far well seen parameters went from `before` to `after`, when `known` was known before
    /// the drift and the frame's photographs told `told`; halfway from the present one, so that one odd frame does not rule,
    /// and never under `least`: what an optimiser could not reach in its steps looks as if it had not moved.
    pub fn learn(
        &mut self,
        least: Self,
        known: &Gaussians,
        told: &Gaussians,
        (before, after): (&Gaussians, &Gaussians),
    ) {
        let mut least = least;
        let change = change(before, after);
        for kind in KINDS {
            let samples = samples(kind, known, told, &change);
            if samples.len() >= MIN_SAMPLES {
                let found = explaining(&samples);
                let drift = self.of(kind);
                *drift = (*drift * found).sqrt().max(*least.of(kind));
            }
        }
    }
}

/// Calls `visit` for every value of a kind. The first value of a quaternion's row is no turn.
fn for_kind(g: &mut Gaussians, kind: Kind, mut visit: impl FnMut(&mut f32)) {
    let stride = g.sh_stride();
    match kind {
        Kind::Turns => g.quats.iter_mut().flat_map(|q| &mut q[1..]).for_each(visit),
        Kind::LogScales => g.log_scales.as_flattened_mut().iter_mut().for_each(visit),
        Kind::Opacities => g.opacity_logits.iter_mut().for_each(visit),
        Kind::Sh0 => g.sh.chunks_exact_mut(stride).flat_map(|sh| &mut sh[0]).for_each(visit),
        Kind::ShRest => {
            g.sh.chunks_exact_mut(stride)
                .for_each(|sh| sh[1..].as_flattened_mut().iter_mut().for_each(&mut visit));
        }
    }
}

fn values(g: &Gaussians, kind: Kind) -> Vec<f32> {
    let stride = g.sh_stride();
    match kind {
        Kind::Turns => g.quats.iter().flat_map(|q| q[1..].to_vec()).collect(),
        Kind::LogScales => g.log_scales.as_flattened().to_vec(),
        Kind::Opacities => g.opacity_logits.clone(),
        Kind::Sh0 => g.sh.chunks_exact(stride).flat_map(|sh| sh[0]).collect(),
        Kind::ShRest => g.sh.chunks_exact(stride).flat_map(|sh| sh[1..].as_flattened().to_vec()).collect(),
    }
}

/// Change of every parameter, shaped like the Gaussians; turns in the place of quaternions.
fn change(before: &Gaussians, after: &Gaussians) -> Gaussians {
    let mut out = after.clone();
    let pairs = out.quats.iter_mut().zip(&before.quats);
    pairs.for_each(|(q, start)| *q = turn_between(*start, *q));
    let minus = |a: &mut [f32], b: &[f32]| a.iter_mut().zip(b).for_each(|(a, b)| *a -= b);
    minus(out.log_scales.as_flattened_mut(), before.log_scales.as_flattened());
    minus(&mut out.opacity_logits, &before.opacity_logits);
    minus(out.sh.as_flattened_mut(), before.sh.as_flattened());
    out
}

/// (0, turn about the body's axes, rad), for small turns.
fn turn_between(start: [f32; 4], now: [f32; 4]) -> [f32; 4] {
    let of = |[w, x, y, z]: [f32; 4]| Quat::from_xyzw(x, y, z, w);
    let (start, now) = (of(start), of(now));
    let turn = start.conjugate() * now * (2.0 / start.length_squared().max(f32::MIN_POSITIVE));
    [0.0, turn.x, turn.y, turn.z]
}

/// One parameter: variance before the drift, variance of what the photographs say, squared change.
struct Sample {
    before: f64,
    told: f64,
    squared: f64,
}

/// Those that the frame tells more of than was known.
fn samples(kind: Kind, known: &Gaussians, told: &Gaussians, change: &Gaussians) -> Vec<Sample> {
    let (known, told, change) = (values(known, kind), values(told, kind), values(change, kind));
    let seen: Vec<usize> = (0..known.len()).filter(|&i| known[i] > 0.0 && told[i] > 0.0).collect();
    let every = seen.len().div_ceil(SAMPLES).max(1);
    let sample = |&i: &usize| Sample {
        before: 1.0 / f64::from(known[i]),
        told: 1.0 / f64::from(told[i]),
        squared: f64::from(change[i]).powi(2),
    };
    seen.iter().step_by(every).map(sample).collect()
}

/// The drift under which the squared changes have the median they should have: an update goes `p^2 / (p + r)` in the mean
/// square when p is the variance before and r that of what is told.
fn explaining(samples: &[Sample]) -> f64 {
    let ratio = |drift: f64| {
        let of = |s: &Sample| {
            let p = s.before + drift;
            s.squared * (p + s.told) / (p * p)
        };
        let mut ratios: Vec<f64> = samples.iter().map(of).collect();
        let middle = ratios.len() / 2;
        *ratios.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let (mut low, mut high) = (-12.0_f64, 1.0_f64);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if ratio(10.0_f64.powf(middle)) > MEDIAN_SQUARE { low = middle } else { high = middle }
    }
    10.0_f64.powf(0.5 * (low + high))
}

/// What is known of the dynamic layer before a frame's photographs.
#[derive(Clone, Copy, Debug)]
pub struct Prior<'a> {
    /// Information of every parameter.
    pub information: &'a Information,
    /// Noise of a pixel, in which the photometric loss is measured against it.
    pub noise: PixelNoise,
    /// Factor on the penalty; 1 = as the information says.
    pub weight: f32,
    /// The curvature that natural steps expect of the loss: the information, and what this frame's photographs will tell of every
    /// parameter. Where they tell more than is known, the information alone would make the steps too long.
    pub curvature: &'a Information,
}

impl<'a> Prior<'a> {
    /// The curvature of the loss of a view of which `pixels` pixels count, when `views` views see each Gaussian.
    pub fn curvature<'v>(&self, damping: Damping, views: &'v [u32], pixels: usize) -> Curvature<'v>
    where
        'a: 'v,
    {
        Curvature { information: self.curvature, damping, views, unit: self.unit(pixels) }
    }

    /// The same for photographs whose pixels are blocks of `factor` times `factor` pixels: so many fewer of them share an error.
    #[must_use]
    pub fn reduced(self, factor: usize) -> Self {
        let correlated = self.noise.correlated / (factor * factor) as f64;
        Self { noise: PixelNoise { correlated, ..self.noise }, ..self }
    }

    /// What one nat of information is in the loss of `pixels` pixels, the mean absolute error over their three channels: at an
    /// error of one sigma its derivative `l1_share / (3 pixels)` stands for `1 / (sigma correlated)` in units of the log
    /// likelihood.
    fn unit(&self, pixels: usize) -> f32 {
        let PixelNoise { sigma, correlated } = self.noise;
        let l1_share = 1.0 - SSIM_WEIGHT as f32;
        l1_share * (sigma * correlated) as f32 / (3 * pixels.max(1)) as f32
    }

    /// The derivative that a step adds to that of a loss of `pixels` pixels, (N) shaped like the Gaussians: at `now`, when
    /// `views` views see each Gaussian, for those that are `touched`. What every backend must agree with.
    pub fn pull(
        &self,
        start: &Gaussians,
        views: Vec<u32>,
        now: &Gaussians,
        pixels: usize,
        touched: &[bool],
    ) -> Gaussians {
        let mut out = Gradients::default();
        out.reset(now.len(), now.sh_degree());
        out.touched.copy_from_slice(touched);
        out.fill_untouched();
        Penalty::new(*self, start, views).add(now, pixels, &mut out);
        out.gaussians
    }
}

/// The penalty `1/2 d^T Lambda d` on the change since the start, shared out over the views that see a Gaussian.
pub(crate) struct Penalty<'a> {
    prior: Prior<'a>,
    start: Gaussians,
    /// Views that see each Gaussian.
    views: Vec<u32>,
    damping: Damping,
}

impl<'a> Penalty<'a> {
    pub(crate) fn new(prior: Prior<'a>, start: &Gaussians, views: Vec<u32>) -> Self {
        Self { prior, start: start.clone(), views, damping: Damping::new(prior.curvature) }
    }

    /// Of a loss over `pixels` pixels.
    pub(crate) fn curvature(&self, pixels: usize) -> Curvature<'_> {
        self.prior.curvature(self.damping, &self.views, pixels)
    }

    /// Adds the derivative at `now` to that of a loss over `pixels` pixels.
    pub(crate) fn add(&self, now: &Gaussians, pixels: usize, out: &mut Gradients) {
        let unit = self.prior.weight * self.prior.unit(pixels);
        let share = |i: usize| unit / self.views[i].max(1) as f32;
        let (start, known, g, touched) =
            (&self.start, &self.prior.information.others, &mut out.gaussians, &out.touched);
        let stride = now.sh_stride();
        let positions = &self.prior.information.positions;
        g.means.par_iter_mut().enumerate().filter(|(i, _)| touched[*i]).for_each(|(i, out)| {
            let moved = [0, 1, 2].map(|a| f64::from(now.means[i][a]) - f64::from(start.means[i][a]));
            let pull = positions[i] * DVec3::from(moved) * f64::from(share(i));
            (0..3).for_each(|a| out[a] += pull[a] as f32);
        });
        g.quats.par_iter_mut().enumerate().filter(|(i, _)| touched[*i]).for_each(|(i, out)| {
            let pull = turn_pull(start.quats[i], now.quats[i], known.quats[i]);
            (0..4).for_each(|a| out[a] += share(i) * pull[a]);
        });
        let pull = |out: &mut [f32], now: &[f32], start: &[f32], known: &[f32], share: f32| {
            for (((out, now), start), known) in out.iter_mut().zip(now).zip(start).zip(known) {
                *out += share * known * (now - start);
            }
        };
        let rows = g.log_scales.par_iter_mut().zip(&mut g.opacity_logits).zip(g.sh.par_chunks_mut(stride));
        rows.enumerate().filter(|(i, _)| touched[*i]).for_each(|(i, ((scales, opacity), sh))| {
            let (share, colours) = (share(i), i * stride..(i + 1) * stride);
            pull(scales, &now.log_scales[i], &start.log_scales[i], &known.log_scales[i], share);
            *opacity += share * known.opacity_logits[i] * (now.opacity_logits[i] - start.opacity_logits[i]);
            let [now, start, known] = [now, start, known].map(|g| g.sh[colours.clone()].as_flattened());
            pull(sh.as_flattened_mut(), now, start, known, share);
        });
    }
}

/// Derivative by the quaternion of `1/2 sum information turn^2`.
fn turn_pull(start: [f32; 4], now: [f32; 4], information: [f32; 4]) -> [f32; 4] {
    let scale = 2.0 / start.iter().map(|v| v * v).sum::<f32>().max(f32::MIN_POSITIVE);
    let (turn, rows) = (turn_between(start, now), turn_rows(start));
    let by = |column: usize| {
        (0..3).map(|l| information[l + 1] * turn[l + 1] * scale * rows[l][column]).sum::<f32>()
    };
    [0, 1, 2, 3].map(by)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random(n: usize, seed: u64) -> Gaussians {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut g = Gaussians::zeros(n, 1);
        let mut fill = |column: &mut [f32]| column.iter_mut().for_each(|v| *v = rng.random_range(0.2..1.0));
        fill(g.means.as_flattened_mut());
        fill(g.quats.as_flattened_mut());
        fill(g.log_scales.as_flattened_mut());
        fill(&mut g.opacity_logits);
        fill(g.sh.as_flattened_mut());
        g
    }

    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    /// A filter of scalars with a true drift, its gains as the theory has them.
    #[test]
    fn the_drift_is_found_from_innovations() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for drift in [1e-6, 1e-3, 0.2] {
            let sample = |_| {
                let before = drift * rng.random_range(0.1..2.0);
                let told = drift * rng.random_range(0.1..3.0);
                let p: f64 = before + drift;
                Sample { before, told, squared: p * p / (p + told) * normal(&mut rng).powi(2) }
            };
            let samples: Vec<Sample> = (0..8000).map(sample).collect();
            let found = explaining(&samples);
            assert!((found / drift).ln().abs() < 0.1, "{found} instead of {drift}");
        }
    }

    #[test]
    fn knowledge_fades_to_the_inverse_of_the_sum_of_variances() {
        let known = random(5, 1);
        let drift = Drift::from_array([0.1, 0.2, 0.5, 0.3, 0.4]);
        let faded = drift.fade(&known);
        for (faded, known) in faded.opacity_logits.iter().zip(&known.opacity_logits) {
            assert!((1.0 / faded - 1.0 / known - 0.5).abs() < 1e-5);
        }
        let nothing = Gaussians::zeros(5, 1);
        assert_eq!(drift.fade(&nothing), nothing);
        assert_eq!(Drift::from_array(drift.to_array()), drift);
    }

    /// The penalty itself, in f64.
    fn energy(start: &Gaussians, now: &Gaussians, known: &Information) -> f64 {
        let change = change(start, now);
        let mut sum = 0.0;
        for kind in KINDS {
            let (known, change) = (values(&known.others, kind), values(&change, kind));
            sum += known.iter().zip(change).map(|(k, c)| f64::from(*k) * f64::from(c).powi(2)).sum::<f64>();
        }
        for (i, information) in known.positions.iter().enumerate() {
            let moved = now.positions()[i] - start.positions()[i];
            sum += moved.dot(*information * moved);
        }
        0.5 * sum
    }

    #[test]
    fn the_penalty_is_the_gradient_of_its_energy() {
        let (start, now) = (random(3, 5), random(3, 6));
        let told = DMat3::from_cols_array(&[3.0, 1.0, 0.5, 1.0, 4.0, 0.2, 0.5, 0.2, 2.0]);
        let information = Information { positions: vec![told; 3], others: random(3, 7) };
        let noise = PixelNoise { sigma: 0.1, correlated: 5.0 };
        let penalty = Penalty::new(
            Prior { information: &information, noise, weight: 1.0, curvature: &information },
            &start,
            vec![2; 3],
        );
        let mut gradients = Gradients::default();
        gradients.reset(3, 1);
        gradients.touched = vec![true, true, false];
        gradients.gaussians = Gaussians::zeros(3, 1);
        penalty.add(&now, 100, &mut gradients);
        // Half of the penalty falls to each of the two views; 0.8 / 300 of the loss is 1 / 0.5 of the likelihood.
        let unit = 0.5 * (0.8 / 300.0) * 0.5;
        let check = |found: f32, change: &dyn Fn(&mut Gaussians, f32)| {
            let at = |side: f32| {
                let mut moved = now.clone();
                change(&mut moved, side * 1e-2);
                energy(&start, &moved, &information)
            };
            let want = unit * (at(1.0) - at(-1.0)) / 2e-2;
            assert!((f64::from(found) - want).abs() < 1e-3 * want.abs() + 1e-7, "{found}, {want}");
        };
        let g = &gradients.gaussians;
        for k in 0..3 {
            check(g.means[1][k], &|g, h| g.means[1][k] += h);
            check(g.log_scales[1][k], &|g, h| g.log_scales[1][k] += h);
        }
        (0..4).for_each(|k| check(g.quats[0][k], &|g, h| g.quats[0][k] += h));
        check(g.opacity_logits[0], &|g, h| g.opacity_logits[0] += h);
        check(g.sh[5][2], &|g, h| g.sh[5][2] += h);
        assert_eq!((g.means[2], g.opacity_logits[2]), ([0.0; 3], 0.0), "not seen");
    }
}
