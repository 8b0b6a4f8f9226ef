//! Steps along the natural gradient (Amari 1998): mean derivatives divided by what is known of the parameters that they move.
//!
//! The information of earlier frames is the curvature that the loss is expected to have (Gauss-Newton), so the quotient is the
//! step to the minimum in the units of the parameter. Adam finds these units anew in every frame.

use crate::adam::{Adam, LearningRates};
use crate::constants::{BETA1, LONGEST};
use crate::prior::{Prior, turn_rows};
use ffgs_core::Gaussians;
use ffgs_rasterizer::Information;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Share of the mean information of a kind of parameter that is added to each, so that what nothing is known of, as of a
/// Gaussian that was just born, takes bounded steps.
const DAMPING: f64 = 0.1;

/// What is added to the information of each kind of parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Damping {
    /// Positions (1/m^2).
    pub means: f32,
    /// Turns about the body's axes (1/rad^2).
    pub turns: f32,
    /// Log scales.
    pub scales: f32,
    /// Opacity logits.
    pub opacities: f32,
    /// SH coefficient 0.
    pub sh0: f32,
    /// The other SH coefficients.
    pub sh_rest: f32,
}

impl Damping {
    /// From what is known of a layer.
    pub fn new(information: &Information) -> Self {
        let Information { positions, others } = information;
        let stride = others.sh_stride().max(1);
        let sh = |from: usize, to: usize| others.sh.chunks_exact(stride).flat_map(move |row| &row[from..to]);
        Self {
            means: damping(positions.iter().map(|p| (p.x_axis.x + p.y_axis.y + p.z_axis.z) / 3.0)),
            turns: damping(others.quats.iter().flat_map(|q| &q[1..]).map(|v| f64::from(*v))),
            scales: damping(others.log_scales.as_flattened().iter().map(|v| f64::from(*v))),
            opacities: damping(others.opacity_logits.iter().map(|v| f64::from(*v))),
            sh0: damping(sh(0, 1).flatten().map(|v| f64::from(*v))),
            sh_rest: damping(sh(1, stride).flatten().map(|v| f64::from(*v))),
        }
    }
}

/// Of the mean of what is known at all.
fn damping(known: impl Iterator<Item = f64>) -> f32 {
    let (sum, count) = known.filter(|v| *v > 0.0).fold((0.0, 0), |(sum, count), v| (sum + v, count + 1));
    (DAMPING * sum / f64::from(count.max(1))).max(f64::from(f32::MIN_POSITIVE)) as f32
}

/// The curvature that the loss of a view is expected to have.
#[derive(Clone, Copy, Debug)]
pub struct Curvature<'a> {
    /// Information of all views.
    information: &'a Information,
    damping: Damping,
    /// Views that see each Gaussian, among which it is shared out.
    views: &'a [u32],
    /// One nat in units of the loss.
    unit: f32,
}

impl<'a> Curvature<'a> {
    /// For a view of which `pixels` pixels count, when `views` views see each Gaussian.
    pub fn new(prior: &Prior<'a>, damping: Damping, views: &'a [u32], pixels: usize) -> Self {
        Self { information: prior.information, damping, views, unit: prior.unit(pixels) }
    }
}

