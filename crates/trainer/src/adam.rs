//! Adam (Kingma and Ba 2015) over columns of Gaussians, and over a flat parameter vector.
//!
//! Every Gaussian counts its own steps, so that one born by densification, or rarely seen, gets the bias correction
//! of its own history.

use crate::constants::{BETA1, BETA2, CORRECTED_STEPS, EPSILON};
use crate::density_control::IndexMap;
use crate::rates::LearningRates;
use ffgs_core::Gaussians;
use ffgs_core::kernel::{Kernel, dispatch, fma};
use rayon::prelude::*;

/// Gaussians of one parallel task.
const CHUNK: usize = 512;
/// Of the widest column, the SH coefficients of degree 3.
const NO_GRADIENT: [f32; 48] = [0.0; 48];

/// Which parameters of Gaussians move. No moments are kept of the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Columns {
    /// Positions and rotations.
    pub placement: bool,
    /// Scales and opacities.
    pub shape: bool,
    /// SH coefficients.
    pub colours: bool,
}

impl Columns {
    /// Everything.
    pub const ALL: Self = Self { placement: true, shape: true, colours: true };
    /// SH coefficients only.
    pub const COLOURS: Self = Self { placement: false, shape: false, colours: true };
    /// All but positions and rotations, which hold the motion.
    pub const IN_PLACE: Self = Self { placement: false, shape: true, colours: true };

    /// Whether anything but the colours moves.
    pub fn geometry(self) -> bool {
        self.placement || self.shape
    }
}

/// Which Gaussians a step updates.
#[derive(Clone, Copy, Debug)]
pub enum Update<'a> {
    /// All, by the gradient as it is: where it is zero, moments decay and the Gaussian goes on by its momentum (literal Adam).
    Dense,
    /// Those flagged, (N); the others keep parameters, moments and step count (sparse Adam). Cost grows with what a
    /// view sees.
    Touched(&'a [bool]),
    /// All: those not flagged, (N), have the gradient zero, whatever the column holds, and go on by their momentum. The bias correction is
    /// that of all steps of the training instead of the Gaussian's own, as in 3DGS (docs/adr/0086-what-is-not-drawn-coasts.md).
    Coasting(&'a [bool]),
}

impl Update<'_> {
    #[inline(always)]
    fn includes(self, i: usize) -> bool {
        match self {
            Self::Dense | Self::Coasting(_) => true,
            Self::Touched(flags) => flags[i],
        }
    }

    /// Whether there is a gradient, and a step of its own.
    #[inline(always)]
    fn counts(self, i: usize) -> bool {
        self.flags().is_none_or(|flags| flags[i])
    }

    #[inline(always)]
    fn flags(&self) -> Option<&[bool]> {
        match self {
            Self::Dense => None,
            Self::Touched(flags) | Self::Coasting(flags) => Some(flags),
        }
    }
}

/// Factors of a step: `parameter -= rate * (m * first) / (sqrt(v) * second + epsilon)`.
#[derive(Clone, Copy)]
struct Correction {
    first: f32,
    second: f32,
}

/// Factors of the first and second moment after `t` steps, (steps, 2); the last row serves for all later steps.
pub fn bias_corrections() -> Vec<[f32; 2]> {
    corrections().iter().map(|c| [c.first, c.second]).collect()
}

fn corrections() -> Vec<Correction> {
    let factor = |t: usize| Correction {
        first: (1.0 / (1.0 - f64::from(BETA1).powi(t as i32))) as f32,
        second: (1.0 / (1.0 - f64::from(BETA2).powi(t as i32)).sqrt()) as f32,
    };
    // Entry 0 is never used: a Gaussian's first step has t = 1.
    (0..=CORRECTED_STEPS).map(|t| factor(t.max(1))).collect()
}

/// Adam's state for a Gaussian set: first and second moments shaped like it, and a step count per Gaussian.
#[derive(Clone)]
pub struct Adam {
    first: Gaussians,
    second: Gaussians,
    steps: Vec<u32>,
    /// Steps of the training.
    taken: u32,
    corrections: Vec<Correction>,
    sh_rates: Vec<f32>,
}

