//! The loops over views.

use crate::normal::Normal;
use crate::simd::{F64s, LaneMask, dot, minus};
use crate::views::{LensLanes, Row, Views};
use pulp::{Simd, WithSimd};

/// Twice the cut, squared: the first guess is not refined yet, and a view lost there never returns.
pub(crate) const NEAR2: f64 = 4.0;

/// How rays are weighted at a point.
#[derive(Clone, Copy)]
pub(crate) enum RayWeights<S: Simd> {
    /// By the observations' weights alone.
    Plain,
    /// Times `(f / z)^2`, which turns squared distances to the ray into px^2.
    Depth,
    /// That over `1 + (r / scale)^2`, the residual against a scale (px).
    Soft(F64s<S>),
}

/// A normal system with the cost it came from, at a point.
#[derive(Clone, Copy)]
pub(crate) struct Fit<S: Simd> {
    pub point: [F64s<S>; 3],
    pub normal: Normal<S>,
    /// Weighted sum of squared residuals (px^2).
    pub cost: F64s<S>,
    /// The largest squared residual (px^2) and its row.
    pub worst: F64s<S>,
    pub worst_row: F64s<S>,
    /// The next largest.
    pub second: F64s<S>,
    /// At most this squared (px^2/m^2) changes a projection, per metre, about the point: the largest `|J|^2` of a view.
    pub reach2: F64s<S>,
}

/// How many views agree on a point.
#[derive(Clone, Copy)]
pub(crate) struct Agreement<S: Simd> {
    /// Views within the cut.
    pub agreeing: F64s<S>,
    /// Views within twice the cut.
    pub near: F64s<S>,
    /// Views in front of whose camera the point is.
    pub in_front: F64s<S>,
    /// `sum w min(r^2, cut^2)`.
    pub truncated: F64s<S>,
    /// The largest squared residual (px^2), infinite behind a camera, and its row.
    pub worst: F64s<S>,
    pub worst_row: F64s<S>,
}

impl<S: Simd> Views<'_, S> {
    #[inline(always)]
    fn view_camera(&self, row: &Row<S>) -> LensLanes<S> {
        LensLanes::new(self.simd, &self.view_cameras[row.view_camera], self.previous)
    }

    /// Weighted meeting point of the rays as a normal system (Algorithm 1, line 23): `A = sum w W`, `b = sum w W c`,
    /// `W = I - d d^T`, with the weights of `point`.
    #[inline(always)]
    pub(crate) fn meet(&self, point: [F64s<S>; 3], weights: RayWeights<S>) -> Normal<S> {
        self.simd.vectorize(RayPass { views: self, point, weights })
    }

    /// `sum w J^T J`, `sum w J^T r` of the projections at `point`, and the residuals; and where the point is behind one of
    /// the cameras: then the rest is of the other views.
    #[inline(always)]
    pub(crate) fn reproject(&self, point: [F64s<S>; 3]) -> (Fit<S>, LaneMask<S>) {
        self.simd.vectorize(ReprojectionPass { views: self, point })
    }

    /// The residuals at a point.
    #[inline(always)]
    pub(crate) fn agreement(&self, point: [F64s<S>; 3], cut2: F64s<S>) -> Agreement<S> {
        self.simd.vectorize(AgreementPass { views: self, point, cut2 })
    }

    /// Removes the worst view of the lanes and takes its share out of the fit's sums; which view is the worst now is not
    /// known then.
    #[inline(always)]
    pub(crate) fn remove_worst(&mut self, lanes: LaneMask<S>, fit: &mut Fit<S>) {
        let zero = self.number(0.0);
        let mut gone = Fit { normal: Normal::zero(self.simd), cost: zero, ..*fit };
        for lane in lanes.lanes() {
            let k = fit.worst_row.lane(lane) as usize;
            let mut row = Row { weight: zero, ..self.rows[k] };
            row.weight.set_lane(lane, self.rows[k].weight.lane(lane));
            self.rows[k].weight.set_lane(lane, 0.0);
            add_view(self.simd, &self.view_camera(&row), &row, fit.point, &mut gone);
        }
        self.count = lanes.select(self.count - self.number(1.0), self.count);
        for k in 0..6 {
            fit.normal.a[k] = fit.normal.a[k] - gone.normal.a[k];
        }
        fit.normal.b = minus(fit.normal.b, gone.normal.b);
        // With what rounding may have taken from a small rest.
        let rest = (fit.cost - gone.cost) + fit.cost * self.number(1e-13);
        fit.cost = lanes.select(rest, fit.cost);
    }

    /// Removes the views whose squared residual at `point` is not within the limit.
    #[inline(always)]
    pub(crate) fn remove_beyond(&mut self, lanes: LaneMask<S>, point: [F64s<S>; 3], limit2: F64s<S>) {
        let (zero, one) = (self.number(0.0), self.number(1.0));
        for k in 0..self.rows.len() {
            let row = self.rows[k];
            let view_camera = self.view_camera(&row);
            let error = squared_error(
                self.simd,
                &view_camera,
                row.target,
                view_camera.turn(minus(point, view_camera.center)),
            );
            let gone = (lanes & row.weight.gt(zero)).and_not(error.le(limit2));
            self.rows[k].weight = gone.select(zero, row.weight);
            self.count = self.count - gone.select(one, zero);
        }
    }

    /// Appends the squared residuals (px^2) of the views, times their weight, corrected for the three fitted coordinates,
    /// Gaussian by Gaussian.
    #[inline(always)]
    pub(crate) fn push_errors(&self, lanes: LaneMask<S>, point: [F64s<S>; 3], out: &mut Vec<f64>) {
        let mut errors = Vec::with_capacity(self.rows.len());
        let twice = self.count + self.count;
        let correction = twice / (twice - self.number(3.0));
        for row in &self.rows {
            let view_camera = self.view_camera(row);
            let error = squared_error(
                self.simd,
                &view_camera,
                row.target,
                view_camera.turn(minus(point, view_camera.center)),
            );
            errors.push(row.weight * error * correction);
        }
        for lane in lanes.lanes() {
            for (row, error) in self.rows.iter().zip(&errors) {
                if row.weight.lane(lane) > 0.0 {
                    out.push(error.lane(lane));
                }
            }
        }
    }

    /// Weighted squared distances to the rays in pixels, infinite behind a camera.
    #[inline(always)]
    pub(crate) fn ray_cost(&self, point: [F64s<S>; 3]) -> F64s<S> {
        let (zero, infinity) = (self.number(0.0), self.number(f64::INFINITY));
        let mut cost = zero;
        for row in &self.rows {
            let (view_camera, ray) = (self.view_camera(row), row.ray);
            let offset = minus(point, view_camera.center);
            let z = dot(view_camera.rotation[2], offset);
            let along = dot(ray, offset);
            // The vector, not the difference of squares: that would round to less than nothing.
            let across = minus(offset, [ray[0] * along, ray[1] * along, ray[2] * along]);
            let focal2 = view_camera.focal[0] * view_camera.focal[1];
            let pixels2 = dot(across, across) * focal2 / squared_depth(self.simd, z, offset);
            let pixels2 = z.gt(zero).select(pixels2, infinity);
            cost = cost + row.weight.gt(zero).select(row.weight * pixels2, zero);
        }
        cost
    }
}

