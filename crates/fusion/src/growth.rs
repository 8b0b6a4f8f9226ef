//! Growth by uncertainty: which Gaussians are split because their positions are least certain (Algorithm 1, line 42).

use ffgs_core::{Gaussians, logit, sigmoid};
use glam::{DMat3, Quat, Vec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Settings of the growth by uncertainty, which the paper calls densification.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GrowthConfig {
    /// Share of the Gaussians considered, the most uncertain first; also the growth cap of a frame.
    pub fraction: f64,
    /// Least standard deviation, square root of tr(Sigma), in pixels at the Gaussian's depth.
    pub min_sigma_px: f64,
    /// A Gaussian whose largest axis exceeds this many pixels is split, a smaller one cloned.
    pub split_above_px: f64,
    /// Most dynamic Gaussians, as a share of those that were marked and have not left all images.
    pub max_growth: f64,
    /// Opacity below which a Gaussian is removed.
    pub min_opacity: f32,
    /// Most dynamic Gaussians.
    pub max_dynamic: usize,
}

impl Default for GrowthConfig {
    fn default() -> Self {
        Self {
            fraction: 0.02,
            min_sigma_px: 2.0,
            split_above_px: 4.0,
            max_growth: 1.0,
            min_opacity: 0.005,
            max_dynamic: 500_000,
        }
    }
}

/// What becomes of a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GrowthAction {
    /// Two smaller ones at offsets along its axes.
    Split,
    /// Two at the same place.
    Clone,
}

/// Chooses the Gaussians to split or clone: the top `fraction` by tr(Sigma) (m^2) of those that exceed
/// `(min_sigma_px * pixel_m)^2` (Algorithm 1, line 42). `pixel_m` (N) is the size of a pixel at each depth, z / f (m).
/// Each action adds one Gaussian; the plan never exceeds the growth cap or `max_dynamic`. Ascending by index.
pub fn plan_growth(
    gaussians: &Gaussians,
    covariances: &[DMat3],
    pixel_m: &[f64],
    config: &GrowthConfig,
) -> Vec<(usize, GrowthAction)> {
    let n = gaussians.len();
    let growth = ((config.fraction * n as f64) as usize).min(config.max_dynamic.saturating_sub(n));
    let trace = |i: usize| covariances[i].x_axis.x + covariances[i].y_axis.y + covariances[i].z_axis.z;
    let mut candidates: Vec<usize> =
        (0..n).filter(|&i| trace(i) > (config.min_sigma_px * pixel_m[i]).powi(2)).collect();
    candidates.sort_by(|&a, &b| trace(b).total_cmp(&trace(a)).then(a.cmp(&b)));
    candidates.truncate(growth);
    candidates.sort_unstable();
    let action = |i: usize| {
        let largest = gaussians.log_scales[i].iter().copied().fold(f32::MIN, f32::max).exp();
        let split = f64::from(largest) > config.split_above_px * pixel_m[i];
        if split { GrowthAction::Split } else { GrowthAction::Clone }
    };
    candidates.into_iter().map(|i| (i, action(i))).collect()
}

/// Axes of a split child relative to its parent (3DGS: divided by 0.8 times the number of children).
const SPLIT_SHRINK: f32 = 1.6;

/// Carries out a plan: the first child replaces its parent, the second is appended in plan order; covariances are
/// inherited. Offsets of split children are drawn from the parent's own extent, opposite to each other so that the
/// pair stays centred; they depend on `seed` and the index only. Opacities become `1 - sqrt(1 - o)`, so that the
/// stack of two has the transmittance of the parent.
pub fn apply_growth(
    gaussians: &mut Gaussians,
    covariances: &mut Vec<DMat3>,
    plan: &[(usize, GrowthAction)],
    seed: u64,
) {
    let parents = gaussians.select(&plan.iter().map(|p| p.0).collect::<Vec<_>>());
    for (child, &(i, action)) in plan.iter().enumerate() {
        let opacity = 1.0 - (1.0 - sigmoid(parents.opacity_logits[child])).max(0.0).sqrt();
        let opacity_logit = logit(opacity.clamp(1e-6, 1.0 - 1e-6));
        let second = gaussians.len();
        gaussians.push_from(&parents, child);
        covariances.push(covariances[i]);
        for (at, side) in [(i, 1.0), (second, -1.0)] {
            gaussians.opacity_logits[at] = opacity_logit;
            if action == GrowthAction::Split {
                let offset = split_offset(&parents, child, seed ^ (i as u64).rotate_left(32)) * side;
                gaussians.means[at] = (Vec3::from(parents.means[child]) + offset).to_array();
                gaussians.log_scales[at] = parents.log_scales[child].map(|s| s - SPLIT_SHRINK.ln());
            }
        }
    }
}

/// A point at half to one standard deviation along the largest axis, spread a little along the others (world, m).
fn split_offset(parents: &Gaussians, i: usize, seed: u64) -> Vec3 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let scales = Vec3::from(parents.log_scales[i]).exp();
    let largest = scales.max_element();
    let along = |scale: f32, rng: &mut ChaCha8Rng| {
        let range = if scale == largest { 0.5..1.0 } else { -0.3..0.3 };
        scale * rng.random_range(range)
    };
    let local = Vec3::new(along(scales.x, &mut rng), along(scales.y, &mut rng), along(scales.z, &mut rng));
    let [w, x, y, z] = parents.quats[i];
    let rotation = Quat::from_xyzw(x, y, z, w);
    // A zero quaternion has no direction; the rasterizer treats it as the identity.
    let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { Quat::IDENTITY };
    rotation * local
}