impl Adam {
    /// Zero moments for `n` Gaussians of `sh_degree`.
    pub fn new(n: usize, sh_degree: usize) -> Self {
        Self::of_columns(n, sh_degree, Columns::ALL)
    }

    /// The same without memory for the columns that do not move. Such a set keeps its Gaussians.
    pub(crate) fn of_columns(n: usize, sh_degree: usize, columns: Columns) -> Self {
        let moments = || {
            let rows = |moves: bool| if moves { n } else { 0 };
            let mut moments = Gaussians::zeros(0, sh_degree);
            moments.means.resize(rows(columns.placement), [0.0; 3]);
            moments.quats.resize(rows(columns.placement), [0.0; 4]);
            moments.log_scales.resize(rows(columns.shape), [0.0; 3]);
            moments.opacity_logits.resize(rows(columns.shape), 0.0);
            moments.sh.resize(rows(columns.colours) * moments.sh_stride(), [0.0; 3]);
            moments
        };
        Self {
            sh_rates: vec![0.0; 3 * ffgs_core::sh_coefficients(sh_degree)],
            first: moments(),
            second: moments(),
            steps: vec![0; n],
            taken: 0,
            corrections: corrections(),
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Steps taken by each Gaussian, (N).
    pub fn steps(&self) -> &[u32] {
        &self.steps
    }

    /// First moments, shaped like the Gaussians.
    pub fn first_moments(&self) -> &Gaussians {
        &self.first
    }

    /// Second moments, shaped like the Gaussians.
    pub fn second_moments(&self) -> &Gaussians {
        &self.second
    }

    /// One step of `gaussians` down `gradient` (same shape). A column with rate 0 keeps its moments too.
    ///
    /// # Panics
    /// When the shapes of the arguments and the state differ, or a column with a rate has no moments.
    pub fn step(
        &mut self,
        gaussians: &mut Gaussians,
        gradient: &Gaussians,
        rates: &LearningRates,
        update: Update,
    ) {
        let n = self.len();
        assert!(gaussians.len() == n && gradient.len() == n, "{n} moments, {} Gaussians", gaussians.len());
        assert!(gaussians.sh.len() == gradient.sh.len(), "SH degree");
        assert!(update.flags().is_none_or(|flags| flags.len() == n), "flags of {n} Gaussians");
        self.sh_rates.fill(rates.sh_rest);
        self.sh_rates[..3].fill(rates.sh0);
        for (i, step) in self.steps.iter_mut().enumerate() {
            *step += u32::from(update.counts(i));
        }
        self.taken += 1;
        let common = matches!(update, Update::Coasting(_)).then_some(self.taken);
        let Self { steps, corrections, .. } = self;
        let shared = Shared { steps, common, corrections, update, epsilon: EPSILON };
        let (p, g, m, v) = (gaussians, gradient, &mut self.first, &mut self.second);
        macro_rules! column {
            ($field:ident, $rates:expr) => {
                let moments = (m.$field.as_flattened_mut(), v.$field.as_flattened_mut());
                shared.column(p.$field.as_flattened_mut(), g.$field.as_flattened(), moments, $rates);
            };
        }
        column!(means, &[rates.means; 3]);
        column!(quats, &[rates.quats; 4]);
        column!(log_scales, &[rates.scales; 3]);
        column!(sh, &self.sh_rates);
        let moments = (&mut m.opacity_logits[..], &mut v.opacity_logits[..]);
        shared.column(&mut p.opacity_logits, &g.opacity_logits, moments, &[rates.opacities]);
    }

    /// First moments, and the factor that corrects each after one more step of the `touched` Gaussians, which are counted.
    pub(crate) fn first_after(&mut self, touched: &[bool]) -> (&mut Gaussians, impl Fn(usize) -> f32) {
        self.steps.iter_mut().zip(touched).for_each(|(steps, touched)| *steps += u32::from(*touched));
        let Self { first, steps, corrections, .. } = self;
        (first, |i: usize| corrections[(steps[i] as usize).min(CORRECTED_STEPS)].first)
    }

    /// Keeps the moments of the Gaussians at `indices`, in that order.
    pub fn select(&mut self, indices: &[usize]) {
        self.first = self.first.select(indices);
        self.second = self.second.select(indices);
        self.steps = indices.iter().map(|&i| self.steps[i]).collect();
    }

    /// Appends `n` Gaussians with zero moments and no steps.
    pub(crate) fn append_zeros(&mut self, n: usize) {
        let zeros = Gaussians::zeros(n, self.first.sh_degree());
        self.first.extend(&zeros);
        self.second.extend(&zeros);
        self.steps.resize(self.steps.len() + n, 0);
    }

    /// Follows a densification: moments of kept Gaussians, zeros for new ones.
    pub fn remap(&mut self, map: &IndexMap) {
        let kept = map.kept();
        self.select(&map.sources[..kept]);
        self.append_zeros(map.len() - kept);
    }

    /// Zeroes the moments of all opacities (after an opacity reset). Step counts stay.
    pub fn reset_opacity(&mut self) {
        self.first.opacity_logits.fill(0.0);
        self.second.opacity_logits.fill(0.0);
    }
}

/// What every column of a step reads.
#[derive(Clone, Copy)]
struct Shared<'a> {
    steps: &'a [u32],
    /// Steps that count for all, instead of their own.
    common: Option<u32>,
    corrections: &'a [Correction],
    update: Update<'a>,
    epsilon: f32,
}

impl Shared<'_> {
    fn column(
        self,
        parameters: &mut [f32],
        gradient: &[f32],
        (first, second): (&mut [f32], &mut [f32]),
        rates: &[f32],
    ) {
        if rates.iter().all(|&r| r == 0.0) {
            return;
        }
        assert_eq!(first.len(), parameters.len(), "moments of a column that moves");
        let length = CHUNK * rates.len();
        parameters
            .par_chunks_mut(length)
            .zip(gradient.par_chunks(length))
            .zip(first.par_chunks_mut(length))
            .zip(second.par_chunks_mut(length))
            .enumerate()
            .for_each(|(chunk, (((p, g), m), v))| {
                dispatch(Chunk { shared: self, start: chunk * CHUNK, p, g, m, v, rates });
            });
    }

