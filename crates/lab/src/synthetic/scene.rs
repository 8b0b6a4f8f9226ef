//! A yard with a wall around it, and four bodies that drive through it.

use ffgs_core::{Gaussians, SH_C0, SkyCube, logit};
use ffgs_method::Points;
use glam::{DQuat, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Degree of the spherical harmonics, as a run trains them.
const DEGREE: usize = 3;
/// Radius of the yard (m) and height of its wall (m).
const YARD: [f64; 2] = [20.0, 8.0];
/// Half axes of a body (m).
const BODY: DVec3 = DVec3::new(2.1, 0.9, 0.7);
/// Places of the bodies at frame 0 (m): they pass each other at half a metre and more.
const PLACES: [DVec3; 4] = [
    DVec3::new(-4.0, -4.2, 0.8),
    DVec3::new(2.0, -1.4, 0.8),
    DVec3::new(-1.0, 1.4, 0.8),
    DVec3::new(4.0, 4.2, 0.8),
];
/// Step of a body per frame (m), and its turn about the vertical (rad).
const STEP: [f64; 2] = [0.5, 0.02];
/// Frames after which a body drives and turns back, so that long captures stay within the yard.
const REACH: usize = 16;

/// The truth at frame 0, and which body each dynamic Gaussian belongs to.
pub(super) struct World {
    pub(super) static_layer: Gaussians,
    pub(super) dynamic: Gaussians,
    bodies: Vec<usize>,
}

impl World {
    /// Surfaces of discs, in random places that depend on the counts alone.
    pub(super) fn new(static_count: usize, dynamic_count: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(17);
        let mut static_layer = Gaussians::empty(DEGREE);
        let [radius, height] = YARD;
        let (ground, wall) = (radius * radius * TAU / 2.0, TAU * radius * height);
        let spacing = ((ground + wall) / static_count.max(1) as f64).sqrt();
        for _ in 0..static_count {
            let angle = rng.random::<f64>() * TAU;
            let (at, normal) = if rng.random::<f64>() * (ground + wall) < ground {
                let r = radius * rng.random::<f64>().sqrt();
                (DVec3::new(r * angle.cos(), r * angle.sin(), 0.0), DVec3::Z)
            } else {
                let out = DVec3::new(angle.cos(), angle.sin(), 0.0);
                (radius * out + DVec3::Z * height * rng.random::<f64>(), -out)
            };
            push_disc(&mut static_layer, at, normal, spacing, paint(at, 0.6));
        }
        let (mut dynamic, mut bodies) = (Gaussians::empty(DEGREE), Vec::with_capacity(dynamic_count));
        let area = TAU / 2.0 * 4.0 * (BODY.x * BODY.y + BODY.x * BODY.z + BODY.y * BODY.z) / 3.0;
        let spacing = (area * PLACES.len() as f64 / dynamic_count.max(1) as f64).sqrt();
        for i in 0..dynamic_count {
            let (z, angle) = (2.0 * rng.random::<f64>() - 1.0, rng.random::<f64>() * TAU);
            let out = DVec3::new((1.0 - z * z).sqrt() * angle.cos(), (1.0 - z * z).sqrt() * angle.sin(), z);
            let body = i % PLACES.len();
            let colour = paint(7.0 * out + DVec3::splat(11.0 * body as f64), 1.6);
            push_disc(&mut dynamic, PLACES[body] + BODY * out, (out / BODY).normalize(), spacing, colour);
            bodies.push(body);
        }
        Self { static_layer, dynamic, bodies }
    }

    /// The dynamic layer at a frame: every body has driven on, or back, and turned.
    pub(super) fn dynamic_at(&self, frame: usize) -> Gaussians {
        let mut moved = self.dynamic.clone();
        let steps = (frame + REACH).rem_euclid(2 * REACH).abs_diff(REACH) as f64;
        let (driven, turn) = (STEP[0] * steps, DQuat::from_rotation_z(STEP[1] * steps));
        for (i, &body) in self.bodies.iter().enumerate() {
            let along = DVec3::X * driven * if body % 2 == 0 { 1.0 } else { -1.0 };
            let mean = DVec3::from(moved.means[i].map(f64::from));
            moved.means[i] = (PLACES[body] + along + turn * (mean - PLACES[body])).as_vec3().to_array();
            let [w, x, y, z] = moved.quats[i].map(f64::from);
            let q = turn * DQuat::from_xyzw(x, y, z, w);
            moved.quats[i] = [q.w, q.x, q.y, q.z].map(|v| v as f32);
        }
        moved
    }

    /// Behind everything.
    pub(super) fn sky() -> SkyCube {
        SkyCube::filled(32, super::SKY)
    }

    /// Every `stride`th Gaussian as an initial point.
    pub(super) fn points(&self, stride: usize) -> Points {
        let mut points = Points::default();
        for (layer, moving) in [(&self.static_layer, false), (&self.dynamic, true)] {
            for i in (0..layer.len()).step_by(stride) {
                let ([x, y, z], colour) = (layer.means[i], layer.sh_of(i)[0]);
                let [r, g, b] = colour.map(|c| (SH_C0 * c + 0.5).clamp(0.0, 1.0));
                points.push([x, y, z, r, g, b], moving);
            }
        }
        points
    }
}

/// SH coefficient 0 of a colour (0..1).
pub(super) fn sh0(colour: DVec3) -> [f32; 3] {
    ((colour - 0.5) / f64::from(SH_C0)).as_vec3().to_array()
}

/// A pattern with detail of every size from `1 / frequency` m down.
fn paint(at: DVec3, frequency: f64) -> DVec3 {
    let mut colour = DVec3::splat(0.5);
    for octave in 0..4 {
        let f = frequency * f64::from(1_u32 << octave);
        let p = at * f;
        let wave = DVec3::new(
            (p.x + 1.3 * p.y).sin() * (p.z + 0.7).cos(),
            (p.y - 0.6 * p.x + 2.0).sin() * (0.8 * p.z).cos(),
            (p.x * 0.9 + p.z + 1.0).sin() * (p.y + 0.4).cos(),
        );
        colour += 0.18 * wave / f64::from(octave + 1);
    }
    colour.clamp(DVec3::splat(0.05), DVec3::splat(0.95))
}

fn push_disc(layer: &mut Gaussians, at: DVec3, normal: DVec3, spacing: f64, colour: DVec3) {
    layer.means.push(at.as_vec3().to_array());
    let turn = DQuat::from_rotation_arc(DVec3::Z, normal);
    layer.quats.push([turn.w, turn.x, turn.y, turn.z].map(|v| v as f32));
    let wide = (0.7 * spacing).ln() as f32;
    layer.log_scales.push([wide, wide, wide - 2.3]);
    layer.opacity_logits.push(logit(0.9));
    layer.sh.push(sh0(colour));
    layer.sh.extend(std::iter::repeat_n([0.0; 3], layer.sh_stride() - 1));
}
