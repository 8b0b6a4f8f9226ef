//! Discovers rigid groups from the motion alone; beyond the paper.
//!
//! The cloud is cut into compact cells. Each cell estimates its own motion. Larger nodes of the same tree propose
//! rigid motions; the proposal that explains most cells founds a group, is fitted again to a connected set of them,
//! and the search goes on with the rest.

use crate::cells::{Cells, bounds};
use crate::evidence::{Evidence, MEDIAN_CHI2, MEDIAN_LENGTH};
use crate::members::Members;
use crate::motion_fit::{MotionFit, fit_motion, jackknife, place_covariance};
use crate::rigid::RigidMotion;
use crate::symmetric::Symmetric;
use crate::votes::{Voter, Votes};
use ffgs_core::median;
use glam::{DQuat, DVec3};
use nalgebra::Matrix6;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of the rigid groups.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GroupsConfig {
    /// Gaussians of a cell.
    pub cell: usize,
    /// Most cells; beyond, cells grow.
    pub max_cells: usize,
    /// Fewest cells that found a group.
    pub min_cells: usize,
    /// Most groups.
    pub max_groups: usize,
    /// Gaussians a group's motion is fitted to at most.
    pub sample: usize,
    /// Squared Mahalanobis distance beyond which evidence contradicts a motion. Far above the 99 % point, 11.3: errors of
    /// trackers have longer tails than a normal distribution, and those of neighbours are alike.
    pub leave: f64,
    /// Cells nearer than this many typical cell diagonals are connected.
    pub reach: f64,
    /// Parts of a group that lie farther apart than this many typical cell diagonals are aligned with the photographs by themselves.
    pub apart: f64,
    /// Patches of a group whose shared errors are independent: what all trackers get wrong together remains in the
    /// group's motion with the cells' scatter over the square root of this.
    pub patches: f64,
}

impl Default for GroupsConfig {
    fn default() -> Self {
        Self {
            cell: 64,
            max_cells: 2048,
            min_cells: 3,
            max_groups: 32,
            sample: 4096,
            leave: 100.0,
            reach: 1.5,
            apart: 0.5,
            patches: 6.0,
        }
    }
}

/// Gaussians that move rigidly together.
#[derive(Clone, Debug)]
pub struct Group {
    /// Their motion from t-1 to t.
    pub motion: RigidMotion,
    /// Covariance of its step (m) and rotation vector (rad).
    pub covariance: Matrix6<f64>,
    /// Per tracker: variance of its estimates about the motion over what they claim.
    pub scales: Vec<f64>,
    /// Variance per axis of the cells' own motions about the group's (m^2).
    pub spread: f64,
    /// Variance per axis (m^2) of what all trackers get wrong together over the whole group.
    pub shared: f64,
    /// Cells that found the group.
    pub cells: usize,
    /// Logarithm of the odds that it is not rigid.
    pub flexibility: f64,
    /// Whether the trackers have lost it: its motion comes from elsewhere, and what they say of its members does not count.
    pub lost: bool,
}

impl Group {
    /// Where the group takes a place of t-1 (m), and the covariance of that (m^2).
    pub(crate) fn predict(&self, place: DVec3) -> (DVec3, Symmetric) {
        let arm = self.motion.rotation * (place - self.motion.centre);
        let covariance = place_covariance(&self.covariance, arm) + Symmetric::scalar(self.shared);
        (self.motion.apply(place), covariance)
    }
}

/// The groups of one frame.
#[derive(Clone, Debug, Default)]
pub struct Groups {
    /// Groups, the one with most cells first.
    pub found: Vec<Group>,
    /// (N) the group of each Gaussian; `None` only when there are no groups.
    pub of: Vec<Option<usize>>,
    /// The cells, each in one group.
    pub cells: Cells,
}

impl Groups {
    /// Whether the trackers have lost the group of a Gaussian.
    pub(crate) fn lost(&self, i: usize) -> bool {
        self.of[i].is_some_and(|g| self.found[g].lost)
    }
}

