//! The prior of the fusion from the motion of each Gaussian's rigid group or neighbourhood; beyond the paper.

use crate::config::FusionConfig;
use crate::correlation::correlation;
use crate::error::FusionError;
use crate::evidence::{Combined, Evidence, TrackerEstimate};
use crate::flexibility::Flexibility;
use crate::groups::Groups;
use crate::input::FusionInput;
use crate::neighbourhoods::{COMPARED, local_rigid_motion};
use crate::prediction::Departures;
use crate::prior::Prior;
use crate::symmetric::Symmetric;
use ffgs_core::median;
use glam::{DMat3, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Priors of all Gaussians and what the residuals say of the trackers.
pub(crate) struct Structured {
    /// (N) priors.
    pub priors: Vec<Prior>,
    /// (N) the prior of those that may depart from their group, with the probability that they do.
    pub alternatives: Vec<Option<(f64, Prior)>>,
    /// (N) evidence that the Gaussian departs from its group, for the next frame.
    pub flexibility: Vec<f64>,
    /// Rows of factors on the trackers' covariances.
    scales: Vec<Vec<f64>>,
    /// Correlation between the errors of two trackers, 0..1.
    pub correlation: f64,
    /// The groups.
    pub groups: Groups,
}

impl Structured {
    /// Factors on the trackers' covariances for a Gaussian.
    pub(crate) fn scales(&self, prior: &Prior) -> &[f64] {
        &self.scales[prior.scales]
    }
}

/// Groups first; a Gaussian that contradicts its group, or has none, takes the motion of its neighbourhood. `None` when too little was
/// measured to say anything.
///
/// # Errors
/// [`FusionError::Index`] when the spatial index refuses the points.
pub(crate) fn structured(
    input: &FusionInput,
    evidence: &Evidence,
    config: &FusionConfig,
    mut groups: Groups,
    departures: &Departures,
) -> Result<Option<Structured>, FusionError> {
    let previous = input.prior_means;
    let flexibility = match &input.observed {
        Some(_) => Flexibility::new(&groups, departures, input.flexibility),
        None => Flexibility::none(previous.len()),
    };
    let odds = flexibility.of_groups.iter();
    groups.found.iter_mut().zip(odds).for_each(|(group, odds)| group.flexibility = *odds);
    let scales: Vec<Vec<f64>> = groups.found.iter().map(|g| g.scales.clone()).collect();
    let by_group = |i: usize| {
        let g = groups.of[i]?;
        let group = &groups.found[g];
        let (mean, covariance) = group.predict(previous[i]);
        Some(Prior {
            mean,
            covariance,
            rotation: group.motion.rotation,
            scales: g,
            spread: group.spread,
            shared: Symmetric::default(),
            left: false,
            free: false,
        })
    };
    let priors: Vec<Option<Prior>> = (0..previous.len()).into_par_iter().map(by_group).collect();
    let leavers =
        Outliers { previous, evidence, priors: &priors, scales: &scales, leave: config.groups.leave };
    let departures = leavers.find()?;
    let correlation = correlation(evidence, &priors, &scales);
    let priors: Vec<Option<Prior>> = priors.into_iter().zip(departures).map(|(p, d)| depart(p, d)).collect();
    let mut out = Structured {
        priors: Vec::new(),
        alternatives: vec![None; previous.len()],
        flexibility: flexibility.evidence,
        scales,
        correlation,
        groups,
    };
    let probability = |i: usize| flexibility.probability[i];
    let wanted = |(i, prior): (usize, &Option<Prior>)| prior.is_none() || probability(i) > NEGLIGIBLE;
    let wanted: Vec<bool> = priors.iter().enumerate().map(wanted).collect();
    let around = neighbourhoods(input, evidence, config, &wanted, &flexibility.noise, &mut out.scales)?;
    for (i, (prior, around)) in priors.into_iter().zip(around).enumerate() {
        let Some(prior) = prior.or(around) else { return Ok(None) };
        out.priors.push(prior);
        out.alternatives[i] = around.map(|around| (probability(i), around)).filter(|_| !prior.left);
    }
    Ok(Some(out))
}

/// Probability below which a Gaussian's alternative changes less than any other error.
const NEGLIGIBLE: f64 = 1e-3;

/// A prior moved by a departure.
fn depart(prior: Option<Prior>, departure: Option<Deviation>) -> Option<Prior> {
    let (prior, Some(departure)) = (prior?, departure) else { return prior };
    let covariance = prior.covariance + Symmetric::scalar(departure.variance);
    Some(Prior { mean: prior.mean + departure.offset, covariance, left: true, free: true, ..prior })
}

/// The motions of the neighbourhoods of those that want one, as far as anything was measured. `noise` (N, m^2) is what
/// all estimates of a neighbourhood share.
fn neighbourhoods(
    input: &FusionInput,
    evidence: &Evidence,
    config: &FusionConfig,
    wanted: &[bool],
    noise: &[Symmetric],
    scales: &mut Vec<Vec<f64>>,
) -> Result<Vec<Option<Prior>>, FusionError> {
    if !wanted.contains(&true) {
        return Ok(vec![None; wanted.len()]);
    }
    let (previous, ones) = (input.prior_means, vec![1.0; evidence.trackers()]);
    let combined: Vec<_> = (0..previous.len()).into_par_iter().map(|i| evidence.combined(i, &ones)).collect();
    let means: Vec<DVec3> = combined.iter().zip(previous).map(|(c, &p)| c.map_or(p, |c| c.mean)).collect();
    let covariances: Vec<DMat3> =
        combined.iter().map(|c| c.map_or(DMat3::ZERO, |c| c.covariance.into())).collect();
    let measured: Vec<bool> = combined.iter().map(Option::is_some).collect();
    let local = local_rigid_motion(previous, &means, &covariances, &measured, wanted, &config.rigid)?;
    let Some(local) = local else { return Ok(vec![None; wanted.len()]) };
    let row = scales.len();
    scales.push(vec![local.inflation; evidence.trackers()]);
    let own = |i: usize| Prior {
        mean: local.means[i],
        covariance: local.covariances[i].into(),
        rotation: local.rotations[i],
        scales: row,
        spread: 0.0,
        shared: noise[i],
        left: true,
        free: true,
    };
    Ok(wanted.iter().enumerate().map(|(i, wanted)| wanted.then(|| own(i))).collect())
}

/// Which Gaussians leave their group: a Gaussian's own evidence contradicts the group, and most of its neighbours' evidence is nearer to its
/// deviation than to none.
struct Outliers<'a> {
    previous: &'a [DVec3],
    evidence: &'a Evidence,
    priors: &'a [Option<Prior>],
    scales: &'a [Vec<f64>],
    leave: f64,
}

