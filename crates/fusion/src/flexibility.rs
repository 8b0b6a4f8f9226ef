//! Probability that a Gaussian departs from the motion of its rigid group, filtered over frames.
//!
//! The covariances of the trackers are not read here, so a factor on them changes nothing.

use crate::cell_views::Departing;
use crate::groups::Groups;
use crate::prediction::Departures;
use crate::symmetric::Symmetric;
use ffgs_core::median;

/// What one frame says of every Gaussian's flexibility, columns of length N.
pub(crate) struct Flexibility {
    /// Probability that it departs from its group's motion.
    pub probability: Vec<f64>,
    /// Evidence of this and earlier frames for the next one.
    pub evidence: Vec<f64>,
    /// Logarithm of the odds that each group is not rigid.
    pub of_groups: Vec<f64>,
    /// Covariance of what all trackers together see of its surroundings (m^2), with the errors that they share.
    pub noise: Vec<Symmetric>,
}

/// Weight of earlier frames' evidence: what was rigid for ten frames is rigid in the eleventh, what begins to bend is
/// seen within a few.
const MEMORY: f64 = 0.8;
/// Most evidence that counts, of either kind.
const MOST: f64 = 12.0;
/// Independent pieces of evidence of a group: its cells err together over patches of it.
const PATCHES: f64 = 6.0;
/// Prior of the share of a group's cells that depart, as counts of cells that do and that do not.
const PRIOR: [f64; 2] = [0.5, 9.5];
/// Rounds of the estimation of that share.
const ROUNDS: usize = 20;
/// Least noise of a view (px): what trackers get wrong alike in all views, such as their preference of whole pixels.
const LEAST_NOISE: f64 = 0.05;

impl Flexibility {
    /// Of N Gaussians of which nothing is known: they are as rigid as their groups.
    pub(crate) fn none(n: usize) -> Self {
        Self {
            probability: vec![0.0; n],
            evidence: vec![0.0; n],
            of_groups: Vec::new(),
            noise: vec![Symmetric::default(); n],
        }
    }

    /// Of the cells of `groups`. `remembered` (N) is the evidence of the last frame, if there is any.
    pub(crate) fn new(groups: &Groups, departures: &Departures, remembered: Option<&[f64]>) -> Self {
        let mut out = Self::none(groups.of.len());
        for group in 0..groups.found.len() {
            let cells: Vec<Cell> = (groups.cells.leaves.iter().zip(&departures.cells).zip(&departures.odds))
                .map(|((range, departing), &shown)| Cell {
                    members: groups.cells.members(range),
                    departing: departing.as_ref(),
                    shown,
                })
                .filter(|cell| cell.members.first().is_some_and(|&i| groups.of[i] == Some(group)))
                .collect();
            out.judge(&cells, remembered);
        }
        out
    }

    fn judge(&mut self, cells: &[Cell], remembered: Option<&[f64]>) {
        let variances: Vec<f64> = cells.iter().filter_map(|c| Some(c.departing?.variance)).collect();
        let variance = median(variances).unwrap_or(0.0).max(LEAST_NOISE * LEAST_NOISE);
        let own = |c: &Cell| c.departing.map_or(0.0, |d| d.evidence(variance).clamp(-MOST, MOST) + c.shown);
        let own: Vec<f64> = cells.iter().map(own).collect();
        let doubt = doubt(cells, variance);
        let all: Vec<Option<f64>> =
            cells.iter().map(|c| accumulated(c, variance, doubt, remembered)).collect();
        let (odds, flexible) = (odds_of_departing(&own), odds_of_group(&all));
        self.of_groups.push(flexible);
        for (k, Cell { members, departing, .. }) in cells.iter().enumerate() {
            for &i in *members {
                self.evidence[i] = all[k].unwrap_or(0.0);
                self.probability[i] = probability(flexible.exp()) * probability(odds * own[k].exp());
                self.noise[i] = departing.map_or(Symmetric::default(), |d| d.covariance(variance));
            }
        }
    }
}

/// A cell of a group.
struct Cell<'a> {
    members: &'a [usize],
    /// What the trackers say of its departure.
    departing: Option<&'a Departing>,
    /// What the photographs say of that, as logarithm of the odds.
    shown: f64,
}

fn probability(odds: f64) -> f64 {
    odds / (1.0 + odds)
}

/// Odds that a cell of a group departs, before its own evidence: the share of cells that do, by maximum posterior.
fn odds_of_departing(evidence: &[f64]) -> f64 {
    let [yes, no] = PRIOR;
    let mut odds = yes / no;
    for _ in 0..ROUNDS {
        let departing = yes + evidence.iter().map(|e| probability(odds * e.exp())).sum::<f64>();
        odds = departing / (yes + no + evidence.len() as f64 - departing);
    }
    odds
}

/// Where trackers see cells depart and the photographs together do not, trackers have failed: evidence (at most 0) of each
/// patch of the group.
fn doubt(cells: &[Cell], variance: f64) -> f64 {
    let departs = |cell: &&Cell| cell.departing.is_some_and(|d| d.evidence(variance) > 0.0);
    cells.iter().filter(departs).map(|cell| cell.shown).sum::<f64>().min(0.0) / PATCHES
}

/// What this and earlier frames say of a cell, if they say anything.
fn accumulated(cell: &Cell, variance: f64, doubt: f64, remembered: Option<&[f64]>) -> Option<f64> {
    let mean =
        |e: &[f64]| MEMORY * cell.members.iter().map(|&i| e[i]).sum::<f64>() / cell.members.len() as f64;
    let new = cell.departing.map(|d| (d.cautious_evidence(variance) + doubt).clamp(-MOST, MOST));
    let before = remembered.map(mean);
    (before.is_some() || new.is_some())
        .then(|| (before.unwrap_or(0.0) + new.unwrap_or(0.0)).clamp(-MOST, MOST))
}

/// Logarithm of the odds that a group is not rigid: by the evidence that three in ten of its cells exceed. What a body
/// shows in few cells, wheels or what lies behind a window, does not make it soft.
fn odds_of_group(evidence: &[Option<f64>]) -> f64 {
    let mut known: Vec<f64> = evidence.iter().copied().flatten().collect();
    known.sort_by(f64::total_cmp);
    let exceeded = known.get(known.len() * 7 / 10).copied().unwrap_or(UNKNOWN);
    PATCHES.min(evidence.len() as f64) * exceeded
}

/// Evidence of a group of which no cell was seen by enough views: it is taken for rigid.
const UNKNOWN: f64 = -1.0;
