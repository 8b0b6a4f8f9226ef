use crate::config::FusionError;
use crate::process_noise::median;
use crate::view_counts::{ViewCounts, count_views};
use ffgs_core::{Camera, Mask};
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use std::num::NonZero;

/// Whether a Gaussian lies in the masks of at least `seen - slack` views, and of one at least (Algorithm 1, lines 35
/// to 40, with V the views that see it: of hundreds of cameras only some see a car).
pub fn validate(counts: ViewCounts, slack: u32) -> bool {
    counts.inside >= counts.seen.saturating_sub(slack).max(1)
}

/// Marks the dynamic Gaussians (Algorithm 1, line 2): inside the mask, dilated by `dilation` pixels, in at least
/// `V_i - slack` of the V_i views that see them and whose mask is not empty. Slack and dilation default to 2.
///
/// # Errors
/// As [`count_views`].
pub fn dynamic_split(
    means: &[DVec3],
    cameras: &[Camera],
    masks: &[Mask],
    dilation: usize,
    slack: u32,
) -> Result<Vec<bool>, FusionError> {
    if cameras.len() != masks.len() {
        return Err(FusionError::Masks { cameras: cameras.len(), masks: masks.len() });
    }
    let used = cameras.iter().zip(masks).filter(|(_, mask)| mask.count() > 0);
    let (cameras, masks): (Vec<Camera>, Vec<Mask>) = used.map(|(c, m)| (*c, m.dilated(dilation))).unzip();
    Ok(count_views(means, &cameras, &masks)?.into_iter().map(|c| validate(c, slack)).collect())
}

/// Neighbours a second chance takes its motion from.
const NEIGHBOURS: usize = 8;

/// Gives every invalid Gaussian `previous + median displacement of its 8 nearest valid neighbours` (componentwise; by
/// distance at t-1). Without valid Gaussians nothing moves. The caller validates again and removes what still fails.
///
/// # Errors
/// [`FusionError`] when columns differ in length or the spatial index refuses the points.
pub fn second_chance(previous: &[DVec3], means: &mut [DVec3], valid: &[bool]) -> Result<(), FusionError> {
    crate::fuse::check_column("means", means.len(), previous.len())?;
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
        let steps = nearest.iter().map(|n| donors[n.item as usize]).map(|j| means[j] - previous[j]);
        let steps: Vec<DVec3> = steps.collect();
        let middle =
            |axis: usize| median(&mut steps.iter().map(|s| s[axis]).collect::<Vec<_>>()).unwrap_or(0.0);
        means[i] = previous[i] + DVec3::new(middle(0), middle(1), middle(2));
    }
    Ok(())
}
