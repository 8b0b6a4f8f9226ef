//! A capture in memory with exact tracks: a rigid cloud of Gaussians in a ring of cameras, on which methods are tried.

use crate::look_at;
use ffgs_core::{
    Camera, Dynamic, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, Scene, SkyCube, TrackSet,
    TrainingView, ViewMotion,
};
use ffgs_method::{Capture, Fault, Points, Split, Step, TrackSource, Tracked, ViewAt, ViewStep};
use glam::{DMat3, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};

const SIZE: ImageSize = ImageSize { width: 96, height: 72 };
const VIEWS: usize = 4;
const FRAMES: usize = 4;
/// Half the edge of the cube that the Gaussians fill (m).
const HALF: f64 = 0.4;
/// Standard deviation of a Gaussian along each axis (m).
const RADIUS: f64 = 0.03;
/// Standard deviation of what is known of a position (m).
const KNOWN: f64 = 0.005;

/// A cloud of Gaussians in a ring of cameras, which moves by the same step in every frame: a capture in memory.
#[derive(Clone, Debug)]
pub struct World {
    /// Where the Gaussians are in frame 0 (m).
    pub places: Vec<DVec3>,
    /// How far they go per frame (m).
    pub step: DVec3,
    /// Whether the masks hold them; else the masks are empty.
    pub masked: bool,
    names: Vec<String>,
}

impl World {
    /// `count` Gaussians at random places, moving by `step` (m) per frame.
    pub fn new(count: usize, step: DVec3) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut place = || DVec3::from_array([(); 3].map(|()| rng.random_range(-HALF..HALF)));
        let places = (0..count).map(|_| place()).collect();
        Self { places, step, masked: true, names: (0..VIEWS).map(|view| format!("view{view}")).collect() }
    }

    /// The scene of frame 0; the Gaussians are in the dynamic layer, in the order `order`.
    pub fn scene(&self, order: &[usize]) -> Scene {
        let mut gaussians = Gaussians::zeros(order.len(), 0);
        for (i, &k) in order.iter().enumerate() {
            gaussians.means[i] = self.places[k].as_vec3().to_array();
            gaussians.quats[i] = [1.0, 0.0, 0.0, 0.0];
            gaussians.log_scales[i] = [RADIUS.ln() as f32; 3];
            gaussians.opacity_logits[i] = 2.0;
        }
        let covariances = vec![DMat3::from_diagonal(DVec3::splat(KNOWN * KNOWN)); order.len()];
        let ids = order.iter().map(|&k| k as u32).collect();
        let (next_id, growth_limit) = (self.places.len() as u32, order.len());
        let dynamic = Dynamic { gaussians, covariances, ids, next_id, growth_limit, ..Dynamic::default() };
        Scene::new(Gaussians::zeros(0, 0), dynamic, SkyCube::filled(4, [0.5; 3]))
    }

    /// Training views of a frame.
    pub fn training(&self, frame: usize) -> Vec<TrainingView> {
        let view = |view| {
            let at = ViewAt { split: Split::Train, view, frame };
            let mask = self.mask(at).ok().flatten().unwrap_or_else(|| Mask::filled(SIZE, false));
            TrainingView { camera: camera_of(view), image: picture(at), mask }
        };
        (0..VIEWS).map(view).collect()
    }

    /// Calls `work` with the step into `frame`.
    pub fn with_step<T>(
        &self,
        frame: usize,
        tracks: &[Box<dyn TrackSource>],
        work: impl FnOnce(&Step) -> T,
    ) -> T {
        let (before, now) = (self.training(frame - 1), self.training(frame));
        let views: Vec<usize> = (0..VIEWS).collect();
        work(&Step {
            frame,
            seed: 1,
            capture: self,
            views: &views,
            before: &before,
            now: &now,
            reduced: [&before, &now],
            tracks,
        })
    }

    /// A tracker that sees every Gaussian in every view, without error.
    pub fn tracker(&self) -> Box<dyn TrackSource> {
        Box::new(WorldTracks { world: self.clone(), silent: false })
    }

    /// A tracker that finds nothing.
    pub(crate) fn silent_tracker(&self) -> Box<dyn TrackSource> {
        Box::new(WorldTracks { world: self.clone(), silent: true })
    }

    fn places_at(&self, frame: usize) -> impl Iterator<Item = DVec3> {
        self.places.iter().map(move |place| *place + frame as f64 * self.step)
    }
}

