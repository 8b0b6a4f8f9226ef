//! Simulated trackers: displaced projections with smooth, white and gross errors.

use crate::objects::Cloud;
use crate::rig::Cameras;
use crate::{Recipe, normal};
use ffgs_core::Observations;
use glam::{DVec2, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Standard deviation of a gross error (px).
const GROSS_PX: f64 = 40.0;
/// Waves that a smooth error field is made of.
const WAVES: usize = 6;
/// Wavelength of the smooth errors on the surface (m), about.
const WAVELENGTH: f64 = 1.0;

/// A smooth random field on the surface with unit variance an axis.
struct Smooth([(DVec3, f64, DVec2); WAVES]);

impl Smooth {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let wave = |rng: &mut ChaCha8Rng| {
            let k = DVec3::new(normal(rng), normal(rng), normal(rng))
                * (std::f64::consts::TAU / WAVELENGTH / 3.0);
            let amplitude = DVec2::new(normal(rng), normal(rng)) * (2.0 / WAVES as f64).sqrt();
            (k, rng.random_range(0.0..std::f64::consts::TAU), amplitude)
        };
        Self([(); WAVES].map(|()| wave(rng)))
    }

    fn at(&self, p: DVec3) -> DVec2 {
        self.0.iter().map(|(k, phase, amplitude)| *amplitude * (k.dot(p) + phase).sin()).sum()
    }
}

/// One error field of a view: a smooth and a white part, unit variance an axis.
struct Field {
    smooth: Smooth,
    share: f64,
}

impl Field {
    fn at(&self, p: DVec3, rng: &mut ChaCha8Rng) -> DVec2 {
        let white = DVec2::new(normal(rng), normal(rng));
        self.smooth.at(p) * self.share.sqrt() + white * (1.0 - self.share).sqrt()
    }
}

/// (L) observations: a point that a camera sees at both times, displaced, with the tracker's error.
pub(crate) fn observe(
    recipe: &Recipe,
    cloud: &Cloud,
    cameras: &Cameras,
    rng: &mut ChaCha8Rng,
) -> Vec<Observations> {
    let (n, views) = (cloud.truth.len(), cameras.now.len());
    let mut out = vec![Observations::unobserved(views, n); recipe.trackers];
    for v in 0..views {
        let field = |rng: &mut ChaCha8Rng| Field { smooth: Smooth::new(rng), share: recipe.smooth };
        let common = field(rng);
        let own: Vec<Field> = (0..recipe.trackers).map(|_| field(rng)).collect();
        for i in 0..n {
            let eye = cameras.before[v].center() - cloud.previous[i];
            let seen = !recipe.occlusion || cloud.normals[i].dot(eye) > 0.0;
            let (before, now) =
                (cameras.before[v].pixel_of(cloud.previous[i]), cameras.now[v].project(cloud.truth[i]));
            let shared = common.at(cloud.previous[i], rng) * recipe.shared.sqrt();
            for (l, observation) in out.iter_mut().enumerate() {
                let error = shared + own[l].at(cloud.previous[i], rng) * (1.0 - recipe.shared).sqrt();
                let gross = rng.random::<f64>() < recipe.outliers;
                let wild = DVec2::new(normal(rng), normal(rng)) * GROSS_PX;
                if let (true, Some(_), Some(now)) = (seen, before, now) {
                    let entry = v * n + i;
                    observation.targets[entry] =
                        now.pixel + if gross { wild } else { error * recipe.noise_px };
                    observation.weights[entry] = 1.0;
                }
            }
        }
    }
    out
}
