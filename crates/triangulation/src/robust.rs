//! The robust start of a triangulation: which views agree with each other, and where.

use crate::normal::Normal;
use crate::passes::{Agreement, RayWeights, squared_error};
use crate::simd::{F64s, LaneMask, Lanes, MAX_LANES, all3, dot, minus};
use crate::views::{LensLanes, Views};
use pulp::{Simd, WithSimd};

/// Residual scales of the robust steps (px).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scales {
    /// Scale of the soft weights.
    pub soft: f64,
    /// Residual beyond which a view is an outlier.
    pub cut: f64,
}

/// Iterations of the soft re-weighting; it only has to end in the basin of the inliers.
const SOFT_STEPS: usize = 6;
/// Relative step (of the distance to the cameras) at which it has converged: a fifth of a pixel with f = 2000 px, where the
/// cut is 4 px.
const CONVERGED: f64 = 1e-4;
/// From so many views on, three quarters of them that agree are taken for the inliers: chance does not bring that about.
const MAJORITY_VIEWS: f64 = 5.0;
/// Pairs of views tried when the re-weighted solution still has outliers. With 15 % outliers 72 % of pairs are clean.
const MAX_PAIRS: usize = 36;

/// Points near the views that agree with each other, from `start`, in the given lanes, and the residuals there.
///
/// Soft re-weighting first; when too many views remain beyond the cut, the intersections of pairs of views compete with
/// it on the truncated squared residual, because re-weighting cannot leave the basin of a gross outlier among few views.
#[inline(always)]
pub(crate) fn locate<S: Simd>(
    views: &Views<S>,
    lanes: LaneMask<S>,
    start: [F64s<S>; 3],
    scales: Scales,
) -> ([F64s<S>; 3], Agreement<S>) {
    let soft = reweight(views, lanes, start, scales.soft);
    let cut2 = views.number(scales.cut * scales.cut);
    let agreement = views.agreement(soft, cut2);
    let most = agreement.agreeing.gt(views.number(MAJORITY_VIEWS - 1.0))
        & (views.number(3.0) * views.count).le(views.number(4.0) * agreement.agreeing);
    let sure = views.number(3.0).gt(views.count) | views.count.le(agreement.agreeing) | most;
    let unsure = lanes.and_not(sure);
    if !unsure.any() {
        return (soft, agreement);
    }
    let (mut best, mut least) = (soft, agreement.truncated);
    for lane in unsure.lanes() {
        let found = views.simd.vectorize(PairSearch { views, lane, cut2: scales.cut * scales.cut, least });
        if let Some((point, cost)) = found {
            least.set_lane(lane, cost);
            (0..3).for_each(|axis| best[axis].set_lane(lane, point[axis]));
        }
    }
    let polished = reweight(views, unsure, best, scales.soft);
    let better = views.agreement(polished, cut2).truncated.le(least);
    let point = better.select3(polished, best);
    (point, views.agreement(point, cut2))
}

/// Iteratively re-weighted rays with weights `1 / (1 + (r / scale)^2)`, in the given lanes.
#[inline(always)]
pub(crate) fn reweight<S: Simd>(
    views: &Views<S>,
    lanes: LaneMask<S>,
    start: [F64s<S>; 3],
    scale: f64,
) -> [F64s<S>; 3] {
    let weights = RayWeights::Soft(views.number(1.0 / (scale * scale)));
    let near = views.number(CONVERGED) * views.scale;
    let (mut point, mut moving) = (start, lanes);
    for _ in 0..SOFT_STEPS {
        let (next, solved) = views.meet(point, weights).solve(views.simd);
        moving = moving & solved;
        let step = minus(next, point);
        point = moving.select3(next, point);
        moving = moving.and_not(dot(step, step).sqrt().le(near));
        if !moving.any() {
            break;
        }
    }
    point
}

/// A view of the one Gaussian at hand.
struct ViewRay {
    view_camera: usize,
    target: [f64; 2],
    weight: f64,
    ray: [f64; 3],
    center: [f64; 3],
}

/// The best intersection of two views of one lane's Gaussian, if it is better than `least`: here a pair is a lane.
struct PairSearch<'a, 'b, S: Simd> {
    views: &'a Views<'b, S>,
    lane: usize,
    cut2: f64,
    least: F64s<S>,
}

impl<S: Simd> WithSimd for PairSearch<'_, '_, S> {
    type Output = Option<([f64; 3], f64)>;

