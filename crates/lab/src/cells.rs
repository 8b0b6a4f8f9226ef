//! Errors of estimates by part of the scene.

use ffgs_core::{Dynamic, EstimateStatus, Estimates};
use ffgs_motion_eval::{Kind, Sample, Truth};
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// Samples of one estimate on one part.
#[derive(Clone, Debug, Default)]
pub struct Cell {
    /// Gaussians on the part.
    pub candidates: usize,
    /// Errors of those that have an estimate.
    pub samples: Vec<Sample>,
    /// Gaussians by status, for a tracker alone.
    pub status: BTreeMap<String, usize>,
}

/// Cells by estimate, then part.
pub(crate) type Cells = BTreeMap<String, BTreeMap<String, Cell>>;

/// Compares estimates with the truth of one frame.
pub(crate) struct Scorer<'a> {
    /// True motion.
    pub truth: &'a Truth,
    /// t.
    pub frame: usize,
    /// Places at t - 1 (m).
    pub previous: &'a [DVec3],
    /// Part that each Gaussian sits on.
    pub parts: &'a [Option<u32>],
}

impl Scorer<'_> {
    /// Errors of one tracker's estimates.
    pub(crate) fn tracker(&self, estimates: &Estimates) -> BTreeMap<String, Cell> {
        self.cells(|i| {
            let ok = estimates.status[i] == EstimateStatus::Ok;
            let state = ok.then(|| (estimates.means[i], estimates.covariances[i]));
            (state, Some(format!("{:?}", estimates.status[i])))
        })
    }

    /// Errors of the moved layer.
    pub(crate) fn fused(&self, dynamic: &Dynamic) -> BTreeMap<String, Cell> {
        let means = dynamic.gaussians.positions();
        self.cells(|i| (Some((means[i], dynamic.covariances[i])), None))
    }

    /// Samples by part; what sits on no part is counted without samples.
    fn cells(
        &self,
        state: impl Fn(usize) -> (Option<(DVec3, DMat3)>, Option<String>),
    ) -> BTreeMap<String, Cell> {
        let mut cells = BTreeMap::<String, Cell>::new();
        for (i, part) in self.parts.iter().enumerate() {
            let motion = part.and_then(|p| self.truth.motion(p, self.frame - 1, self.frame));
            let (estimate, status) = state(i);
            let sample = estimate.zip(motion).map(|((mean, covariance), motion)| Sample {
                error: mean - motion.transform_point3(self.previous[i]),
                covariance,
            });
            for name in self.names(*part) {
                let cell = cells.entry(name).or_default();
                cell.candidates += 1;
                cell.samples.extend(sample);
                if let Some(status) = &status {
                    *cell.status.entry(status.clone()).or_default() += 1;
                }
            }
        }
        cells
    }

    /// Groups a part counts in.
    fn names(&self, part: Option<u32>) -> Vec<String> {
        let Some(part) = part else { return vec!["on no part".into()] };
        let kind = match self.truth.kind(part) {
            Kind::Body => "bodies",
            Kind::Wheel => "wheels",
            Kind::Other => "other parts",
        };
        vec![kind.into(), format!("{} ({part})", self.truth.name(part))]
    }
}

/// Adds the cells of a frame.
pub(crate) fn merge(all: &mut Cells, frame: Cells) {
    for (name, parts) in frame {
        for (part, cell) in parts {
            let sum = all.entry(name.clone()).or_default().entry(part).or_default();
            sum.candidates += cell.candidates;
            sum.samples.extend(cell.samples);
            for (status, count) in cell.status {
                *sum.status.entry(status).or_default() += count;
            }
        }
    }
}
