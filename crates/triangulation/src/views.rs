//! The views of one Gaussian, in blocks of a fixed number of lanes, and what is summed over them.

use crate::normal::Normal;
use crate::passes::{ErrorPass, RayPass, RayResidualPass, ReprojectionPass, TruncatedPass};
use ffgs_core::{Camera, Observations};
use glam::{DMat3, DVec2, DVec3};
use pulp::Arch;

/// Views a block: one AVX-512 register of f64, two of AVX2.
pub const LANES: usize = 8;

/// One value of each view of a block.
pub type Column = [f64; LANES];

/// Views that observed the Gaussian at hand, in coordinates whose origin is the previous mean, a column a parameter.
/// Lanes without a view have weight 0.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub struct Block {
    /// Rotation of `camera_from_world`, row by row.
    pub rotation: [Column; 9],
    /// Previous mean in camera coordinates (m).
    pub origin_in_camera: [Column; 3],
    /// Camera centre relative to the previous mean (m).
    pub center: [Column; 3],
    /// Unit viewing ray through the target.
    pub ray: [Column; 3],
    /// Focal lengths (px).
    pub focal: [Column; 2],
    /// Target less principal point (px).
    pub target: [Column; 2],
    /// Observation weight, scaled to mean 1 over the Gaussian's views; 0 = removed.
    pub weight: Column,
}

impl Block {
    /// No views: numbers that no pass divides by zero with.
    const EMPTY: Self = Self {
        rotation: [[0.0; LANES]; 9],
        origin_in_camera: [[1.0; LANES]; 3],
        center: [[1.0; LANES]; 3],
        ray: [[1.0; LANES]; 3],
        focal: [[1.0; LANES]; 2],
        target: [[0.0; LANES]; 2],
        weight: [0.0; LANES],
    };
}

/// What of a camera every Gaussian needs.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    rotation: DMat3,
    center: DVec3,
    focal: DVec2,
    principal: DVec2,
}

impl From<&Camera> for Lens {
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

/// How rays are weighted at a point.
#[derive(Clone, Copy, Debug)]
pub enum RayWeights {
    /// By the observations' weights alone.
    Plain,
    /// Times `(f / z)^2`, which turns squared distances to the ray into px^2.
    Depth,
    /// That over `1 + (r / scale)^2`, the residual against a scale (px).
    Soft(f64),
}

/// The views of one Gaussian; reused from Gaussian to Gaussian.
#[derive(Clone, Debug)]
pub struct Views {
    arch: Arch,
    blocks: Vec<Block>,
    errors: Vec<Column>,
    /// Block and lane of each view left.
    places: Vec<(usize, usize)>,
    /// Distance of the farthest camera (m).
    pub scale: f64,
}

impl Default for Views {
    fn default() -> Self {
        Self { arch: Arch::new(), blocks: Vec::new(), errors: Vec::new(), places: Vec::new(), scale: 0.0 }
    }
}

impl Views {
    /// Fills with the views that observed Gaussian `i`, weights scaled to mean 1.
    pub fn gather(&mut self, previous: DVec3, lenses: &[Lens], observations: &Observations, i: usize) {
        self.blocks.clear();
        self.places.clear();
        let (mut sum, mut farthest) = (0.0, 0.0_f64);
        for (v, lens) in lenses.iter().enumerate() {
            let entry = v * observations.gaussians + i;
            let weight = observations.weights[entry];
            if !(weight > 0.0 && weight.is_finite()) {
                continue;
            }
            let target = observations.targets[entry];
            if target.is_finite() {
                sum += weight;
                farthest = farthest.max(self.push(previous, lens, target, weight));
            }
        }
        self.scale = farthest.sqrt();
        self.errors.resize(self.blocks.len(), [0.0; LANES]);
        let per_weight = self.places.len() as f64 / sum;
        for &(block, lane) in &self.places {
            self.blocks[block].weight[lane] *= per_weight;
        }
    }