    #[inline(always)]
    fn with_simd<T: Simd>(self, _: T) -> Self::Output {
        let view_rays = self.view_rays();
        let mut pairs = Pairs::of(view_rays.len());
        let (mut least, mut best) = (self.least.lane(self.lane), None);
        loop {
            let mut batch = [(0, 0); MAX_LANES];
            let mut used = 0;
            while used < S::F64_LANES {
                let Some(pair) = pairs.next() else { break };
                batch[used] = pair;
                used += 1;
            }
            if used == 0 {
                return best;
            }
            let (points, sound) = self.intersect(&view_rays, &batch);
            let costs = self.truncated(&view_rays, points, least).to_lanes();
            for lane in sound.lanes() {
                if lane < used && costs[lane] < least {
                    least = costs[lane];
                    best = Some(([points[0].lane(lane), points[1].lane(lane), points[2].lane(lane)], least));
                }
            }
        }
    }
}

impl<S: Simd> PairSearch<'_, '_, S> {
    #[inline(always)]
    fn previous(&self) -> [f64; 3] {
        let [x, y, z] = self.views.previous;
        [x.lane(self.lane), y.lane(self.lane), z.lane(self.lane)]
    }

    #[inline(always)]
    fn view_rays(&self) -> Vec<ViewRay> {
        let Self { views, lane, .. } = *self;
        let origin = self.previous();
        let mut out = Vec::with_capacity(views.rows.len());
        for row in &views.rows {
            let weight = row.weight.lane(lane);
            if weight > 0.0 {
                let target = [row.target[0].lane(lane), row.target[1].lane(lane)];
                let ray = [row.ray[0].lane(lane), row.ray[1].lane(lane), row.ray[2].lane(lane)];
                let center = views.view_cameras[row.view_camera].center_from(origin);
                out.push(ViewRay { view_camera: row.view_camera, target, weight, ray, center });
            }
        }
        out
    }

    /// Points nearest to two rays: `W_a + W_b` is singular only where they are parallel.
    #[inline(always)]
    fn intersect(
        &self,
        view_rays: &[ViewRay],
        pairs: &[(usize, usize); MAX_LANES],
    ) -> ([F64s<S>; 3], LaneMask<S>) {
        let simd = self.views.simd;
        let mut normal = Normal::zero(simd);
        for side in 0..2 {
            let (mut ray, mut center): ([Lanes; 3], [Lanes; 3]) = Default::default();
            for lane in 0..S::F64_LANES {
                let sight = &view_rays[if side == 0 { pairs[lane].0 } else { pairs[lane].1 }];
                for axis in 0..3 {
                    ray[axis][lane] = sight.ray[axis];
                    center[axis][lane] = sight.center[axis];
                }
            }
            let zero = F64s::all(simd, 0.0);
            let (mut d, mut c) = ([zero; 3], [zero; 3]);
            for axis in 0..3 {
                d[axis] = F64s::from_lanes(simd, &ray[axis]);
                c[axis] = F64s::from_lanes(simd, &center[axis]);
            }
            normal.add_line(d, c, F64s::all(simd, 1.0));
        }
        normal.solve(simd)
    }

    /// `sum w min(r^2, cut^2)` of each point; it only grows, so the rest is left out where no point is better than `least`.
    #[inline(always)]
    fn truncated(&self, view_rays: &[ViewRay], points: [F64s<S>; 3], least: f64) -> F64s<S> {
        let simd = self.views.simd;
        let cut2 = F64s::all(simd, self.cut2);
        let mut cost = F64s::all(simd, 0.0);
        for (k, sight) in view_rays.iter().enumerate() {
            if k % 8 == 0 && !F64s::all(simd, least).gt(cost).any() {
                break;
            }
            let view_camera = LensLanes {
                center: all3(simd, sight.center),
                ..LensLanes::new(simd, &self.views.view_cameras[sight.view_camera], [cost; 3])
            };
            let target = [F64s::all(simd, sight.target[0]), F64s::all(simd, sight.target[1])];
            let error = squared_error(
                simd,
                &view_camera,
                target,
                view_camera.turn(minus(points, view_camera.center)),
            );
            cost = F64s::all(simd, sight.weight).mul_add(cut2.gt(error).select(error, cut2), cost);
        }
        cost
    }
}

/// All pairs of `n` views, neighbours first, thinned evenly to at most [`MAX_PAIRS`].
struct Pairs {
    views: usize,
    stride: usize,
    gap: usize,
    a: usize,
}

impl Pairs {
    fn of(views: usize) -> Self {
        let all = views * (views - 1) / 2;
        Self { views, stride: all.div_ceil(MAX_PAIRS).max(1), gap: 1, a: 0 }
    }
}

impl Iterator for Pairs {
    type Item = (usize, usize);

    #[inline(always)]
    fn next(&mut self) -> Option<(usize, usize)> {
        while self.gap < self.views && self.a >= self.views - self.gap {
            self.a -= self.views - self.gap;
            self.gap += 1;
        }
        let pair = (self.a, self.a + self.gap);
        self.a += self.stride;
        (self.gap < self.views).then_some(pair)
    }
}