/// What the trackers of a Gaussian say together, as an offset from its prior.
type Offset = Option<Combined>;

/// How a Gaussian and the neighbours that agree with it deviate from the group.
#[derive(Clone, Copy)]
struct Deviation {
    /// Deviation (m).
    offset: DVec3,
    /// Its variance per axis among them (m^2).
    variance: f64,
}

impl Outliers<'_> {
    /// (N) departures; `None` for Gaussians that stay in their group.
    fn find(&self) -> Result<Vec<Option<Deviation>>, FusionError> {
        let offsets: Vec<Offset> = (0..self.priors.len()).into_par_iter().map(|i| self.offset(i)).collect();
        let suspects: Vec<bool> =
            (0..offsets.len()).into_par_iter().map(|i| self.contradicts(i, offsets[i])).collect();
        let measured: Vec<usize> = (0..offsets.len()).filter(|&i| offsets[i].is_some()).collect();
        if !suspects.contains(&true) {
            return Ok(vec![None; offsets.len()]);
        }
        let origin = self.previous[measured[0]];
        let local = |i: usize| (self.previous[i] - origin).to_array();
        let points: Vec<[f64; 3]> = measured.iter().map(|&i| local(i)).collect();
        let tree: ImmutableKdTree<f64, 3> =
            ImmutableKdTree::new_from_slice(&points).map_err(|e| FusionError::Index(format!("{e:?}")))?;
        let count = NonZero::new((COMPARED + 1).min(points.len())).unwrap_or(NonZero::<usize>::MIN);
        let departure = |i: usize| {
            let own = offsets[i].filter(|_| suspects[i])?.mean;
            let near = tree.query(&local(i)).nearest_n::<SquaredEuclidean<f64>>(count).execute();
            let compared = near.iter().map(|n| measured[n.item as usize]).filter(|&j| j != i);
            judge(own, compared.filter_map(|j| offsets[j]))
        };
        Ok((0..offsets.len()).into_par_iter().map(departure).collect())
    }

    fn offset(&self, i: usize) -> Offset {
        let prior = self.priors[i]?;
        let combined = self.evidence.combined(i, &self.scales[prior.scales])?;
        Some(Combined { mean: combined.mean - prior.mean, ..combined })
    }

    /// Whether all trackers together contradict the group, and each of them alone.
    fn contradicts(&self, i: usize, offset: Offset) -> bool {
        let (Some(prior), Some(offset)) = (&self.priors[i], offset) else { return false };
        let expected = prior.covariance + Symmetric::scalar(prior.spread);
        let distance = |e: DVec3, covariance: Symmetric| (covariance + expected).inverse().quadratic(e);
        let scales = &self.scales[prior.scales];
        let alone = |(l, told): (usize, &TrackerEstimate)| {
            distance(told.mean - prior.mean, told.information.inverse() * scales[l])
        };
        !(distance(offset.mean, offset.covariance) <= self.leave)
            && !self.evidence.of(i).map(alone).any(|d| d <= ALONE * self.leave)
    }
}

/// Share of the limit that every tracker alone must exceed: as the 90 % point, 6.25, of the 99 % point, 11.3.
const ALONE: f64 = 0.55;

/// The departure of a Gaussian with deviation `own`, if more than half of its neighbours side with it.
fn judge(own: DVec3, neighbours: impl Iterator<Item = Combined>) -> Option<Deviation> {
    let (mut siding, mut all) = (vec![own], 0);
    for Combined { mean: offset, information, .. } in neighbours {
        all += 1;
        if information.quadratic(offset - own) < information.quadratic(offset) {
            siding.push(offset);
        }
    }
    if 2 * (siding.len() - 1) <= all {
        return None;
    }
    let axis = |a: usize| median(siding.iter().map(|o| o[a])).unwrap_or(0.0);
    let offset = DVec3::new(axis(0), axis(1), axis(2));
    let squares: f64 = siding.iter().map(|o| o.distance_squared(offset)).sum();
    Some(Deviation { offset, variance: squares / (3 * siding.len()) as f64 })
}
