//! The fusion before its update: predicted places, the trackers' evidence, and the rigid groups that it shows. What photographs say of the
//! groups is added by the caller, between [`predict`](crate::InformationFuser::predict) and [`update`](crate::InformationFuser::update).

use crate::cell_views::Departing;
use crate::evidence::Evidence;
use crate::groups::Groups;
use crate::input::FusionInput;
use glam::DVec3;
use rayon::prelude::*;

/// What one frame's fusion knows before its update.
pub struct Prediction<'a> {
    pub(crate) input: &'a FusionInput<'a>,
    /// (N) means without any structure (m).
    pub(crate) means: Vec<DVec3>,
    /// Process noise (m).
    pub(crate) q: f64,
    /// (N) the same of each Gaussian (m).
    pub(crate) q_of: Vec<f64>,
    pub(crate) evidence: Evidence,
    /// Rigid groups with the motions that the trackers measured; none unless the structure is of groups. An alignment with the
    /// photographs changes their motions and covariances.
    pub groups: Groups,
}

impl Prediction<'_> {
    /// How the trackers see each cell of the groups depart from its group's motion. To be asked after the groups were aligned.
    pub fn departures(&self) -> Departures {
        let groups = &self.groups;
        let departing = |range: &std::ops::Range<usize>| {
            let members = groups.cells.members(range);
            let group = &groups.found[groups.of[*members.first()?]?];
            let observed = self.input.observed.as_ref().filter(|_| !group.lost)?;
            Departing::new(observed, self.input.prior_means, members, &group.motion)
        };
        let cells: Vec<Option<Departing>> = groups.cells.leaves.par_iter().map(departing).collect();
        Departures { odds: vec![0.0; cells.len()], cells }
    }
}

/// Departures of the cells of the rigid groups, one entry per cell.
pub struct Departures {
    pub(crate) cells: Vec<Option<Departing>>,
    /// Logarithm of the odds, by the photographs, that the cell departs rather than moves with its group; 0 where they say nothing.
    pub odds: Vec<f64>,
}

impl Departures {
    /// How far each cell would be (m) beyond its group's motion at t; `None` where the trackers do not say.
    pub fn offsets(&self) -> Vec<Option<DVec3>> {
        self.cells.iter().map(|cell| Some(cell.as_ref()?.offset)).collect()
    }
}
