//! Association from lists of the largest contributors of every pixel (Algorithm 1, lines 15 to 19, read literally). Runs associate while
//! they blend; this is what that is compared with.

use ffgs_core::{DenseMotion, ImageSize, Mask};
use glam::DVec2;
use rayon::prelude::*;
use thiserror::Error;

/// The K largest contributors of every pixel of a view, with what is known of the Gaussians there.
#[derive(Clone, Copy, Debug)]
pub struct ContributorLists<'a> {
    /// K.
    pub count: usize,
    /// (H, W, K) Gaussian indices, negative = empty.
    pub indices: &'a [i32],
    /// (H, W, K) weights `alpha T`.
    pub weights: &'a [f32],
    /// Pixels that count.
    pub mask: &'a Mask,
    /// (N) projections at t-1 (px).
    pub projected: &'a [DVec2],
}

/// What the trackers of one view say of every Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ListedMotion {
    /// (L, N) weights: sums of `alpha T * confidence * max(|flow|, floor)`.
    pub weights: Vec<f64>,
    /// (L, N) projections displaced by the mean flow under the footprint (px).
    pub targets: Vec<DVec2>,
    /// (N) sums of `alpha T` over the masked pixels.
    pub coverage: Vec<f64>,
}

/// Why a view cannot be associated.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ContributorError {
    /// A list does not hold one entry per pixel and contributor.
    #[error("{column} holds {found} entries, expected {expected}")]
    Column {
        /// Name of the list.
        column: &'static str,
        /// Entries found.
        found: usize,
        /// Entries expected.
        expected: usize,
    },
    /// A motion field has another size than the mask.
    #[error("sizes differ: mask {mask:?}, flow {flow:?}")]
    Size {
        /// Size of the mask.
        mask: ImageSize,
        /// Size of the field.
        flow: ImageSize,
    },
    /// A contributor is no Gaussian.
    #[error("contributor {index} is not one of {gaussians} Gaussians")]
    Index {
        /// The index.
        index: i32,
        /// Number of Gaussians N.
        gaussians: usize,
    },
}

/// Sums the flow of every tracker under the footprint of every Gaussian, in f64 and in the order of the pixels.
/// A Gaussian without coverage stays where it was, with weight 0. `flow_floor` (px) is the least flow magnitude in
/// the weights; 0 = Algorithm 1, read literally.
///
/// # Errors
/// [`ContributorError`] when sizes do not fit together.
pub fn associate_lists(
    lists: &ContributorLists,
    flows: &[DenseMotion],
    flow_floor: f64,
) -> Result<ListedMotion, ContributorError> {
    lists.check(flows)?;
    let n = lists.projected.len();
    let mut coverage = vec![0.0; n];
    lists.for_each(|_, gaussian, weight| coverage[gaussian] += weight);
    let sums: Vec<_> = flows.par_iter().map(|flow| lists.gather(flow, flow_floor)).collect();
    let mut out = ListedMotion { coverage, ..ListedMotion::default() };
    for (weights, moved) in sums {
        out.weights.extend(weights);
        out.targets.extend((0..n).map(|i| {
            let covered = out.coverage[i] > 0.0;
            lists.projected[i] + if covered { moved[i] / out.coverage[i] } else { DVec2::ZERO }
        }));
    }
    Ok(out)
}

impl ContributorLists<'_> {
    fn check(&self, flows: &[DenseMotion]) -> Result<(), ContributorError> {
        let size = self.mask.size();
        let expected = size.pixels() * self.count;
        for (column, found) in [("indices", self.indices.len()), ("weights", self.weights.len())] {
            if found != expected {
                return Err(ContributorError::Column { column, found, expected });
            }
        }
        if let Some(other) = flows.iter().find(|f| f.size != size) {
            return Err(ContributorError::Size { mask: size, flow: other.size });
        }
        let gaussians = self.projected.len();
        match self.indices.iter().find(|&&i| i >= 0 && i as usize >= gaussians) {
            Some(&index) => Err(ContributorError::Index { index, gaussians }),
            None => Ok(()),
        }
    }

    /// Pixel, Gaussian and weight of every contribution in the mask.
    fn for_each(&self, mut visit: impl FnMut(usize, usize, f64)) {
        for pixel in (0..self.mask.size().pixels()).filter(|&p| self.mask.data()[p] != 0) {
            for entry in pixel * self.count..(pixel + 1) * self.count {
                if let Ok(gaussian) = usize::try_from(self.indices[entry]) {
                    visit(pixel, gaussian, f64::from(self.weights[entry]));
                }
            }
        }
    }

    /// Weights, and sums of flow, of one tracker.
    fn gather(&self, motion: &DenseMotion, floor: f64) -> (Vec<f64>, Vec<DVec2>) {
        let n = self.projected.len();
        let (mut weights, mut moved) = (vec![0.0; n], vec![DVec2::ZERO; n]);
        self.for_each(|pixel, gaussian, weight| {
            let [x, y] = motion.flow[pixel];
            let flow = DVec2::new(x.into(), y.into());
            weights[gaussian] += weight * f64::from(motion.confidence[pixel]) * flow.length().max(floor);
            moved[gaussian] += weight * flow;
        });
        (weights, moved)
    }
}