/// The tracker of a [`World`]. Its name is `exact`.
#[derive(Clone, Debug)]
pub struct WorldTracks {
    world: World,
    silent: bool,
}

impl TrackSource for WorldTracks {
    fn name(&self) -> &'static str {
        "exact"
    }

    fn motion(&self, step: &ViewStep) -> Result<Option<Tracked>, Fault> {
        let camera = camera_of(step.view);
        let mut tracks = TrackSet::default();
        let ends = self.world.places_at(step.frame - 1).zip(self.world.places_at(step.frame));
        for (before, now) in ends.filter(|_| !self.silent) {
            if let (Some(src), Some(tgt)) = (camera.project(before), camera.project(now)) {
                tracks.src.push(src.pixel.as_vec2().to_array());
                tracks.tgt.push(tgt.pixel.as_vec2().to_array());
                tracks.visibility.push(1.0);
            }
        }
        let read = tracks.src.len();
        Ok(Some(Tracked { motion: ViewMotion::Tracks(tracks), read, dropped: 0 }))
    }
}

fn camera_of(view: usize) -> Camera {
    let angle = std::f64::consts::TAU * view as f64 / VIEWS as f64;
    let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 0.8);
    let lens = Intrinsics { fx: 90.0, fy: 90.0, cx: 48.0, cy: 36.0 };
    Camera::new(lens, look_at(eye, DVec3::ZERO), SIZE).expect("a camera in the ring")
}

fn picture(at: ViewAt) -> ImageRgb8 {
    let grey = 40 + 10 * (at.view + at.frame) as u8;
    ImageRgb8::new(SIZE, vec![grey; 3 * SIZE.pixels()]).expect("three bytes per pixel")
}

impl Capture for World {
    fn root(&self) -> &Path {
        Path::new("world")
    }

    fn frames(&self) -> usize {
        FRAMES
    }

    fn views(&self, split: Split) -> &[String] {
        if split == Split::Train { &self.names } else { &[] }
    }

    fn camera(&self, at: ViewAt) -> Result<Camera, Fault> {
        Ok(camera_of(at.view))
    }

    fn image(&self, at: ViewAt) -> Result<ImageRgb8, Fault> {
        Ok(picture(at))
    }

    fn image_file(&self, _: ViewAt) -> Option<PathBuf> {
        None
    }

    /// Discs of three standard deviations about the Gaussians.
    fn mask(&self, at: ViewAt) -> Result<Option<Mask>, Fault> {
        let camera = camera_of(at.view);
        let mut inside = vec![0; SIZE.pixels()];
        for place in self.places_at(at.frame).filter(|_| self.masked) {
            let Some(seen) = camera.project(place) else { continue };
            let radius = 3.0 * RADIUS * camera.intrinsics().fx / seen.depth + 1.0;
            for (pixel, value) in inside.iter_mut().enumerate() {
                let at =
                    glam::DVec2::new((pixel % SIZE.width) as f64 + 0.5, (pixel / SIZE.width) as f64 + 0.5);
                *value |= u8::from(at.distance(seen.pixel) < radius);
            }
        }
        Ok(Some(Mask::new(SIZE, inside).expect("a value per pixel")))
    }

    fn points(&self) -> Result<Option<Points>, Fault> {
        let positions: Vec<[f32; 3]> = self.places_at(0).map(|place| place.as_vec3().to_array()).collect();
        let count = positions.len();
        Ok(Some(Points {
            positions,
            colours: vec![[0.5; 3]; count],
            foreground: vec![true; count],
            dropped: 0,
        }))
    }
}