/// Finds the groups. `previous` (N, m) are the places at t-1.
pub(crate) fn discover(previous: &[DVec3], evidence: &Evidence, config: &GroupsConfig) -> Groups {
    let size = config.cell.max(previous.len().div_ceil(config.max_cells.max(1)));
    let cells = Cells::new(previous, size);
    let search = Search::new(previous, evidence, config, &cells);
    let mut free: Vec<bool> = search.voters.iter().map(Option::is_some).collect();
    let mut found: Vec<(Vec<usize>, RigidMotion)> = Vec::new();
    let mut scores = search.scores(&(0..free.len()).collect::<Vec<_>>());
    while found.len() < config.max_groups {
        let Some((members, motion)) = search.next_group(&free, &scores) else { break };
        members.iter().for_each(|&c| free[c] = false);
        scores.iter_mut().zip(search.scores(&members)).for_each(|(score, gone)| *score -= gone);
        found.push((members, motion));
    }
    let groups: Vec<(Vec<usize>, Group)> =
        found.into_par_iter().filter_map(|(members, motion)| search.finish(members, motion)).collect();
    search.assign(groups)
}

/// Objects that lie apart from each other: (N) a number for each, by the connected cells of the cloud (m).
pub fn spatial_objects(places: &[DVec3], config: &GroupsConfig) -> Vec<u32> {
    let cells = Cells::new(places, config.cell.max(places.len().div_ceil(config.max_cells.max(1))));
    let adjacent = adjacency(&boxes(places, &cells), config.reach);
    let mut objects = vec![0; places.len()];
    let mut open = vec![true; adjacent.len()];
    for (number, component) in std::iter::from_fn(|| next_component(&adjacent, &mut open)).enumerate() {
        for i in component.iter().flat_map(|&c| cells.members(&cells.leaves[c])) {
            objects[*i] = number as u32;
        }
    }
    objects
}

/// The connected set around the first open cell, which it closes.
pub(crate) fn next_component(adjacent: &[Vec<usize>], open: &mut [bool]) -> Option<Vec<usize>> {
    let seed = open.iter().position(|&o| o)?;
    open[seed] = false;
    let (mut component, mut next) = (vec![seed], 0);
    while let Some(&cell) = component.get(next) {
        next += 1;
        for &other in &adjacent[cell] {
            if std::mem::replace(&mut open[other], false) {
                component.push(other);
            }
        }
    }
    Some(component)
}

pub(crate) fn boxes(places: &[DVec3], cells: &Cells) -> Vec<(DVec3, DVec3)> {
    cells.leaves.iter().map(|r| bounds(cells.members(r).iter().map(|&i| places[i]))).collect()
}

struct Search<'a> {
    previous: &'a [DVec3],
    evidence: &'a Evidence,
    config: &'a GroupsConfig,
    cells: &'a Cells,
    /// (N) whether any tracker measured it.
    measured: Vec<bool>,
    /// One a cell; `None` where too little was measured.
    voters: Vec<Option<Voter>>,
    proposals: Vec<RigidMotion>,
    /// Cells near each cell.
    adjacent: Vec<Vec<usize>>,
    centres: Vec<DVec3>,
}

/// A node of the tree, as a range of Gaussians, and its motion.
type Proposal = (std::ops::Range<usize>, RigidMotion);

/// Cells of the nodes that show how much the errors of a cell's members are shared.
const NOISE_CELLS: std::ops::RangeInclusive<usize> = 8..=32;

