//! Validation by masks: a Gaussian of the dynamic layer has to lie in the masks of the views that see it (Algorithm 1, lines 35 to 40).

use crate::error::FusionError;
use crate::view_counts::{ViewCounts, count_views};
use ffgs_core::{Camera, Mask, median};
use glam::{DMat3, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// How many of the views that see a Gaussian may have it outside their mask.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slack {
    /// This many, however many see it (Algorithm 1, lines 35 to 40: 2).
    pub views: u32,
    /// And this share of those that see it, rounded down: one occluder stands before a share of the cameras.
    pub share: f64,
    /// Whether those that do not see it have it outside, too (Algorithm 1's V, word for word).
    pub all_views: bool,
}

impl Slack {
    /// Of `seen` views.
    pub fn of(self, seen: u32) -> u32 {
        // A tenth of ten views is one view, whatever the share's last bit.
        self.views + (self.share * f64::from(seen) + 1e-9) as u32
    }
}

/// Whether a Gaussian lies in the masks of all views that see it but for the slack, and of one at least (Algorithm 1,
/// lines 35 to 40, with V the views that see it: of hundreds of cameras only some see a car).
pub fn validate(counts: ViewCounts, slack: Slack) -> bool {
    counts.inside >= counts.seen.saturating_sub(slack.of(counts.seen)).max(1)
}

/// The masks of one time, as they decide what is foreground. Views with an empty mask have no say.
pub struct Silhouettes {
    /// Every camera.
    all: Vec<Camera>,
    /// Those that have a say.
    cameras: Vec<Camera>,
    /// Grown: a splat's mean may lie beside the mask that its footprint touches.
    masks: Vec<Mask>,
    /// Grown by what a mask may narrowly miss.
    wide: Vec<Mask>,
    slack: Slack,
}

/// Share of the longer side of an image by which a mask may narrowly miss an object, when few views see it.
const NARROW: f64 = 0.02;
/// Fewest views of which one may narrowly miss a Gaussian beyond the slack.
const FEW: u32 = 3;
/// Gaussians by which a mask is judged.
const SAMPLED: usize = 4096;
/// A mask lacks its object when more than this share of what all other masks hold lies outside it.
const LACKS: f64 = 0.5;
/// Fewest Gaussians for such a judgement.
const MIN_HELD: usize = 20;

impl Silhouettes {
    /// Of masks widened by `dilation` ([`Mask::widened`]).
    ///
    /// # Errors
    /// [`FusionError::Masks`] when the numbers of cameras and masks differ.
    pub fn new(
        cameras: &[Camera],
        masks: &[Mask],
        dilation: usize,
        slack: Slack,
    ) -> Result<Self, FusionError> {
        if cameras.len() != masks.len() {
            return Err(FusionError::Masks { cameras: cameras.len(), masks: masks.len() });
        }
        let used: Vec<(&Camera, &Mask)> = cameras.iter().zip(masks).filter(|v| v.1.count() > 0).collect();
        let narrow = |mask: &Mask| (NARROW * mask.size().width.max(mask.size().height) as f64) as usize;
        let grown = |by: &(dyn Fn(&Mask) -> usize + Sync)| {
            used.par_iter().map(|(_, mask)| mask.dilated(by(mask))).collect()
        };
        Ok(Self {
            all: cameras.to_vec(),
            cameras: used.iter().map(|v| *v.0).collect(),
            masks: grown(&|mask| mask.margin(dilation)),
            wide: grown(&|mask| narrow(mask).max(mask.margin(dilation))),
            slack,
        })
    }

    /// (N) whether they hold each mean (m): inside in all views that see it but for the slack. Where few views see it
    /// and the slack is nothing, one may miss it narrowly.
    ///
    /// # Errors
    /// As [`count_views`].
    pub fn hold(&self, means: &[DVec3]) -> Result<Vec<bool>, FusionError> {
        let counts = count_views(means, &self.cameras, &self.masks)?;
        let narrowly = count_views(means, &self.cameras, &self.wide)?;
        let voters = |count: ViewCounts| {
            let seen = if self.slack.all_views { self.cameras.len() as u32 } else { count.seen };
            ViewCounts { seen, ..count }
        };
        let held = |(count, wide): (&ViewCounts, ViewCounts)| {
            let [count, wide] = [*count, wide].map(voters);
            let narrow = count.seen >= FEW && wide.inside == wide.seen && count.inside + 1 == count.seen;
            validate(count, self.slack) || narrow
        };
        Ok(counts.iter().zip(narrowly).map(held).collect())
    }