    #[inline(always)]
    fn correction(&self, i: usize) -> Correction {
        let steps = self.common.unwrap_or(self.steps[i]);
        self.corrections[(steps as usize).min(CORRECTED_STEPS)]
    }
}

/// One column of up to [`CHUNK`] Gaussians.
struct Chunk<'a> {
    shared: Shared<'a>,
    start: usize,
    p: &'a mut [f32],
    g: &'a [f32],
    m: &'a mut [f32],
    v: &'a mut [f32],
    rates: &'a [f32],
}

impl Kernel for Chunk<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let width = self.rates.len();
        let count = self.p.len() / width;
        let steps = &self.shared.steps[self.start..self.start + count];
        let uniform = matches!(self.shared.update, Update::Dense)
            && width < 16
            && steps.iter().all(|s| *s == steps[0])
            && self.rates.iter().all(|r| *r == self.rates[0]);
        if uniform {
            let by = self.shared.correction(self.start);
            descend_uniform::<FMA>(self.p, self.g, self.m, self.v, self.rates[0], by, self.shared.epsilon);
            return;
        }
        for i in (0..count).filter(|i| self.shared.update.includes(self.start + i)) {
            let by = self.shared.correction(self.start + i);
            let at = i * width..(i + 1) * width;
            let has_gradient = self.shared.update.counts(self.start + i);
            let g = if has_gradient { &self.g[at.clone()] } else { &NO_GRADIENT[..width] };
            let p = &mut self.p[at.clone()];
            let (m, v) = (&mut self.m[at.clone()], &mut self.v[at]);
            for ((((p, g), m), v), rate) in p.iter_mut().zip(g).zip(m).zip(v).zip(self.rates) {
                descend::<FMA>(p, *g, m, v, *rate, by, self.shared.epsilon);
            }
        }
    }
}

