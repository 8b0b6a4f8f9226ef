//! Simulated motion observations, whose truth, noise, correlation and outliers are known.
//!
//! ```
//! use ffgs_simulator::{Recipe, Scenario, simulate};
//!
//! let scene = simulate(&Recipe { scenario: Scenario::TwoSpeeds, gaussians: 500, ..Recipe::default() });
//! assert_eq!(scene.observations.len(), 3);
//! assert_eq!(scene.truth.len(), scene.previous.len());
//! ```

mod objects;
mod rig;
mod trackers;

pub use objects::Scenario;
pub use rig::Rig;

use ffgs_core::{Camera, Observations};
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// What is simulated.
#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    /// Arrangement of the cameras.
    pub rig: Rig,
    /// Cameras V.
    pub views: usize,
    /// What moves and how.
    pub scenario: Scenario,
    /// Gaussians N, about: objects share them evenly.
    pub gaussians: usize,
    /// Trackers L.
    pub trackers: usize,
    /// Standard deviation of a tracker's error (px).
    pub noise_px: f64,
    /// Share of the error's variance that is smooth over the surface, as trackers' errors are.
    pub smooth: f64,
    /// Correlation between the errors of two trackers.
    pub shared: f64,
    /// Share of gross errors (40 px).
    pub outliers: f64,
    /// Whether a surface hides what faces away from the camera.
    pub occlusion: bool,
    /// Whether the cameras move between the frames.
    pub moving_cameras: bool,
    /// Seed.
    pub seed: u64,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            rig: Rig::Trackside,
            views: 20,
            scenario: Scenario::Car,
            gaussians: 2000,
            trackers: 3,
            noise_px: 1.0,
            smooth: 0.5,
            shared: 0.3,
            outliers: 0.05,
            occlusion: true,
            moving_cameras: false,
            seed: 1,
        }
    }
}

/// A simulated frame.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// (N) places at t-1 (m).
    pub previous: Vec<DVec3>,
    /// (N) places at t (m).
    pub truth: Vec<DVec3>,
    /// (N) part of each Gaussian.
    pub parts: Vec<u32>,
    /// (V) cameras at t.
    pub cameras: Vec<Camera>,
    /// (L) what each tracker says.
    pub observations: Vec<Observations>,
}

/// Simulates one frame; the same recipe gives the same bytes.
pub fn simulate(recipe: &Recipe) -> Simulation {
    let mut rng = ChaCha8Rng::seed_from_u64(recipe.seed);
    let cloud = objects::build(recipe.scenario, recipe.gaussians, &mut rng);
    let cameras = rig::cameras(recipe.rig, recipe.views, recipe.moving_cameras, &mut rng);
    let observations = trackers::observe(recipe, &cloud, &cameras, &mut rng);
    Simulation {
        previous: cloud.previous,
        truth: cloud.truth,
        parts: cloud.parts,
        cameras: cameras.now,
        observations,
    }
}

/// A standard normal number (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    use rand::Rng;
    let (u, v): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}
