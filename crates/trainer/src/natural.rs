//! Steps along the natural gradient (Amari 1998): mean derivatives divided by what is known of the parameters that they move.
//!
//! The information of earlier frames and that of the photographs at hand is the curvature that the loss is expected to have
//! (Gauss-Newton), so the quotient is the step to the minimum in the units of the parameter. Adam finds these units anew in every frame.

use crate::adam::Adam;
use crate::constants::{BETA1, LONGEST};
use crate::rates::LearningRates;
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
    pub information: &'a Information,
    /// What is added to it.
    pub damping: Damping,
    /// Views that see each Gaussian, among which it is shared out.
    pub views: &'a [u32],
    /// One nat in units of the loss.
    pub unit: f32,
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

/// [`Training::expected_gain`](crate::Training::expected_gain) from the first moments of the positions (N, 3) after so many steps of each
/// (N), where `curvature` is that of a view with the mean number of pixels. `None` before the first step.
pub fn expected_gain(first: &[[f32; 3]], steps: &[u32], curvature: Curvature) -> Option<f64> {
    let Curvature { information, damping, views, unit } = curvature;
    let damping = DMat3::from_diagonal(DVec3::splat(damping.means.into()));
    let moved = (0..first.len()).filter(|&i| steps[i] > 0);
    let gains = moved.map(|i| {
        let corrected = 1.0 - f64::from(BETA1).powi(steps[i] as i32);
        let nats =
            DVec3::from(first[i].map(f64::from)) * f64::from(views[i].max(1)) / (corrected * f64::from(unit));
        0.5 * nats.dot((information.positions[i] + damping).inverse() * nats)
    });
    let (sum, count) =
        gains.filter(|gain| gain.is_finite()).fold((0.0, 0), |(sum, n), gain| (sum + gain, n + 1));
    (count > 0).then(|| sum / f64::from(count))
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

/// Twice the changes of w, x, y, z with turns about the body's x, y and z.
pub(crate) fn turn_rows([w, x, y, z]: [f32; 4]) -> [[f32; 4]; 3] {
    [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]
}
