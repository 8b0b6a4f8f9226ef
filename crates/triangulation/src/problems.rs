//! Problems of every difficult kind for the tests.

use ffgs_core::{Camera, ImageSize, Intrinsics, Observations};
use ffgs_testkit::look_at;
use glam::{DVec2, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// N previous means, V cameras of 110 degrees and what they observed.
pub(crate) struct Problems {
    pub previous: Vec<DVec3>,
    pub cameras: Vec<Camera>,
    pub observations: Observations,
}

/// What makes a problem hard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Difficulty {
    /// Nothing but noise and gross outliers.
    Outliers,
    /// Two or three views.
    FewViews,
    /// A target that is NaN.
    NanTarget,
    InfiniteWeight,
    /// A previous mean tens of metres off, behind some cameras.
    FarOff,
    /// A target that no point in front of the camera has.
    AbsurdTarget,
    /// A camera less than a metre away.
    NearCamera,
    /// A place behind most cameras, whose targets are those of its mirror image.
    BehindCameras,
    /// Only the two cameras that look the same way, at the same pixel.
    ParallelRays,
    /// Only the two cameras at one place, and exact targets.
    OnePlace,
}

impl Difficulty {
    const ALL: [Self; 10] = [
        Self::Outliers,
        Self::FewViews,
        Self::NanTarget,
        Self::InfiniteWeight,
        Self::FarOff,
        Self::AbsurdTarget,
        Self::NearCamera,
        Self::BehindCameras,
        Self::ParallelRays,
        Self::OnePlace,
    ];

    /// Of the problem of this number.
    pub(crate) fn of(problem: usize) -> Self {
        Self::ALL[problem % Self::ALL.len()]
    }
}

/// Cameras 0 and 1 look the same way, 2 and 3 stand at one place, 4 is within a metre of some points.
const VIEWS: usize = 14;
const SIZE: ImageSize = ImageSize { width: 640, height: 360 };

fn camera(eye: DVec3, at: DVec3) -> Camera {
    let focal = 320.0 / 55_f64.to_radians().tan();
    Camera::new(Intrinsics { fx: focal, fy: 0.9 * focal, cx: 318.0, cy: 182.5 }, look_at(eye, at), SIZE)
        .unwrap()
}

fn cameras(rng: &mut ChaCha8Rng) -> Vec<Camera> {
    let mut any = |v: usize| {
        let (angle, distance): (f64, f64) = (0.45 * v as f64, rng.random_range(5.0..40.0));
        let eye = DVec3::new(distance * angle.cos(), distance * angle.sin(), rng.random_range(1.0..4.0));
        camera(eye, DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0))))
    };
    let mut all: Vec<Camera> = (0..VIEWS).map(&mut any).collect();
    let aside = DVec3::new(0.0, 1.5, 0.25);
    all[1] = camera(all[0].center() + aside, all[0].center() + aside + all[0].rotation().row(2));
    all[3] = camera(all[2].center(), DVec3::new(0.5, -0.5, 0.25));
    all[4] = camera(DVec3::new(0.5, 0.5, 0.3), DVec3::ZERO);
    all
}

fn ball(rng: &mut ChaCha8Rng, radius: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-radius..radius)))
}

/// `count` problems with a share of gross outliers and uniform noise of up to 1 px an axis, the kinds of [`Difficulty`] in turn.
pub(crate) fn difficult(seed: u64, count: usize, outliers: f64) -> Problems {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let cameras = cameras(&mut rng);
    let mut observations = Observations::unobserved(VIEWS, count);
    let mut previous = Vec::with_capacity(count);
    for i in 0..count {
        let difficulty = Difficulty::of(i);
        let truth = match difficulty {
            Difficulty::NearCamera => cameras[4].center() + ball(&mut rng, 0.2) - DVec3::splat(0.25),
            Difficulty::BehindCameras => DVec3::new(60.0, 30.0, 2.0) + ball(&mut rng, 5.0),
            _ => ball(&mut rng, 1.5),
        };
        let off = if difficulty == Difficulty::FarOff { 60.0 } else { 1.0 };
        previous.push(truth + ball(&mut rng, off));
        for (v, camera) in cameras.iter().enumerate() {
            let seen = camera.camera_from_world().transform_point3(truth);
            let k = camera.intrinsics();
            let pixel = DVec2::new(k.fx * seen.x, k.fy * seen.y) / seen.z + DVec2::new(k.cx, k.cy);
            let wild = rng.random::<f64>() < outliers;
            let error = ball(&mut rng, if wild { 80.0 } else { 1.0 });
            let shown =
                rng.random::<f64>() < 0.7 && (seen.z > 0.0 || difficulty == Difficulty::BehindCameras);
            observations.targets[v * count + i] = pixel + error.truncate();
            observations.weights[v * count + i] = if shown { rng.random_range(0.1..=1.0) } else { 0.0 };
        }
        spoil(&mut observations, i, difficulty, cameras[2].project(truth).zip(cameras[3].project(truth)));
    }
    Problems { previous, cameras, observations }
}

fn spoil(
    observations: &mut Observations,
    i: usize,
    difficulty: Difficulty,
    one_place: Option<(ffgs_core::Projection, ffgs_core::Projection)>,
) {
    let (count, Observations { targets, weights, .. }) = (observations.gaussians, observations);
    let at = |v: usize| v * count + i;
    let victim = at(i / Difficulty::ALL.len() % VIEWS);
    let mut keep = |wanted: &dyn Fn(usize) -> bool| {
        (0..VIEWS).for_each(|v| weights[at(v)] = if wanted(v) { 1.0 } else { 0.0 });
    };
    match difficulty {
        Difficulty::FewViews => keep(&|v| v % 5 == i / 10 % 5),
        Difficulty::ParallelRays => keep(&|v| v < 2),
        Difficulty::OnePlace => keep(&|v| v == 2 || v == 3),
        Difficulty::NearCamera => weights[at(4)] = 1.0,
        _ => {}
    }
    match difficulty {
        Difficulty::NanTarget => targets[victim] = DVec2::NAN,
        Difficulty::InfiniteWeight => weights[victim] = f64::INFINITY,
        Difficulty::AbsurdTarget => targets[victim] = DVec2::splat(1e12),
        Difficulty::ParallelRays => targets[at(1)] = targets[at(0)],
        Difficulty::OnePlace => {
            if let Some((a, b)) = one_place {
                (targets[at(2)], targets[at(3)]) = (a.pixel, b.pixel);
            }
        }
        _ => {}
    }
}
