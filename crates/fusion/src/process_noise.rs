//! The process noise, learnt per frame: how far Gaussians went from where the prior expected them.

use ffgs_core::{EstimateStatus, Estimates, median};
use glam::DVec3;
use std::collections::BTreeMap;

/// Median distance of the successful estimates from where the prior expects the Gaussian (m); `None` without any.
pub(crate) fn median_displacement(predicted: &[DVec3], estimates: &[Estimates]) -> Option<f64> {
    median(displacements(predicted, estimates).map(|(_, d)| d))
}

/// [`median_displacement`] within each group.
pub(crate) fn per_group(predicted: &[DVec3], estimates: &[Estimates], groups: &[u32]) -> BTreeMap<u32, f64> {
    let mut all: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for (i, d) in displacements(predicted, estimates) {
        all.entry(groups[i]).or_default().push(d);
    }
    all.into_iter().filter_map(|(group, values)| Some((group, median(values)?))).collect()
}

fn displacements<'a>(
    predicted: &'a [DVec3],
    estimates: &'a [Estimates],
) -> impl Iterator<Item = (usize, f64)> + 'a {
    estimates.iter().flat_map(move |e| {
        let valid = (0..predicted.len()).filter(|&i| e.status[i] == EstimateStatus::Ok);
        valid.map(move |i| (i, (e.means[i] - predicted[i]).length()))
    })
}