/// Squared residual (px^2) of a point in camera coordinates; infinite behind the camera.
#[inline(always)]
pub(crate) fn squared_error<S: Simd>(
    simd: S,
    view_camera: &LensLanes<S>,
    target: [F64s<S>; 2],
    [x, y, z]: [F64s<S>; 3],
) -> F64s<S> {
    let near = F64s::all(simd, 1.0) / z;
    let dx = target[0] - view_camera.focal[0] * (x * near);
    let dy = target[1] - view_camera.focal[1] * (y * near);
    z.gt(F64s::all(simd, 0.0)).select(dx.mul_add(dx, dy * dy), F64s::all(simd, f64::INFINITY))
}

/// Square of the depth that turns metres into pixels. A point behind the camera or beside it takes its distance: the first
/// guess may be that bad and still be mended by the other views.
#[inline(always)]
fn squared_depth<S: Simd>(simd: S, z: F64s<S>, offset: [F64s<S>; 3]) -> F64s<S> {
    let zero = F64s::all(simd, 0.0);
    let distance2 = dot(offset, offset).max(F64s::all(simd, 1e-18));
    let depth2 = z.gt(zero).select(z * z, zero);
    depth2.gt(F64s::all(simd, 0.05 * 0.05) * distance2).select(depth2, distance2)
}

struct RayPass<'a, 'b, S: Simd> {
    views: &'a Views<'b, S>,
    point: [F64s<S>; 3],
    weights: RayWeights<S>,
}

impl<S: Simd> RayPass<'_, '_, S> {
    /// Observed weight times `(f / z)^2` and the soft weight.
    #[inline(always)]
    fn weight(&self, row: &Row<S>, view_camera: &LensLanes<S>) -> F64s<S> {
        let one = self.views.number(1.0);
        let offset = minus(self.point, view_camera.center);
        let seen = view_camera.turn(offset);
        let mut below = squared_depth(self.views.simd, seen[2], offset);
        if let RayWeights::Soft(per_scale2) = self.weights {
            // Behind the camera this is infinite and the weight 0.
            below =
                below * (one + squared_error(self.views.simd, view_camera, row.target, seen) * per_scale2);
        }
        let weight = row.weight * view_camera.focal[0] * view_camera.focal[1] / below;
        let zero = self.views.number(0.0);
        row.weight.gt(zero).select(weight, zero)
    }
}

impl<S: Simd> WithSimd for RayPass<'_, '_, S> {
    type Output = Normal<S>;