impl Adam {
    /// One step of the `touched` Gaussians: the first moment over the curvature, times `share`. No value changes by more
    /// than [`LONGEST`] of its rate.
    ///
    /// # Panics
    /// When the shapes of the arguments and the state differ.
    pub fn step_naturally(
        &mut self,
        gaussians: &mut Gaussians,
        gradient: &Gaussians,
        (share, rates): (f32, &LearningRates),
        curvature: Curvature,
        touched: &[bool],
    ) {
        let (n, stride) = (self.len(), gaussians.sh_stride());
        assert!(gaussians.len() == n && gradient.len() == n && touched.len() == n, "{n} moments");
        let (mean, correction) = self.first_after(touched);
        let Curvature { information: Information { positions, others }, damping, views, unit } = curvature;
        let (now, down) = (gaussians, gradient);
        let per_nat = |i: usize| share * correction(i) * views[i].max(1) as f32 / unit;
        macro_rules! rows {
            ($field:ident) => {
                now.$field
                    .par_iter_mut()
                    .zip(&mut mean.$field)
                    .zip(&down.$field)
                    .enumerate()
                    .filter(|(i, _)| touched[*i])
            };
        }
        rows!(means).for_each(|(i, ((now, mean), down))| {
            let step = Step { per_nat: per_nat(i), damping: damping.means, rate: rates.means };
            step.position(now, follow(mean, down), &positions[i]);
        });
        rows!(quats).for_each(|(i, ((now, mean), down))| {
            let step = Step { per_nat: per_nat(i), damping: damping.turns, rate: rates.quats };
            step.turn(now, follow(mean, down), others.quats[i]);
        });
        rows!(log_scales).for_each(|(i, ((now, mean), down))| {
            let step = Step { per_nat: per_nat(i), damping: damping.scales, rate: rates.scales };
            step.values(now, follow(mean, down), &others.log_scales[i]);
        });
        rows!(opacity_logits).for_each(|(i, ((now, mean), down))| {
            let step = Step { per_nat: per_nat(i), damping: damping.opacities, rate: rates.opacities };
            let mean = follow(std::array::from_mut(mean), &[*down]);
            step.values(std::array::from_mut(now), mean, &[others.opacity_logits[i]]);
        });
        let colours = now.sh.par_chunks_mut(stride).zip(mean.sh.par_chunks_mut(stride));
        let colours = colours.zip(down.sh.par_chunks(stride)).zip(others.sh.par_chunks(stride)).enumerate();
        colours.filter(|(i, _)| touched[*i]).for_each(|(i, (((now, mean), down), known))| {
            let of = [(damping.sh0, rates.sh0), (damping.sh_rest, rates.sh_rest)];
            for (k, (now, mean)) in now.iter_mut().zip(mean).enumerate() {
                let (damping, rate) = of[k.min(1)];
                let step = Step { per_nat: per_nat(i), damping, rate };
                step.values(now, follow(mean, &down[k]), &known[k]);
            }
        });
    }
}

/// The first moment after one more derivative.
fn follow<'a, const N: usize>(mean: &'a mut [f32; N], gradient: &[f32; N]) -> &'a [f32; N] {
    mean.iter_mut().zip(gradient).for_each(|(m, g)| *m += (1.0 - BETA1) * (g - *m));
    mean
}

/// A step of one kind of parameter of one Gaussian.
#[derive(Clone, Copy)]
struct Step {
    /// Change for a mean derivative of one where the information is one.
    per_nat: f32,
    damping: f32,
    rate: f32,
}

impl Step {
    fn position(self, now: &mut [f32; 3], mean: &[f32; 3], information: &DMat3) {
        let curvature = *information + DMat3::from_diagonal(DVec3::splat(self.damping.into()));
        let step = curvature.inverse() * DVec3::from(mean.map(f64::from)) * f64::from(self.per_nat);
        let step = step.as_vec3().to_array();
        now.iter_mut().zip(step).for_each(|(now, step)| *now -= self.limited(step));
    }

    fn turn(self, now: &mut [f32; 4], mean: &[f32; 4], information: [f32; 4]) {
        let rows = turn_rows(*now);
        for (row, information) in rows.iter().zip(&information[1..]) {
            let slope: f32 = row.iter().zip(mean).map(|(r, m)| 0.5 * r * m).sum();
            let turn = self.limited(self.per_nat * slope / (information + self.damping));
            now.iter_mut().zip(row).for_each(|(now, r)| *now -= 0.5 * turn * r);
        }
    }

    fn values<const N: usize>(self, now: &mut [f32; N], mean: &[f32; N], information: &[f32; N]) {
        for ((now, mean), information) in now.iter_mut().zip(mean).zip(information) {
            *now -= self.limited(self.per_nat * mean / (information + self.damping));
        }
    }

    /// Nothing where the step is not a number: a curvature that cannot be inverted.
    fn limited(self, step: f32) -> f32 {
        let longest = LONGEST * self.rate;
        if step.is_finite() { step.clamp(-longest, longest) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gain::PixelNoise;
    use glam::DQuat;

    const PIXELS: usize = 100;
    const FAR: LearningRates =
        LearningRates { means: 1e3, quats: 1e3, scales: 1e3, opacities: 1e3, sh0: 1e3, sh_rest: 1e3 };

    fn known() -> Information {
        let mut others = Gaussians::zeros(2, 1);
        others.quats.fill([0.0, 40.0, 9.0, 25.0]);
        others.log_scales.fill([3.0, 5.0, 8.0]);
        others.opacity_logits.fill(7.0);
        others.sh.fill([2.0, 30.0, 11.0]);
        let block = DMat3::from_cols_array(&[30.0, 10.0, 5.0, 10.0, 40.0, 2.0, 5.0, 2.0, 20.0]);
        Information { positions: vec![block; 2], others }
    }

    fn prior(information: &Information) -> Prior<'_> {
        Prior { information, noise: PixelNoise { sigma: 0.1, correlated: 5.0 }, weight: 1.0 }
    }

    fn start() -> Gaussians {
        let mut g = Gaussians::zeros(2, 1);
        let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.7).as_quat();
        // Twice as long as a unit quaternion.
        g.quats.fill([turn.w, turn.x, turn.y, turn.z].map(|v| 2.0 * v));
        g.means.fill([0.4, -0.2, 0.3]);
        g
    }