/// Factor on the cells' covariances (at least 1) learnt from how cells scatter about the motions of nodes of some
/// cells: trackers err smoothly over a surface, so many estimates are not many independent ones.
fn shared_noise(leaves: &[std::ops::Range<usize>], voters: &[Option<Voter>], proposals: &[Proposal]) -> f64 {
    let factor = |(range, motion): &Proposal| {
        let first = leaves.partition_point(|l| l.start < range.start);
        let last = leaves.partition_point(|l| l.start < range.end);
        let distances: Vec<f64> = voters[first..last].iter().flatten().map(|v| v.distance(motion)).collect();
        let enough = NOISE_CELLS.contains(&distances.len());
        enough.then(|| median(distances)).flatten().map(|m| m / MEDIAN_CHI2)
    };
    let factors: Vec<f64> = proposals.iter().filter_map(factor).collect();
    median(factors).unwrap_or(1.0).max(1.0)
}

/// Fewest measured Gaussians of a cell with a vote.
const MIN_MEASURED: usize = 8;
/// Gaussians a proposal is fitted to.
const PROPOSAL_SAMPLE: usize = 96;

impl<'a> Search<'a> {
    fn new(
        previous: &'a [DVec3],
        evidence: &'a Evidence,
        config: &'a GroupsConfig,
        cells: &'a Cells,
    ) -> Self {
        let measured: Vec<bool> = (0..previous.len()).into_par_iter().map(|i| evidence.measured(i)).collect();
        let fit = |members: &[usize], most: usize| {
            let members = measured_sample(&measured, members.iter().copied(), most);
            fit_from_median(evidence, previous, &members)
        };
        let voter = |range: &std::ops::Range<usize>| {
            let fit = fit(cells.members(range), usize::MAX)?;
            let of_motion = fit.information.cholesky()?.inverse();
            let information = place_covariance(&of_motion, DVec3::ZERO).inverse();
            let centre = fit.motion.centre;
            let place = fit.motion.apply(centre);
            let weight = range.len() as f64;
            let voter = Voter { centre, place, information, weight, scales: fit.scales };
            information.is_finite().then_some(voter)
        };
        let largest = cells.leaves.iter().map(ExactSizeIterator::len).max().unwrap_or(0);
        let proposal = |range: &std::ops::Range<usize>| {
            let large = range.len() > largest;
            large
                .then(|| fit(cells.members(range), PROPOSAL_SAMPLE))
                .flatten()
                .map(|f| (range.clone(), f.motion))
        };
        let boxes = boxes(previous, cells);
        let mut voters: Vec<Option<Voter>> = cells.leaves.par_iter().map(voter).collect();
        let proposals: Vec<Proposal> = cells.nodes.par_iter().filter_map(proposal).collect();
        // Few estimates that happen to agree, or share their error, are no surer than those of other cells.
        let typical = median(voters.iter().flatten().map(Voter::scale)).unwrap_or(1.0);
        voters.iter_mut().flatten().for_each(|v| v.inflate((typical / v.scale()).max(1.0)));
        let noise = shared_noise(&cells.leaves, &voters, &proposals);
        voters.iter_mut().flatten().for_each(|v| v.inflate(noise));
        let proposals: Vec<RigidMotion> = proposals.into_iter().map(|p| p.1).collect();
        Self {
            previous,
            evidence,
            config,
            cells,
            measured,
            voters,
            proposals,
            adjacent: adjacency(&boxes, config.reach),
            centres: boxes.iter().map(|b| (b.0 + b.1) * 0.5).collect(),
        }
    }

    /// What each proposal explains of `cells`.
    fn scores(&self, cells: &[usize]) -> Vec<f64> {
        let votes = Votes::new(cells.iter().filter_map(|&c| self.voters[c].as_ref()));
        let limit = EXPLAINED * self.config.leave;
        self.proposals.par_iter().map(|motion| votes.explained(motion, limit)).collect()
    }

