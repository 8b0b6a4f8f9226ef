//! The moving objects of a simulation: surface points with their true motion.

use glam::{DQuat, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// What moves and how, from t-1 to t, near the origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scenario {
    /// A rigid car, 1.4 m per frame, turning.
    Car,
    /// Two cars that pass each other.
    TwoSpeeds,
    /// A walker: a torso, and four limbs that each turn about their joint.
    Walker,
    /// A walker who holds a board, which is rigid and turns.
    Board,
    /// A bar that bends: nothing about it is rigid.
    Bending,
    /// Nine boxes that stand and one that moves.
    MostlyStatic,
}

impl Scenario {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Car, Self::TwoSpeeds, Self::Walker, Self::Board, Self::Bending, Self::MostlyStatic];
}

/// Points on surfaces with their motion.
pub(crate) struct Cloud {
    pub previous: Vec<DVec3>,
    pub truth: Vec<DVec3>,
    /// Outward normals at t-1.
    pub normals: Vec<DVec3>,
    pub parts: Vec<u32>,
}

/// A box with a motion.
#[derive(Clone, Copy)]
struct Part {
    centre: DVec3,
    half: DVec3,
    /// Point that the rotation keeps, before the step.
    joint: DVec3,
    rotation: DQuat,
    step: DVec3,
}

impl Part {
    fn rigid(centre: DVec3, half: DVec3, yaw: f64, step: DVec3) -> Self {
        Self { centre, half, joint: centre, rotation: DQuat::from_rotation_z(yaw), step }
    }

    /// A limb hanging from its joint, swinging in the x-z plane.
    fn limb(joint: DVec3, swing: f64, step: DVec3) -> Self {
        let half = DVec3::new(0.07, 0.07, 0.38);
        let rotation = DQuat::from_rotation_y(swing);
        Self { centre: joint - DVec3::Z * half.z, half, joint, rotation, step }
    }

    fn apply(&self, p: DVec3) -> DVec3 {
        self.rotation * (p - self.joint) + self.joint + self.step
    }
}

pub(crate) fn build(scenario: Scenario, gaussians: usize, rng: &mut ChaCha8Rng) -> Cloud {
    let parts = parts(scenario);
    let mut cloud = Cloud { previous: Vec::new(), truth: Vec::new(), normals: Vec::new(), parts: Vec::new() };
    for (id, part) in parts.iter().enumerate() {
        for _ in 0..gaussians.div_ceil(parts.len()) {
            let (offset, normal) = on_box(part.half, rng);
            let p = part.centre + offset;
            let bend = if scenario == Scenario::Bending { bent(offset) } else { DVec3::ZERO };
            cloud.previous.push(p);
            cloud.truth.push(part.apply(p) + bend);
            cloud.normals.push(normal);
            cloud.parts.push(id as u32);
        }
    }
    cloud
}

fn parts(scenario: Scenario) -> Vec<Part> {
    let car = DVec3::new(2.2, 0.9, 0.5);
    match scenario {
        Scenario::Car => vec![Part::rigid(DVec3::Z * 0.6, car, 0.03, DVec3::new(1.4, 0.05, 0.0))],
        Scenario::TwoSpeeds => vec![
            Part::rigid(DVec3::new(0.0, -1.6, 0.6), car, 0.03, DVec3::new(1.4, 0.05, 0.0)),
            Part::rigid(DVec3::new(1.0, 1.6, 0.6), car, -0.02, DVec3::new(-0.9, 0.0, 0.0)),
        ],
        Scenario::Walker => walker().into(),
        Scenario::Board => {
            let (centre, half) = (DVec3::new(0.5, 0.0, 1.2), DVec3::new(0.02, 0.45, 0.32));
            let board = Part::rigid(centre, half, 0.1, DVec3::new(0.05, 0.02, 0.03));
            // Parts share the Gaussians evenly: half of them are the board's.
            walker().into_iter().chain([board; 5]).collect()
        }
        Scenario::Bending => {
            vec![Part::rigid(DVec3::Z, DVec3::new(2.0, 0.15, 0.15), 0.0, DVec3::new(0.3, 0.0, 0.0))]
        }
        Scenario::MostlyStatic => (0..10)
            .map(|i| {
                let centre = DVec3::new(f64::from(i % 5) * 2.0 - 4.0, f64::from(i / 5) * 2.0 - 1.0, 0.5);
                let step = if i == 7 { DVec3::new(0.4, 0.2, 0.0) } else { DVec3::ZERO };
                Part::rigid(centre, DVec3::splat(0.4), 0.0, step)
            })
            .collect(),
    }
}

/// A torso, two arms, two legs.
fn walker() -> [Part; 5] {
    let step = DVec3::new(0.05, 0.0, 0.0);
    let torso = Part::rigid(DVec3::new(0.0, 0.0, 1.2), DVec3::new(0.12, 0.2, 0.35), 0.0, step);
    let joint = |y: f64, z: f64| DVec3::new(0.0, y, z);
    [
        torso,
        Part::limb(joint(-0.3, 1.5), 0.25, step),
        Part::limb(joint(0.3, 1.5), -0.25, step),
        Part::limb(joint(-0.12, 0.85), -0.2, step),
        Part::limb(joint(0.12, 0.85), 0.2, step),
    ]
}

/// Displacement of a bar that bends by 40 cm at its ends.
fn bent(offset: DVec3) -> DVec3 {
    DVec3::Y * 0.1 * offset.x * offset.x
}

/// A point on a box's surface, evenly by area, with its normal.
fn on_box(half: DVec3, rng: &mut ChaCha8Rng) -> (DVec3, DVec3) {
    let areas = [half.y * half.z, half.x * half.z, half.x * half.y];
    let mut pick = rng.random_range(0.0..areas.iter().sum());
    let mut axis = 0;
    while axis < 2 && pick >= areas[axis] {
        pick -= areas[axis];
        axis += 1;
    }
    let mut p = half * DVec3::from([(); 3].map(|()| rng.random_range(-1.0..1.0)));
    let mut normal = DVec3::ZERO;
    normal[axis] = if rng.random::<bool>() { 1.0 } else { -1.0 };
    p[axis] = half[axis] * normal[axis];
    (p, normal)
}