    /// (N) whether any camera shows each mean (m), with or without a mask.
    pub fn shown(&self, means: &[DVec3]) -> Vec<bool> {
        let shown = |&mean: &DVec3| self.all.iter().any(|camera| camera.pixel_of(mean).is_some());
        means.par_iter().map(shown).collect()
    }

    /// Takes the vote from views whose mask lacks most of what all others hold of `means` (m): a mask that flickers.
    /// Returns their number.
    ///
    /// # Errors
    /// As [`count_views`].
    pub fn drop_flickering(&mut self, means: &[DVec3]) -> Result<usize, FusionError> {
        let stride = means.len().div_ceil(SAMPLED).max(1);
        let judges: Vec<DVec3> = means.iter().copied().step_by(stride).collect();
        let counts = count_views(&judges, &self.cameras, &self.masks)?;
        let lacks: Vec<bool> = (0..self.cameras.len()).map(|v| self.lacks(v, &judges, &counts)).collect();
        let dropped = lacks.iter().filter(|l| **l).count();
        for views in [&mut self.masks, &mut self.wide] {
            retain(views, &lacks);
        }
        retain(&mut self.cameras, &lacks);
        Ok(dropped)
    }

    fn lacks(&self, view: usize, judges: &[DVec3], counts: &[ViewCounts]) -> bool {
        let (mut held, mut outside) = (0, 0);
        for (&judge, count) in judges.iter().zip(counts) {
            let Some((x, y)) = self.cameras[view].pixel_of(judge) else { continue };
            let inside = self.masks[view].contains(x, y);
            let others = ViewCounts { inside: count.inside - u32::from(inside), seen: count.seen - 1 };
            if others.seen > 0 && validate(others, self.slack) {
                held += 1;
                outside += usize::from(!inside);
            }
        }
        held >= MIN_HELD && outside as f64 > LACKS * held as f64
    }
}

fn retain<T>(values: &mut Vec<T>, gone: &[bool]) {
    let mut gone = gone.iter();
    values.retain(|_| !gone.next().copied().unwrap_or(false));
}

/// Neighbours a second chance takes its motion from.
const NEIGHBOURS: usize = 8;

/// Gives every invalid Gaussian `previous + median displacement of its 8 nearest valid neighbours` (componentwise; by
/// distance at t-1), with the neighbours' mean covariance and the scatter of their displacements (m^2). Without valid Gaussians
/// nothing moves. The caller validates again and removes what still fails.
///
/// # Errors
/// [`FusionError`] when columns differ in length or the spatial index refuses the points.
pub fn second_chance(
    previous: &[DVec3],
    means: &mut [DVec3],
    covariances: &mut [DMat3],
    valid: &[bool],
) -> Result<(), FusionError> {
    crate::fuse::check_column("means", means.len(), previous.len())?;
    crate::fuse::check_column("covariances", covariances.len(), previous.len())?;
    crate::fuse::check_column("valid", valid.len(), previous.len())?;
    let donors: Vec<usize> = (0..valid.len()).filter(|&i| valid[i]).collect();
    let Some(&origin) = donors.first() else { return Ok(()) };
    // Relative to one donor: the index compares squared distances, which city-scale coordinates would blur.
    let local = |i: usize| (previous[i] - previous[origin]).to_array();
    let points: Vec<[f64; 3]> = donors.iter().map(|&i| local(i)).collect();
    let tree: ImmutableKdTree<f64, 3> =
        ImmutableKdTree::new_from_slice(&points).map_err(|e| FusionError::Index(format!("{e:?}")))?;
    let k = NonZero::new(NEIGHBOURS.min(donors.len())).unwrap_or(NonZero::<usize>::MIN);
    for i in (0..valid.len()).filter(|&i| !valid[i]) {
        let nearest = tree.query(&local(i)).nearest_n::<SquaredEuclidean<f64>>(k).execute();
        let near: Vec<usize> = nearest.iter().map(|n| donors[n.item as usize]).collect();
        let steps: Vec<DVec3> = near.iter().map(|&j| means[j] - previous[j]).collect();
        let middle = |axis: usize| median(steps.iter().map(|s| s[axis])).unwrap_or(0.0);
        let (step, count) = (DVec3::new(middle(0), middle(1), middle(2)), near.len() as f64);
        let scatter = steps.iter().map(|s| s.distance_squared(step)).sum::<f64>() / (3.0 * count);
        let around = near.iter().fold(DMat3::ZERO, |sum, &j| sum + covariances[j]) * count.recip();
        means[i] = previous[i] + step;
        covariances[i] = around + DMat3::from_diagonal(DVec3::splat(scatter));
    }
    Ok(())
}