    /// The connected cells that a proposal explains best, among the free ones, and the motion fitted to them; `scores`
    /// are those of the free cells.
    fn next_group(&self, free: &[bool], scores: &[f64]) -> Option<(Vec<usize>, RigidMotion)> {
        let best = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]).then(b.cmp(&a)))?;
        let members = self.explained(&self.proposals[best], free);
        let motion = self.refit(&members, self.proposals[best])?.motion;
        let again = self.explained(&motion, free);
        let members = if again.len() >= members.len() { again } else { members };
        (members.len() >= self.config.min_cells.max(1)).then_some((members, motion))
    }

    /// The heaviest connected set of free cells that agree with a motion.
    fn explained(&self, motion: &RigidMotion, free: &[bool]) -> Vec<usize> {
        let agrees = |c: usize| {
            free[c]
                && self.voters[c].as_ref().is_some_and(|v| v.distance(motion) < EXPLAINED * self.config.leave)
        };
        let mut open: Vec<bool> = (0..free.len()).map(agrees).collect();
        let components = std::iter::from_fn(|| next_component(&self.adjacent, &mut open));
        let mut best = components.fold(Vec::new(), |best, c| if c.len() > best.len() { c } else { best });
        best.sort_unstable();
        best
    }

    fn members(&self, cells: &[usize]) -> Vec<usize> {
        let all = cells.iter().flat_map(|&c| self.cells.members(&self.cells.leaves[c]).iter().copied());
        measured_sample(&self.measured, all, self.config.sample)
    }

    fn refit(&self, cells: &[usize], start: RigidMotion) -> Option<MotionFit> {
        let members = self.members(cells);
        let members = (!members.is_empty()).then(|| Members::new(self.evidence, self.previous, &members))?;
        fit_motion(&members, start)
    }

    /// The group's final motion with its covariance.
    fn finish(&self, cells: Vec<usize>, start: RigidMotion) -> Option<(Vec<usize>, Group)> {
        let fit = self.refit(&cells, start)?;
        let covariance = jackknife(self.evidence, self.previous, &self.members(&cells), &fit);
        let deviation = |&c: &usize| {
            let voter = self.voters[c].as_ref()?;
            Some((fit.motion.apply(voter.centre) - voter.place).length())
        };
        let deviations: Vec<f64> = cells.iter().filter_map(deviation).collect();
        let sigma = median(deviations)? / MEDIAN_LENGTH;
        let spread = sigma * sigma;
        let shared = spread / self.config.patches.clamp(1.0, cells.len().max(1) as f64);
        let (motion, scales, count) = (fit.motion, fit.scales, cells.len());
        let group =
            Group { motion, covariance, scales, spread, shared, cells: count, flexibility: 0.0, lost: false };
        Some((cells, group))
    }

    /// Typical variance per axis of one Gaussian's combined estimate (m^2).
    fn single_variance(&self, cells: &[usize], scales: &[f64]) -> Option<f64> {
        let variance = |&i: &usize| Some(self.evidence.combined(i, scales)?.covariance.trace() / 3.0);
        median(self.members(cells).par_iter().filter_map(variance).collect::<Vec<_>>())
    }

    /// Every cell joins a group: its own, or the one with the nearest cell.
    fn assign(&self, found: Vec<(Vec<usize>, Group)>) -> Groups {
        let mut out =
            Groups { found: Vec::new(), of: vec![None; self.previous.len()], cells: self.cells.clone() };
        let mut label: Vec<Option<usize>> = vec![None; self.centres.len()];
        for (cells, group) in found {
            let parent = self.parent(&cells, &label);
            if parent.is_some_and(|p: usize| self.agree(&cells, &group, &out.found[p])) {
                cells.iter().for_each(|&c| label[c] = parent);
            } else {
                cells.iter().for_each(|&c| label[c] = Some(out.found.len()));
                out.found.push(group);
            }
        }
        let founders: Vec<usize> = (0..label.len()).filter(|&c| label[c].is_some()).collect();
        for (c, range) in self.cells.leaves.iter().enumerate() {
            let distance = |f: usize| self.centres[f].distance_squared(self.centres[c]);
            let nearest = || founders.iter().copied().min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
            let group = label[c].or_else(|| nearest().and_then(|f| label[f]));
            self.cells.members(range).iter().for_each(|&i| out.of[i] = group);
        }
        out
    }

    /// The earlier group that most of the connected cells belong to.
    fn parent(&self, cells: &[usize], label: &[Option<usize>]) -> Option<usize> {
        let around: Vec<usize> =
            cells.iter().flat_map(|&c| &self.adjacent[c]).filter_map(|&o| label[o]).collect();
        let count = |g: usize| around.iter().filter(|&&o| o == g).count();
        around.iter().copied().max_by(|&a, &b| count(a).cmp(&count(b)).then(b.cmp(&a)))
    }

    /// Whether the motion of a group is no more than an error of its trackers about the motion of its parent: within
    /// what they scatter about the parent, or not even shared by all of them. All cells of one patch may err alike.
    fn agree(&self, cells: &[usize], group: &Group, parent: &Group) -> bool {
        let mut scales = group.scales.iter().zip(&parent.scales);
        if scales.any(|(own, parents)| *own > DISSENT * parents) {
            return true;
        }
        let centre = group.motion.centre;
        let (place, covariance) = group.predict(centre);
        let (expected, uncertain) = parent.predict(centre);
        let patches = (cells.len() as f64 / PATCH_CELLS).max(1.0);
        let patch = self.single_variance(cells, &group.scales).unwrap_or(0.0) / patches;
        let total = covariance + uncertain + Symmetric::scalar(parent.spread + patch);
        total.inverse().quadratic(place - expected) <= self.config.leave
    }
}

