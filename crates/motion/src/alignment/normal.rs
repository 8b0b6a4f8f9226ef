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

    /// The Gauss-Newton step and its covariance: the scatter of the views' gradients between the inverse normal matrices
    /// (White 1980, clustered by view), and no less than pixels would have whose neighbours err alike. `None` where the
    /// pictures leave a direction open.
    pub(crate) fn solve(&self) -> Option<(Unknowns, Square)> {
        let a = self.views.iter().fold(Square::zeros(), |sum, view| sum + view.a);
        let b = self.views.iter().fold(Unknowns::zeros(), |sum, view| sum + view.b);
        let inverse = a.cholesky()?.inverse();
        let step = inverse * b;
        let n = self.views.len() as f64;
        let gradients = self.views.iter().map(|view| view.b - view.a * step);
        let scatter = gradients.fold(Square::zeros(), |sum, g| sum + g * g.transpose()) * (n / (n - 1.0));
        let least = a * (self.scale * ALIKE).powi(2);
        let covariance = inverse * (scatter + least) * inverse;
        Some((step, (covariance + covariance.transpose()) * 0.5))
    }
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