/// The same rate and step count throughout: one flat loop.
#[inline(always)]
fn descend_uniform<const FMA: bool>(
    p: &mut [f32],
    g: &[f32],
    m: &mut [f32],
    v: &mut [f32],
    rate: f32,
    by: Correction,
    epsilon: f32,
) {
    for (((p, g), m), v) in p.iter_mut().zip(g).zip(m).zip(v) {
        descend::<FMA>(p, *g, m, v, rate, by, epsilon);
    }
}

#[inline(always)]
fn descend<const FMA: bool>(
    p: &mut f32,
    g: f32,
    m: &mut f32,
    v: &mut f32,
    rate: f32,
    by: Correction,
    epsilon: f32,
) {
    *m = fma::<FMA>(1.0 - BETA1, g - *m, *m);
    *v = fma::<FMA>(1.0 - BETA2, fma::<FMA>(g, g, -*v), *v);
    *p -= rate * (*m * by.first) / fma::<FMA>(v.sqrt(), by.second, epsilon);
}

/// Adam over a flat vector whose entries form items of `width` values, each with its own step count (texels: 3).
#[derive(Clone)]
pub struct AdamVec {
    first: Vec<f32>,
    second: Vec<f32>,
    steps: Vec<u32>,
    corrections: Vec<Correction>,
    rates: Vec<f32>,
}

impl AdamVec {
    /// Zero moments for `items` items of `width` values.
    pub fn new(items: usize, width: usize) -> Self {
        let moments = vec![0.0; items * width];
        Self::resumed([moments.clone(), moments], vec![0; items], width)
    }

    /// With the moments of another, each (items * width), and the steps that every item has taken.
    ///
    /// # Panics
    /// When the lengths are not those of items of `width` values.
    pub fn resumed([first, second]: [Vec<f32>; 2], steps: Vec<u32>, width: usize) -> Self {
        assert!(
            [&first, &second].iter().all(|m| m.len() == steps.len() * width),
            "moments of {width} values"
        );
        Self { first, second, steps, corrections: corrections(), rates: vec![0.0; width] }
    }

    /// First and second moments, each (items * width).
    pub fn moments(&self) -> [&[f32]; 2] {
        [&self.first, &self.second]
    }

    /// Steps taken by each item.
    pub fn steps(&self) -> &[u32] {
        &self.steps
    }

