use crate::normal::Normal;
use crate::views::{RayWeights, Views};
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
/// Relative step (of the distance to the cameras) at which it has landed: a fifth of a pixel with f = 2000 px, where the
/// cut is 4 px.
const LANDED: f64 = 1e-4;
/// So many views do not agree by chance when they are three quarters of all.
const SURE: usize = 5;
/// Pairs of views tried when the re-weighted solution still has outliers. With 15 % outliers 72 % of pairs are clean.
const MAX_PAIRS: usize = 36;

/// A point near the views that agree with each other, from `start`.
///
/// Soft re-weighting first; when too many views remain beyond the cut, the intersections of pairs of views compete with
/// it on the truncated squared residual, because re-weighting cannot leave the basin of a gross outlier among few views.
pub fn locate(views: &mut Views, start: DVec3, scales: Scales) -> DVec3 {
    let soft = soften(views, start, scales.soft);
    let cut2 = scales.cut * scales.cut;
    let agreeing = views.errors(soft).filter(|e| *e <= cut2).count();
    if views.len() < 3 || agreeing == views.len() || (agreeing >= SURE && 4 * agreeing >= 3 * views.len()) {
        return soft;
    }
    let mut best = (views.truncated_cost(soft, cut2), soft);
    for (a, b) in pairs(views.len()) {
        if let Some(point) = intersect(views, a, b) {
            let cost = views.truncated_cost(point, cut2);
            if cost < best.0 {
                best = (cost, point);
            }
        }
    }
    let polished = soften(views, best.1, scales.soft);
    if views.truncated_cost(polished, cut2) <= best.0 { polished } else { best.1 }
}

/// Iteratively re-weighted rays with weights `1 / (1 + (r / scale)^2)`.
pub fn soften(views: &Views, start: DVec3, scale: f64) -> DVec3 {
    let mut point = start;
    for _ in 0..SOFT_STEPS {
        let Some(next) = views.rays(point, RayWeights::Soft(scale)).solve() else { break };
        let step = next - point;
        point = next;
        if step.length() <= LANDED * views.scale {
            break;
        }
    }
    point
}

/// Point nearest to two rays: `W_a + W_b` is singular only where they are parallel.
fn intersect(views: &Views, a: usize, b: usize) -> Option<DVec3> {
    let mut normal = Normal { a: [2.0, 0.0, 0.0, 2.0, 0.0, 2.0], b: [0.0; 3] };
    let mut sum = DVec3::ZERO;
    for view in [a, b] {
        let (d, c) = (views.ray(view), views.center(view));
        let products = [d.x * d.x, d.x * d.y, d.x * d.z, d.y * d.y, d.y * d.z, d.z * d.z];
        normal.a.iter_mut().zip(products).for_each(|(entry, product)| *entry -= product);
        sum += c - d * d.dot(c);
    }
    Normal { b: sum.to_array(), ..normal }.solve()
}

/// All pairs of `n` views, thinned evenly to at most [`MAX_PAIRS`].
fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    let total = n * (n - 1) / 2;
    let stride = total.div_ceil(MAX_PAIRS).max(1);
    let all = (1..n).flat_map(move |gap| (0..n - gap).map(move |a| (a, a + gap)));
    all.step_by(stride)
}
