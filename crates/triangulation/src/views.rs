//! The views of several Gaussians side by side: one Gaussian per SIMD lane, one view per row.

use crate::simd::{F64s, LaneMask, Lanes, MAX_LANES, all3, dot, minus};
use ffgs_core::{Camera, Observations};
use glam::{DMat3, DVec2, DVec3};
use pulp::Simd;

/// A camera as the passes over Gaussians need it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ViewCamera {
    rotation: DMat3,
    center: DVec3,
    focal: DVec2,
    principal: DVec2,
}

impl From<&Camera> for ViewCamera {
    fn from(camera: &Camera) -> Self {
        let k = camera.intrinsics();
        Self {
            rotation: camera.rotation(),
            center: camera.center(),
            focal: DVec2::new(k.fx, k.fy),
            principal: DVec2::new(k.cx, k.cy),
        }
    }
}

impl ViewCamera {
    /// Its centre relative to a point (m).
    #[inline(always)]
    pub(crate) fn center_from(&self, origin: [f64; 3]) -> [f64; 3] {
        [self.center.x - origin[0], self.center.y - origin[1], self.center.z - origin[2]]
    }
}

/// One view of all lanes' Gaussians.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Row<S: Simd> {
    /// Its camera.
    pub view_camera: usize,
    /// Target less principal point (px); 0 where unobserved.
    pub target: [F64s<S>; 2],
    /// Unit viewing ray through the target; 0 where it was not asked for.
    pub ray: [F64s<S>; 3],
    /// Observation weight, scaled to mean 1 over the Gaussian's views; 0 = unobserved or removed.
    pub weight: F64s<S>,
}

/// The views of one Gaussian per SIMD lane, relative to its previous mean. Lanes are independent: results do
/// not depend on batching.
pub(crate) struct Views<'a, S: Simd> {
    pub simd: S,
    pub view_cameras: &'a [ViewCamera],
    /// The views that any lane's Gaussian was observed in, in order.
    pub rows: Vec<Row<S>>,
    /// Previous means (m).
    pub previous: [F64s<S>; 3],
    /// Number of views left.
    pub count: F64s<S>,
    /// Distance of the farthest camera (m).
    pub scale: F64s<S>,
    /// The shortest focal length of all view_cameras (px).
    pub least_focal: f64,
}

/// A camera in all lanes.
#[derive(Clone, Copy)]
pub(crate) struct LensLanes<S: Simd> {
    /// Rows of the rotation of `camera_from_world`.
    pub rotation: [[F64s<S>; 3]; 3],
    /// Centre relative to the previous mean (m).
    pub center: [F64s<S>; 3],
    /// Focal lengths (px).
    pub focal: [F64s<S>; 2],
}

impl<S: Simd> LensLanes<S> {
    #[inline(always)]
    pub(crate) fn new(simd: S, view_camera: &ViewCamera, previous: [F64s<S>; 3]) -> Self {
        let [x, y, z] =
            [view_camera.rotation.x_axis, view_camera.rotation.y_axis, view_camera.rotation.z_axis];
        Self {
            rotation: [all3(simd, [x.x, y.x, z.x]), all3(simd, [x.y, y.y, z.y]), all3(simd, [x.z, y.z, z.z])],
            center: minus(all3(simd, view_camera.center), previous),
            focal: [F64s::all(simd, view_camera.focal.x), F64s::all(simd, view_camera.focal.y)],
        }
    }

    /// World vectors as the camera sees them.
    #[inline(always)]
    pub(crate) fn turn(&self, offset: [F64s<S>; 3]) -> [F64s<S>; 3] {
        [dot(self.rotation[0], offset), dot(self.rotation[1], offset), dot(self.rotation[2], offset)]
    }
}

impl<'a, S: Simd> Views<'a, S> {
    /// No views of no Gaussians.
    #[inline(always)]
    pub(crate) fn new(simd: S, view_cameras: &'a [ViewCamera]) -> Self {
        let zero = F64s::all(simd, 0.0);
        Self {
            simd,
            view_cameras,
            rows: Vec::with_capacity(view_cameras.len()),
            previous: [zero; 3],
            count: zero,
            scale: zero,
            least_focal: view_cameras.iter().map(|l| l.focal.min_element()).fold(f64::INFINITY, f64::min),
        }
    }

    #[inline(always)]
    pub(crate) fn number(&self, value: f64) -> F64s<S> {
        F64s::all(self.simd, value)
    }

