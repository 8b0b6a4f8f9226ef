//! Normal equations of the difference between layer and photographs.

use super::photograph::{Patch, Row, Unknowns};
use ffgs_fusion::RigidMotion;
use nalgebra::Matrix6;
use rayon::prelude::*;

/// A matrix over the unknowns.
pub(crate) type Square = Matrix6<f64>;

/// Normal equations of one view.
#[derive(Clone, Debug)]
struct Normal {
    a: Square,
    b: Unknowns,
}

/// Normal equations of all views.
#[derive(Clone, Debug)]
pub(crate) struct Joint {
    views: Vec<Normal>,
    /// Robust standard deviation of a pixel's difference.
    pub scale: f64,
}

/// Median of the absolute value of a standard normal variable.
pub(super) const NORMAL_MEDIAN: f64 = 0.6745;
/// Half the rounding step of an 8-bit photograph.
pub(super) const LEAST_SCALE: f64 = 0.5 / 255.0;
/// Differences beyond this many scales lose weight (Cauchy's weight, 95 % efficient on normal errors).
const CAUCHY: f64 = 2.385;
/// What is known without a view, as a share of what is known with it, at least.
const LEAST_LEFT: f64 = 0.01;
/// Edge of a square of pixels (px) whose errors are alike.
const ALIKE: f64 = 3.0;

impl Joint {
    /// Linearised at `motion`; `None` when no pixel counts.
    pub(crate) fn new(patches: &[Patch], motion: &RigidMotion) -> Option<Self> {
        let rows: Vec<Vec<Row>> = patches.par_iter().map(|patch| centred(patch.rows(motion))).collect();
        let mut sizes: Vec<f64> = rows.iter().flatten().map(|row| row.difference.abs()).collect();
        if sizes.is_empty() {
            return None;
        }
        let half = sizes.len() / 2;
        let median = *sizes.select_nth_unstable_by(half, f64::total_cmp).1;
        let scale = (median / NORMAL_MEDIAN).max(LEAST_SCALE);
        Some(Self { views: rows.par_iter().map(|rows| Normal::new(rows, scale)).collect(), scale })
    }

    /// The Gauss-Newton step and its covariance, that of how the views disagree, and no less than pixels would have whose neighbours
    /// err alike. `None` where the pictures leave a direction open.
    pub(crate) fn solve(&self) -> Option<(Unknowns, Square)> {
        let a = self.views.iter().fold(Square::zeros(), |sum, view| sum + view.a);
        let b = self.views.iter().fold(Unknowns::zeros(), |sum, view| sum + view.b);
        let inverse = a.cholesky()?.inverse();
        let step = inverse * b;
        let least = inverse * (self.scale * ALIKE).powi(2);
        let covariance = self.disagreement(&a, &inverse, &step)? + least;
        Some((step, (covariance + covariance.transpose()) * 0.5))
    }

    /// Covariance of the step by how far views would move it. The steps without each of them (the jackknife, Quenouille 1956) have as many
    /// directions as views, less one: the fewer these are, the more counts one factor on the inverse of all that is known. `None` as above.
    fn disagreement(&self, a: &Square, inverse: &Square, step: &Unknowns) -> Option<Square> {
        let (n, unknowns) = (self.views.len() as f64, step.len() as f64);
        let (mut jackknife, mut squares, mut freedom) = (Square::zeros(), 0.0, unknowns);
        for view in &self.views {
            let gradient = view.b - view.a * step;
            let without = step_without(a, view, &gradient)?;
            jackknife += without * without.transpose() * ((n - 1.0) / n);
            let share = inverse * view.a;
            squares += gradient.dot(&(inverse * gradient));
            freedom -= (share * share).trace();
        }
        let alike = inverse * (squares / freedom.max(LEAST_LEFT * unknowns));
        let shrinkage = unknowns / (unknowns + n - 1.0);
        Some(alike * shrinkage + jackknife * (1.0 - shrinkage))
    }
}

/// How far the step of all views is from that without one of them, whose `gradient` at the step is given. Where the others know hardly anything, a
/// hundredth of what all know keeps it finite.
fn step_without(all: &Square, view: &Normal, gradient: &Unknowns) -> Option<Unknowns> {
    let others = all * (1.0 + LEAST_LEFT) - view.a;
    Some(others.cholesky()?.solve(gradient))
}

impl Normal {
    fn new(rows: &[Row], scale: f64) -> Self {
        let mut out = Self { a: Square::zeros(), b: Unknowns::zeros() };
        for Row { derivative, difference } in rows {
            let weight = 1.0 / (1.0 + (difference / (CAUCHY * scale)).powi(2));
            out.a += derivative * derivative.transpose() * weight;
            out.b -= derivative * (weight * difference);
        }
        out
    }
}

/// Without what all pixels of the view have in common: a change of the exposure or the light is no motion.
fn centred(mut rows: Vec<Row>) -> Vec<Row> {
    let n = rows.len().max(1) as f64;
    let derivative = rows.iter().fold(Unknowns::zeros(), |sum, row| sum + row.derivative) / n;
    let difference = rows.iter().map(|row| row.difference).sum::<f64>() / n;
    for row in &mut rows {
        row.derivative -= derivative;
        row.difference -= difference;
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// 90 % of the squares of six standard normal variables have a sum below this.
    const CHI_SQUARE_90: f64 = 10.645;

    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        // Irwin and Hall: twelve uniform variables.
        (0..12).map(|_| rng.random_range(-0.5..0.5)).sum()
    }

    /// Share of the true steps in the 90 % ellipsoids, where each of `views` views sees a step of its own.
    fn coverage(views: usize) -> f64 {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let trials = 500;
        let holds = |_: &usize| {
            let truth = Unknowns::from_fn(|_, _| normal(&mut rng));
            let of_view = |_| {
                let rows: Vec<Unknowns> =
                    (0..12).map(|_| Unknowns::from_fn(|_, _| normal(&mut rng))).collect();
                let a = rows.iter().fold(Square::zeros(), |sum, row| sum + row * row.transpose());
                let seen = truth + Unknowns::from_fn(|_, _| 0.1 * normal(&mut rng));
                Normal { a, b: a * seen }
            };
            let joint = Joint { views: (0..views).map(of_view).collect(), scale: LEAST_SCALE };
            let (step, covariance) = joint.solve().unwrap();
            let error = step - truth;
            error.dot(&covariance.cholesky().unwrap().solve(&error)) < CHI_SQUARE_90
        };
        (0..trials).filter(holds).count() as f64 / f64::from(trials as u32)
    }

    #[test]
    fn what_few_views_see_apart_is_in_the_covariance() {
        for views in [4, 6, 10, 20] {
            let share = coverage(views);
            println!("{views} views: {share}");
            assert!((0.6..0.97).contains(&share), "{views} views: {share} in the 90 % ellipsoids");
        }
    }
}