/// Cells of a patch: trackers err alike over as much of a surface as they see at once. On the sample, groups of 3 to 12
/// cells beside a wheel err by up to 15 cm together.
const PATCH_CELLS: f64 = 8.0;

/// Times `leave`, the squared Mahalanobis distance up to which a cell agrees with a motion: cells err together.
const EXPLAINED: f64 = 2.0;

/// Factor by which a tracker's variance about a group's motion exceeds that about the parent's when it dissents.
const DISSENT: f64 = 10.0;

/// The measured ones of `members`, thinned evenly to at most `most`, in the same order.
fn measured_sample(
    measured: &[bool],
    members: impl Iterator<Item = usize> + Clone,
    most: usize,
) -> Vec<usize> {
    let count = members.clone().filter(|&i| measured[i]).count();
    let stride = count.div_ceil(most.max(1)).max(1);
    members.filter(|&i| measured[i]).step_by(stride).collect()
}

/// Fits from the componentwise median of all trackers' displacements.
fn fit_from_median(evidence: &Evidence, previous: &[DVec3], members: &[usize]) -> Option<MotionFit> {
    if members.len() < MIN_MEASURED {
        return None;
    }
    let members = Members::new(evidence, previous, members);
    let axis = |a: usize| median(members.steps(a));
    let step = DVec3::new(axis(0)?, axis(1)?, axis(2)?);
    fit_motion(&members, RigidMotion { centre: members.centre, rotation: DQuat::IDENTITY, step })
}

/// For every box those no farther away than `reach` typical diagonals.
pub(crate) fn adjacency(boxes: &[(DVec3, DVec3)], reach: f64) -> Vec<Vec<usize>> {
    let diagonals: Vec<f64> = boxes.iter().map(|b| (b.1 - b.0).length()).collect();
    let limit = reach * median(diagonals).unwrap_or(0.0);
    let gap2 =
        |a: &(DVec3, DVec3), b: &(DVec3, DVec3)| (a.0 - b.1).max(b.0 - a.1).max(DVec3::ZERO).length_squared();
    let near = |a: usize| {
        let near = |b: &usize| *b != a && gap2(&boxes[a], &boxes[*b]) <= limit * limit;
        (0..boxes.len()).filter(near).collect()
    };
    (0..boxes.len()).into_par_iter().map(near).collect()
}