    #[inline(always)]
    fn with_simd<T: Simd>(self, _: T) -> Normal<S> {
        let mut normal = Normal::zero(self.views.simd);
        for row in &self.views.rows {
            let view_camera = self.views.view_camera(row);
            let weight = if let RayWeights::Plain = self.weights {
                row.weight
            } else {
                self.weight(row, &view_camera)
            };
            normal.add_line(row.ray, view_camera.center, weight);
        }
        normal
    }
}

/// Adds a view to the sums of a fit, where the point is in front of its camera; its squared residual (px^2).
#[inline(always)]
fn add_view<S: Simd>(
    simd: S,
    view_camera: &LensLanes<S>,
    row: &Row<S>,
    point: [F64s<S>; 3],
    fit: &mut Fit<S>,
) -> (F64s<S>, LaneMask<S>) {
    let (zero, one) = (F64s::all(simd, 0.0), F64s::all(simd, 1.0));
    let [x, y, z] = view_camera.turn(minus(point, view_camera.center));
    let seen = row.weight.gt(zero) & z.gt(zero);
    let weight = seen.select(row.weight, zero);
    let near = one / seen.select(z, one);
    let (mut error2, mut reach2) = (zero, zero);
    for (axis, slope) in [(0, x * near), (1, y * near)] {
        let (across, away, focal) =
            (view_camera.rotation[axis], view_camera.rotation[2], view_camera.focal[axis]);
        let error = slope.neg_mul_add(focal, row.target[axis]);
        // The derivative is `focal / z` times this.
        let j = [
            slope.neg_mul_add(away[0], across[0]),
            slope.neg_mul_add(away[1], across[1]),
            slope.neg_mul_add(away[2], across[2]),
        ];
        let scale = focal * near;
        let scale2 = scale * scale;
        fit.normal.add_row(j, weight * scale2, weight * scale * error);
        error2 = error.mul_add(error, error2);
        reach2 = scale2.mul_add(slope.mul_add(slope, one), reach2);
    }
    fit.reach2 = seen.select(fit.reach2.max(reach2), fit.reach2);
    fit.cost = weight.mul_add(error2, fit.cost);
    (error2, seen)
}

struct ReprojectionPass<'a, 'b, S: Simd> {
    views: &'a Views<'b, S>,
    point: [F64s<S>; 3],
}

impl<S: Simd> WithSimd for ReprojectionPass<'_, '_, S> {
    type Output = (Fit<S>, LaneMask<S>);

    #[inline(always)]
    fn with_simd<T: Simd>(self, _: T) -> (Fit<S>, LaneMask<S>) {
        let Self { views, point } = self;
        let simd = views.simd;
        let zero = F64s::all(simd, 0.0);
        let mut fit = Fit {
            point,
            normal: Normal::zero(simd),
            cost: zero,
            worst: zero,
            worst_row: zero,
            second: zero,
            reach2: zero,
        };
        let mut hidden = LaneMask::nowhere(simd);
        for (k, row) in views.rows.iter().enumerate() {
            let (error2, seen) = add_view(simd, &views.view_camera(row), row, point, &mut fit);
            hidden = hidden | row.weight.gt(zero).and_not(seen);
            let worse = seen & fit.worst.le(error2);
            fit.second = seen.select(worse.select(fit.worst, error2.max(fit.second)), fit.second);
            fit.worst = worse.select(error2, fit.worst);
            fit.worst_row = worse.select(F64s::all(simd, k as f64), fit.worst_row);
        }
        (fit, hidden)
    }
}

struct AgreementPass<'a, 'b, S: Simd> {
    views: &'a Views<'b, S>,
    point: [F64s<S>; 3],
    cut2: F64s<S>,
}

impl<S: Simd> WithSimd for AgreementPass<'_, '_, S> {
    type Output = Agreement<S>;

    #[inline(always)]
    fn with_simd<T: Simd>(self, _: T) -> Agreement<S> {
        let Self { views, point, cut2 } = self;
        let (zero, one, infinity) = (views.number(0.0), views.number(1.0), views.number(f64::INFINITY));
        let limit2 = views.number(NEAR2) * cut2;
        let mut out = Agreement {
            agreeing: zero,
            near: zero,
            in_front: zero,
            truncated: zero,
            worst: zero,
            worst_row: zero,
        };
        for (k, row) in views.rows.iter().enumerate() {
            let view_camera = views.view_camera(row);
            let error = squared_error(
                views.simd,
                &view_camera,
                row.target,
                view_camera.turn(minus(point, view_camera.center)),
            );
            let counts = row.weight.gt(zero);
            out.agreeing = out.agreeing + (counts & error.le(cut2)).select(one, zero);
            out.near = out.near + (counts & error.le(limit2)).select(one, zero);
            out.in_front = out.in_front + (counts & infinity.gt(error)).select(one, zero);
            let truncated = cut2.gt(error).select(error, cut2);
            out.truncated = row.weight.mul_add(truncated, out.truncated);
            let worse = counts & out.worst.le(error);
            out.worst = worse.select(error, out.worst);
            out.worst_row = worse.select(views.number(k as f64), out.worst_row);
        }
        out
    }
}
