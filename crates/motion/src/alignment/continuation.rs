//! The motion that a group would have if it went on as in the last frame.

use ffgs_fusion::{Groups, RigidMotion, fit_rigid};
use glam::DVec3;

/// Gaussians of a group that its motion is fitted to at most.
const MOST: usize = 2048;
/// Fewest.
const LEAST: usize = 16;
/// Rounds of the robust fit.
const ROUNDS: usize = 4;
/// Residuals beyond so many of their median lose their weight (Geman and McClure's).
const REACH: f64 = 2.0;

/// Per group the rigid motion of its members from t-2 to t-1, once more: the same turn about the moved centre, and the step
/// turned along. `places` and `steps` (N, m) are where Gaussians are at t-1 and how far they came.
pub(crate) fn continued(groups: &Groups, places: &[DVec3], steps: &[DVec3]) -> Vec<Option<RigidMotion>> {
    let mut members = vec![Vec::new(); groups.found.len()];
    groups.of.iter().enumerate().filter_map(|(i, g)| Some((i, (*g)?))).for_each(|(i, g)| members[g].push(i));
    members.iter().map(|members| last_motion(members, places, steps).map(once_more)).collect()
}

fn once_more(last: RigidMotion) -> RigidMotion {
    RigidMotion { centre: last.centre + last.step, step: last.rotation * last.step, ..last }
}

/// From t-2 to t-1.
fn last_motion(members: &[usize], places: &[DVec3], steps: &[DVec3]) -> Option<RigidMotion> {
    let stride = members.len().div_ceil(MOST).max(1);
    let chosen = || members.iter().step_by(stride).filter(|&&i| steps[i].is_finite());
    let to: Vec<DVec3> = chosen().map(|&i| places[i]).collect();
    let from: Vec<DVec3> = chosen().map(|&i| places[i] - steps[i]).collect();
    if to.len() < LEAST {
        return None;
    }
    let mut weights = vec![1.0; to.len()];
    let mut motion = None;
    for _ in 0..ROUNDS {
        let fit = fit_rigid(&from, &to, &weights)?;
        let residuals: Vec<f64> = from.iter().zip(&to).map(|(a, b)| fit.apply(*a).distance(*b)).collect();
        let mut sorted = residuals.clone();
        let half = sorted.len() / 2;
        let median = *sorted.select_nth_unstable_by(half, f64::total_cmp).1;
        motion = Some(fit);
        if !(median > 0.0) {
            break;
        }
        let weight = |r: &f64| (1.0 + (r / (REACH * median)).powi(2)).powi(-2);
        weights = residuals.iter().map(weight).collect();
    }
    motion
}
