use crate::rays;
use crate::views::View;
use glam::DVec3;

/// Residual scales of the robust steps (px).
#[derive(Clone, Copy, Debug)]
pub struct Scales {
    /// Scale of the soft weights.
    pub soft: f64,
    /// Residual beyond which a view is an outlier.
    pub cut: f64,
}

/// Iterations of the soft re-weighting; it only has to land in the basin of the inliers.
const SOFT_STEPS: usize = 6;
/// So many views do not agree by chance when they are three quarters of all.
const SURE: usize = 5;
/// Pairs of views tried when the re-weighted solution still has outliers. With 15 % outliers 72 % of pairs are clean.
const MAX_PAIRS: usize = 36;

/// A point near the views that agree with each other, from `start`.
///
/// Soft re-weighting first; when too many views remain beyond the cut, the intersections of pairs of views compete with
/// it on the truncated squared residual, because re-weighting cannot leave the basin of a gross outlier among few views.
pub fn locate(views: &[View], start: DVec3, scales: Scales) -> DVec3 {
    let soft = soften(views, start, scales.soft);
    let cut2 = scales.cut * scales.cut;
    let agreeing = views.iter().filter(|v| v.error_squared(soft) <= cut2).count();
    if views.len() < 3 || agreeing == views.len() || (agreeing >= SURE && 4 * agreeing >= 3 * views.len()) {
        return soft;
    }
    let mut best = (truncated_cost(views, soft, cut2), soft);
    for (a, b) in pairs(views.len()) {
        if let Some(point) = intersect(&views[a], &views[b]) {
            let cost = truncated_cost(views, point, cut2);
            if cost < best.0 {
                best = (cost, point);
            }
        }
    }
    let polished = soften(views, best.1, scales.soft);
    if truncated_cost(views, polished, cut2) <= best.0 { polished } else { best.1 }
}

/// Iteratively re-weighted rays with weights `1 / (1 + (r / scale)^2)`.
pub fn soften(views: &[View], start: DVec3, scale: f64) -> DVec3 {
    let mut point = start;
    for _ in 0..SOFT_STEPS {
        let weight = |v: &View| {
            rays::pixels_per_metre_squared(v, point) / (1.0 + v.error_squared(point) / (scale * scale))
        };
        match rays::solve(views, weight) {
            Some(next) => point = next,
            None => break,
        }
    }
    point
}

fn truncated_cost(views: &[View], point: DVec3, cut2: f64) -> f64 {
    views.iter().map(|v| v.weight * v.error_squared(point).min(cut2)).sum()
}

fn intersect(a: &View, b: &View) -> Option<DVec3> {
    let pair = [View { weight: 1.0, ..*a }, View { weight: 1.0, ..*b }];
    rays::solve(&pair, |_| 1.0)
}

/// All pairs of `n` views, thinned evenly to at most [`MAX_PAIRS`].
fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    let total = n * (n - 1) / 2;
    let stride = total.div_ceil(MAX_PAIRS).max(1);
    let all = (1..n).flat_map(move |gap| (0..n - gap).map(move |a| (a, a + gap)));
    all.step_by(stride)
}