    /// After one step of the whole way from `start`, of the first Gaussian alone, where the loss is the penalty of the prior.
    fn stepped(
        information: &Information,
        goal: &Gaussians,
        damping: Damping,
        rates: &LearningRates,
    ) -> Gaussians {
        let (prior, mut now) = (prior(information), start());
        let gradient = prior.pull(goal, vec![3; 2], &now, PIXELS, &[true; 2]);
        let curvature = Curvature::new(&prior, damping, &[3; 2], PIXELS);
        Adam::new(2, 1).step_naturally(&mut now, &gradient, (1.0, rates), curvature, &[true, false]);
        now
    }

    fn close(a: &[f32], b: &[f32]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4)
    }

    /// One step of Newton's method ends at the minimum of a parabola, whatever the units of its parameters.
    #[test]
    fn a_whole_step_ends_at_the_minimum_that_the_information_predicts() {
        let (information, mut goal) = (known(), start());
        goal.means.fill([0.1, 0.5, -0.3]);
        let turn = |q: &mut [f32; 4]| {
            *q = [q[0] - 0.006 * q[1], q[1] + 0.006 * q[0], q[2] + 0.006 * q[3], q[3] - 0.006 * q[2]]
        };
        goal.quats.iter_mut().for_each(turn);
        goal.log_scales.fill([0.5, -1.0, 0.2]);
        goal.opacity_logits.fill(1.5);
        goal.sh.fill([0.3, -0.4, 0.7]);
        let now = stepped(&information, &goal, Damping::default(), &FAR);
        assert!(close(&now.means[0], &goal.means[0]), "{:?}", now.means);
        assert!(close(&now.quats[0], &goal.quats[0]), "{:?} {:?}", now.quats, goal.quats);
        assert!(close(&now.log_scales[0], &goal.log_scales[0]) && close(&now.opacity_logits[..1], &[1.5]));
        assert!(close(now.sh[..4].as_flattened(), goal.sh[..4].as_flattened()));
        assert!(now.select(&[1]) == start().select(&[1]), "not touched");
    }

    /// What nothing is known of gets no derivative of infinite worth, and no step is longer than three rates.
    #[test]
    fn steps_are_damped_and_limited() {
        let (information, mut goal) = (known(), start());
        goal.log_scales.fill([0.5, -1.0, 0.2]);
        let damping = Damping { scales: 3.0, ..Damping::default() };
        let now = stepped(&information, &goal, damping, &FAR);
        assert!(
            close(&now.log_scales[0], &[0.25, -1.0 * 5.0 / 8.0, 0.2 * 8.0 / 11.0]),
            "{:?}",
            now.log_scales
        );
        let now = stepped(&information, &goal, Damping::default(), &LearningRates { scales: 0.1, ..FAR });
        assert!(close(&now.log_scales[0], &[0.3, -0.3, 0.2]), "{:?}", now.log_scales);

        let nothing = Information { positions: vec![DMat3::ZERO; 2], others: Gaussians::zeros(2, 1) };
        let (prior, mut now) = (prior(&nothing), start());
        let mut gradient = Gaussians::zeros(2, 1);
        gradient.means.fill([1e-3, 0.0, -1e-3]);
        gradient.opacity_logits.fill(f32::NAN);
        let curvature = Curvature::new(&prior, Damping::new(&nothing), &[0; 2], PIXELS);
        let rates = LearningRates::with_means(0.01);
        Adam::new(2, 1).step_naturally(&mut now, &gradient, (0.3, &rates), curvature, &[true; 2]);
        assert!(close(&now.means[0], &[0.37, -0.2, 0.33]), "{:?}", now.means);
        assert_eq!(now.opacity_logits, start().opacity_logits);
    }

    #[test]
    fn damping_is_a_tenth_of_what_is_known_on_the_whole() {
        let mut information = known();
        // The second Gaussian was just born.
        information.positions[1] = DMat3::ZERO;
        information.others.log_scales[1] = [0.0; 3];
        let damping = Damping::new(&information);
        assert!(
            (damping.means - 3.0).abs() < 1e-6 && (damping.scales - 16.0 / 30.0).abs() < 1e-6,
            "{damping:?}"
        );
        assert!((damping.opacities - 0.7).abs() < 1e-6 && (damping.turns - 74.0 / 30.0).abs() < 1e-6);
    }
}