    /// One step of `parameters` down `gradient`, both (items * width). A derivative that is small against `epsilon` moves
    /// its parameter by less than `rate`, in proportion.
    ///
    /// # Panics
    /// When a length differs from the state's.
    pub fn step(
        &mut self,
        parameters: &mut [f32],
        gradient: &[f32],
        (rate, epsilon): (f32, f32),
        update: Update,
    ) {
        assert!(parameters.len() == self.first.len() && gradient.len() == self.first.len(), "lengths differ");
        self.rates.fill(rate);
        for (i, step) in self.steps.iter_mut().enumerate() {
            *step += u32::from(update.counts(i));
        }
        let Self { steps, corrections, .. } = self;
        let shared = Shared { steps, common: None, corrections, update, epsilon };
        shared.column(parameters, gradient, (&mut self.first, &mut self.second), &self.rates);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATES: LearningRates =
        LearningRates { means: 0.01, quats: 0.02, scales: 0.03, opacities: 0.04, sh0: 0.05, sh_rest: 0.06 };

    /// Deterministic values in -1..1.
    fn wave(column: &mut [f32], phase: f32) {
        for (i, v) in column.iter_mut().enumerate() {
            *v = (i as f32 * 0.7 + phase).sin();
        }
    }

    fn waves(n: usize, degree: usize, phase: f32) -> Gaussians {
        let mut g = Gaussians::zeros(n, degree);
        wave(g.means.as_flattened_mut(), phase);
        wave(g.quats.as_flattened_mut(), phase + 1.0);
        wave(g.log_scales.as_flattened_mut(), phase + 2.0);
        wave(&mut g.opacity_logits, phase + 3.0);
        wave(g.sh.as_flattened_mut(), phase + 4.0);
        g
    }

    fn reference(start: f32, gradients: &[f32], rate: f32) -> f64 {
        let (mut p, mut m, mut v) = (f64::from(start), 0.0, 0.0);
        for (t, &g) in gradients.iter().enumerate() {
            let (g, t) = (f64::from(g), t as i32 + 1);
            m = 0.9 * m + 0.1 * g;
            v = 0.999 * v + 0.001 * g * g;
            let (mean, square) = (m / (1.0 - 0.9f64.powi(t)), v / (1.0 - 0.999f64.powi(t)));
            p -= f64::from(rate) * mean / (square.sqrt() + 1e-15);
        }
        p
    }

    #[test]
    fn steps_match_the_scalar_definition() {
        let (n, degree) = (700, 2);
        let start = waves(n, degree, 0.0);
        let gradients: Vec<_> = (0..5).map(|t| waves(n, degree, 10.0 + t as f32)).collect();
        let mut g = start.clone();
        let mut adam = Adam::new(n, degree);
        for gradient in &gradients {
            adam.step(&mut g, gradient, &RATES, Update::Dense);
        }
        let check = |got: f32, column: fn(&Gaussians) -> &[f32], i: usize, rate: f32| {
            let history: Vec<f32> = gradients.iter().map(|g| column(g)[i]).collect();
            let want = reference(column(&start)[i], &history, rate);
            assert!((f64::from(got) - want).abs() < 2e-6, "{got} against {want}");
        };
        for i in [0, 1, 511 * 3, n * 3 - 1] {
            check(g.means.as_flattened()[i], |g| g.means.as_flattened(), i, RATES.means);
            check(g.log_scales.as_flattened()[i], |g| g.log_scales.as_flattened(), i, RATES.scales);
            check(g.quats.as_flattened()[i], |g| g.quats.as_flattened(), i, RATES.quats);
            check(g.opacity_logits[i / 3], |g| &g.opacity_logits, i / 3, RATES.opacities);
        }
        check(g.sh.as_flattened()[28], |g| g.sh.as_flattened(), 28, RATES.sh0);
        check(g.sh.as_flattened()[30], |g| g.sh.as_flattened(), 30, RATES.sh_rest);
    }

    #[test]
    fn untouched_gaussians_keep_everything() {
        let n = 10;
        let touched: Vec<bool> = (0..n).map(|i| i % 3 == 0).collect();
        let start = waves(n, 1, 0.0);
        let gradient = waves(n, 1, 5.0);
        let (mut dense, mut sparse) = (start.clone(), start.clone());
        Adam::new(n, 1).step(&mut dense, &gradient, &RATES, Update::Dense);
        let mut adam = Adam::new(n, 1);
        adam.step(&mut sparse, &gradient, &RATES, Update::Touched(&touched));
        for (i, &hit) in touched.iter().enumerate() {
            let want = if hit { &dense } else { &start };
            assert_eq!(sparse.select(&[i]), want.select(&[i]));
            assert_eq!(adam.steps()[i], u32::from(hit));
        }
    }

    /// `reference` with a gradient of zero in the steps that do not draw.
    #[test]
    fn coasting_gaussians_go_on_by_their_momentum() {
        let n = 700;
        let (start, gradient) = (waves(n, 3, 0.0), waves(n, 3, 5.0));
        let (mut g, mut adam) = (start.clone(), Adam::new(n, 3));
        for step in 0..3 {
            // The columns hold a gradient of all, also of those that the step does not draw.
            let drawn: Vec<bool> = (0..n).map(|i| i % 3 == step).collect();
            adam.step(&mut g, &gradient, &RATES, Update::Coasting(&drawn));
            assert!(step == 2 || g.means[2] == start.means[2], "nothing has drawn it yet");
        }
        assert_eq!(adam.steps(), vec![1; n]);
        let check = |got: f32, start: f32, gradient: f32, i: usize, rate: f32| {
            let history: Vec<f32> = (0..3).map(|step| if i % 3 == step { gradient } else { 0.0 }).collect();
            let want = reference(start, &history, rate);
            assert!((f64::from(got) - want).abs() < 2e-6, "{got} against {want}");
        };
        for i in [0, 1, 2, 512, n - 1] {
            check(
                g.opacity_logits[i],
                start.opacity_logits[i],
                gradient.opacity_logits[i],
                i,
                RATES.opacities,
            );
            check(g.means[i][1], start.means[i][1], gradient.means[i][1], i, RATES.means);
            let [g, start, gradient] = [&g, &start, &gradient].map(|g| g.sh_of(i)[15][2]);
            check(g, start, gradient, i, RATES.sh_rest);
        }
    }

    #[test]
    fn columns_that_do_not_move_have_no_moments() {
        let (start, gradient) = (waves(4, 1, 0.0), waves(4, 1, 1.0));
        let (mut all, mut colours) = (start.clone(), start);
        let rates = LearningRates { means: 0.0, quats: 0.0, scales: 0.0, opacities: 0.0, ..RATES };
        Adam::new(4, 1).step(&mut all, &gradient, &rates, Update::Dense);
        let mut adam = Adam::of_columns(4, 1, Columns::COLOURS);
        adam.step(&mut colours, &gradient, &rates, Update::Dense);
        assert_eq!(colours, all);
        assert!(adam.first.is_empty() && adam.second.is_empty() && adam.second.sh.len() == 16);
    }

    #[test]
    #[should_panic(expected = "a column that moves")]
    fn a_rate_for_a_column_without_moments_is_refused() {
        let (mut start, gradient) = (waves(4, 1, 0.0), waves(4, 1, 1.0));
        Adam::of_columns(4, 1, Columns::COLOURS).step(&mut start, &gradient, &RATES, Update::Dense);
    }

    #[test]
    fn moments_follow_a_densification() {
        let mut g = waves(4, 0, 0.0);
        let mut adam = Adam::new(4, 0);
        adam.step(&mut g, &waves(4, 0, 1.0), &RATES, Update::Dense);
        let before = adam.clone();
        adam.select(&[3, 1]);
        adam.append_zeros(1);
        assert_eq!(adam.steps(), [1, 1, 0]);
        assert_eq!(adam.first.means[0], before.first.means[3]);
        assert_eq!(adam.second.sh[2], [0.0; 3]);
        adam.reset_opacity();
        assert_eq!(adam.first.opacity_logits, [0.0; 3]);
        adam.first.validate().unwrap();
    }

    #[test]
    fn the_flat_form_matches_the_scalar_definition() {
        let mut p = vec![0.3, -0.2, 0.1, 0.5, 0.6, 0.7];
        let gradient = [0.1, -0.2, 0.3, 0.4, 0.5, 0.6];
        let mut adam = AdamVec::new(2, 3);
        adam.step(&mut p, &gradient, (0.01, 1e-15), Update::Touched(&[true, false]));
        adam.step(&mut p, &gradient, (0.01, 1e-15), Update::Touched(&[true, false]));
        assert!((f64::from(p[1]) - reference(-0.2, &[-0.2, -0.2], 0.01)).abs() < 1e-6);
        assert_eq!(p[3..], [0.5, 0.6, 0.7]);
        // At the derivative's own size, half the rate.
        let mut half = vec![0.0; 3];
        AdamVec::new(1, 3).step(&mut half, &[0.1; 3], (0.01, 0.1), Update::Dense);
        assert!((half[0] + 0.005).abs() < 1e-6, "{half:?}");
    }
}
