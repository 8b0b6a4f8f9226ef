//! Arrangements of simulated cameras, from a full circle to nearly parallel rays.

use crate::normal;
use ffgs_core::{Camera, ImageSize, Intrinsics};
use glam::{DMat3, DMat4, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Arrangement of the cameras, all looking at the origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rig {
    /// On a circle of 12 m.
    Ring,
    /// Along a line of 80 m beside the track.
    Trackside,
    /// Over a half sphere of 10 m.
    Dome,
    /// Within 2 m of each other, 30 m away: nearly parallel rays.
    Narrow,
}

/// Cameras of the two frames.
pub(crate) struct Cameras {
    pub before: Vec<Camera>,
    pub now: Vec<Camera>,
}

pub(crate) fn cameras(rig: Rig, views: usize, moving: bool, rng: &mut ChaCha8Rng) -> Cameras {
    let mut out = Cameras { before: Vec::new(), now: Vec::new() };
    for v in 0..views {
        let eye = eye(rig, (v as f64 + 0.5) / views as f64, rng);
        let drift = if moving { DVec3::new(0.3 * normal(rng), 0.3 * normal(rng), 0.0) } else { DVec3::ZERO };
        let place = |eye: DVec3| camera(eye, DVec3::Z * 0.6);
        // An eye at the very point that it looks at cannot be drawn: the rigs keep their distance.
        if let (Some(before), Some(now)) = (place(eye), place(eye + drift)) {
            out.before.push(before);
            out.now.push(now);
        }
    }
    out
}

fn eye(rig: Rig, share: f64, rng: &mut ChaCha8Rng) -> DVec3 {
    let angle = TAU * share;
    match rig {
        Rig::Ring => DVec3::new(12.0 * angle.cos(), 12.0 * angle.sin(), rng.random_range(1.0..4.0)),
        Rig::Trackside => {
            let side = if rng.random::<f64>() < 0.7 { -10.0 } else { 14.0 };
            DVec3::new(80.0 * (share - 0.5), side, rng.random_range(1.5..5.0))
        }
        Rig::Dome => {
            let up: f64 = rng.random_range(0.2..1.2);
            DVec3::new(angle.cos() * up.cos(), angle.sin() * up.cos(), up.sin()) * 10.0
        }
        Rig::Narrow => DVec3::new(2.0 * (share - 0.5), -30.0, rng.random_range(1.0..3.0)),
    }
}

fn camera(eye: DVec3, at: DVec3) -> Option<Camera> {
    let z = (at - eye).normalize();
    let x = z.cross(DVec3::Z).normalize();
    let rotation = DMat3::from_cols(x, z.cross(x), z).transpose();
    let mut pose = DMat4::from_mat3(rotation);
    pose.w_axis = (-(rotation * eye)).extend(1.0);
    // Long lenses for far objects, as at a track: an object of 5 m covers about a third of the image.
    let focal = 100.0 * (eye - at).length() / 5.0;
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx: 160.0, cy: 90.0 };
    Camera::new(intrinsics, pose, ImageSize { width: 320, height: 180 }).ok()
}