    /// Adds a view; squared distance of its camera (m^2).
    fn push(&mut self, previous: DVec3, lens: &Lens, target: DVec2, weight: f64) -> f64 {
        let (block, k) = (self.places.len() / LANES, self.places.len() % LANES);
        if k == 0 {
            self.blocks.push(Block::EMPTY);
        }
        self.places.push((block, k));
        let out = &mut self.blocks[block];
        let center = lens.center - previous;
        let origin = lens.rotation * -center;
        let target = target - lens.principal;
        let ray = (lens.rotation.transpose() * (target / lens.focal).extend(1.0)).normalize();
        // Columns of the transpose are rows.
        let rows = lens.rotation.transpose().to_cols_array();
        (out.rotation.iter_mut().zip(rows)).for_each(|(column, value)| column[k] = value);
        for axis in 0..3 {
            out.center[axis][k] = center[axis];
            out.origin_in_camera[axis][k] = origin[axis];
            out.ray[axis][k] = ray[axis];
        }
        for axis in 0..2 {
            out.focal[axis][k] = lens.focal[axis];
            out.target[axis][k] = target[axis];
        }
        out.weight[k] = weight;
        center.length_squared()
    }

    /// Number of views left.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Mean weight of the views left.
    pub fn mean_weight(&self) -> f64 {
        self.places.iter().map(|&(b, k)| self.blocks[b].weight[k]).sum::<f64>() / self.len() as f64
    }

    /// Weighted meeting point of the rays as a normal system (Algorithm 1, line 23): `A = sum w W`, `b = sum w W c`,
    /// `W = I - d d^T`, with the weights of `point`.
    pub fn rays(&self, point: DVec3, weights: RayWeights) -> Normal {
        self.arch.dispatch(RayPass { blocks: &self.blocks, point: point.to_array(), weights })
    }

    /// `sum w J^T J` and `sum w J^T r` of the projections at `point`, and the cost `sum w r^2` (px^2); `None` when the
    /// point is not in front of every camera.
    pub fn reprojection(&self, point: DVec3) -> Option<(Normal, f64)> {
        let (normal, cost, hidden) =
            self.arch.dispatch(ReprojectionPass { blocks: &self.blocks, point: point.to_array() });
        (!hidden).then_some((normal, cost))
    }

    /// Squared residuals (px^2) of the views left, infinite behind a camera.
    pub fn errors(&mut self, point: DVec3) -> impl Iterator<Item = f64> {
        let Self { arch, blocks, errors, places, .. } = self;
        arch.dispatch(ErrorPass { blocks, point: point.to_array(), errors });
        places.iter().map(|&(b, k)| errors[b][k])
    }

    /// As [`Views::errors`], each times its view's weight.
    pub fn weighted_errors(&mut self, point: DVec3) -> impl Iterator<Item = f64> {
        let Self { arch, blocks, errors, places, .. } = self;
        arch.dispatch(ErrorPass { blocks, point: point.to_array(), errors });
        places.iter().map(|&(b, k)| blocks[b].weight[k] * errors[b][k])
    }

    /// `sum w min(r^2, cut2)`.
    pub fn truncated_cost(&self, point: DVec3, cut2: f64) -> f64 {
        self.arch.dispatch(TruncatedPass { blocks: &self.blocks, point: point.to_array(), cut2 })
    }

    /// Weighted squared distances to the rays in pixels, infinite behind a camera.
    pub fn ray_cost(&self, point: DVec3) -> f64 {
        self.arch.dispatch(RayResidualPass { blocks: &self.blocks, point: point.to_array() })
    }

    /// Removes the views for which `drop` holds, given the squared residual at `point`.
    pub fn remove_where(&mut self, point: DVec3, drop: impl Fn(f64) -> bool) {
        let dropped: Vec<bool> = self.errors(point).map(drop).collect();
        self.remove(|view| dropped[view]);
    }

    /// Removes the views for which `drop(position in the list)` holds.
    pub fn remove(&mut self, drop: impl Fn(usize) -> bool) {
        let Self { blocks, places, .. } = self;
        let mut view = 0;
        places.retain(|&(b, k)| {
            let gone = drop(view);
            view += 1;
            if gone {
                blocks[b].weight[k] = 0.0;
            }
            !gone
        });
    }

    /// Unit ray of a view.
    pub fn ray(&self, view: usize) -> DVec3 {
        let (b, k) = self.places[view];
        DVec3::new(self.blocks[b].ray[0][k], self.blocks[b].ray[1][k], self.blocks[b].ray[2][k])
    }

    /// Camera centre of a view (m).
    pub fn center(&self, view: usize) -> DVec3 {
        let (b, k) = self.places[view];
        DVec3::new(self.blocks[b].center[0][k], self.blocks[b].center[1][k], self.blocks[b].center[2][k])
    }
}