    /// Fills with the views that observed the given Gaussians, one per lane (the rest of the lanes none), weights scaled to
    /// mean 1.
    #[inline(always)]
    pub(crate) fn gather(
        &mut self,
        previous: &[DVec3],
        observations: &Observations,
        gaussians: &[u32],
        rays: bool,
    ) {
        let (zero, one) = (self.number(0.0), self.number(1.0));
        // Lanes without a Gaussian repeat the first, with no views.
        let (mut places, mut used) = ([gaussians[0] as usize; MAX_LANES], [0.0; MAX_LANES]);
        for (lane, &i) in gaussians.iter().enumerate() {
            (places[lane], used[lane]) = (i as usize, 1.0);
        }
        let used = F64s::from_lanes(self.simd, &used).gt(zero);
        let mut origins = [[0.0; MAX_LANES]; 3];
        for lane in 0..S::F64_LANES {
            for axis in 0..3 {
                origins[axis][lane] = previous[places[lane]][axis];
            }
        }
        for axis in 0..3 {
            self.previous[axis] = F64s::from_lanes(self.simd, &origins[axis]);
        }
        self.rows.clear();
        let (mut sum, mut count, mut farthest) = (zero, zero, zero);
        for view_camera in 0..self.view_cameras.len() {
            let (mut row, observed) = self.row(view_camera, observations, &places, used);
            if !observed.any() {
                continue;
            }
            sum = sum + row.weight;
            count = count + observed.select(one, zero);
            let parts = LensLanes::new(self.simd, &self.view_cameras[view_camera], self.previous);
            farthest = observed.select(farthest.max(dot(parts.center, parts.center)), farthest);
            if rays {
                row.ray = self.ray(&parts, row.target);
            }
            self.rows.push(row);
        }
        self.scale = farthest.sqrt();
        self.count = count;
        let per_weight = count / sum;
        for row in &mut self.rows {
            row.weight = row.weight.gt(zero).select(row.weight * per_weight, zero);
        }
    }

    /// A view as observed, and where it was.
    #[inline(always)]
    fn row(
        &self,
        view_camera: usize,
        observations: &Observations,
        places: &[usize; MAX_LANES],
        used: LaneMask<S>,
    ) -> (Row<S>, LaneMask<S>) {
        let (mut x, mut y, mut weight): (Lanes, Lanes, Lanes) = Default::default();
        let first = view_camera * observations.gaussians;
        let entries = first..first + observations.gaussians;
        let (targets, weights) = (&observations.targets[entries.clone()], &observations.weights[entries]);
        for lane in 0..S::F64_LANES {
            weight[lane] = weights[places[lane]];
            let target = targets[places[lane]];
            (x[lane], y[lane]) = (target.x, target.y);
        }
        let (x, y) = (F64s::from_lanes(self.simd, &x), F64s::from_lanes(self.simd, &y));
        let weight = F64s::from_lanes(self.simd, &weight);
        let zero = self.number(0.0);
        let observed = used & weight.gt(zero) & weight.finite() & x.finite() & y.finite();
        let principal = self.view_cameras[view_camera].principal;
        let target = [
            observed.select(x - self.number(principal.x), zero),
            observed.select(y - self.number(principal.y), zero),
        ];
        (Row { view_camera, target, ray: [zero; 3], weight: observed.select(weight, zero) }, observed)
    }

    /// Unit rays through the targets.
    #[inline(always)]
    fn ray(&self, view_camera: &LensLanes<S>, target: [F64s<S>; 2]) -> [F64s<S>; 3] {
        let (x, y) = (target[0] / view_camera.focal[0], target[1] / view_camera.focal[1]);
        let [right, down, away] = view_camera.rotation;
        let mut ray = [x; 3];
        for k in 0..3 {
            ray[k] = right[k].mul_add(x, down[k].mul_add(y, away[k]));
        }
        let per_length = self.number(1.0) / dot(ray, ray).sqrt();
        [ray[0] * per_length, ray[1] * per_length, ray[2] * per_length]
    }

    /// Mean weight of the views left.
    #[inline(always)]
    pub(crate) fn mean_weight(&self) -> F64s<S> {
        let mut sum = self.number(0.0);
        for row in &self.rows {
            sum = sum + row.weight;
        }
        sum / self.count
    }

    /// Removes a row, of each lane its own.
    #[inline(always)]
    pub(crate) fn remove(&mut self, lanes: LaneMask<S>, rows: F64s<S>) {
        for lane in lanes.lanes() {
            self.rows[rows.lane(lane) as usize].weight.set_lane(lane, 0.0);
        }
        self.count = lanes.select(self.count - self.number(1.0), self.count);
    }
}
