//! Two cars as a capture sees them: masks, tracks, flow, Gaussians. Synthetic, the same bytes every time.

use ffgs_core::{Camera, DenseMotion, Gaussians, ImageSize, Intrinsics, Mask, TrackSet, spatial_order};
use ffgs_simulator::{Recipe, Scenario, simulate};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// How large a scene is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    /// In the benchmarks' names.
    pub(crate) name: &'static str,
    /// Views V.
    pub(crate) views: usize,
    /// Image width (px); the height is 9 / 16 of it.
    pub(crate) width: usize,
    /// Gaussians that move.
    pub(crate) moving: usize,
    /// Gaussians that stand.
    pub(crate) fixed: usize,
    /// Tracks of the sparse and the medium tracker in a view, all on the cars.
    pub(crate) tracks: [usize; 2],
}

/// The sample capture's.
pub(crate) const SAMPLE: Scale =
    Scale { name: "sample", views: 20, width: 320, moving: 23_000, fixed: 66_000, tracks: [100, 400] };
/// The paper's.
pub(crate) const PAPER: Scale =
    Scale { name: "paper", views: 60, width: 1920, moving: 200_000, fixed: 200_000, tracks: [400, 4000] };

/// One view at t-1.
#[derive(Clone, Debug)]
pub(crate) struct SceneView {
    /// The cars' pixels.
    pub(crate) mask: Mask,
    /// Those at t.
    pub(crate) mask_now: Mask,
    /// What the sparse and the medium tracker say.
    pub(crate) tracks: [TrackSet; 2],
    /// What the dense tracker says.
    pub(crate) dense: DenseMotion,
}

/// A frame.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    /// (V) cameras of both times.
    pub(crate) cameras: Vec<Camera>,
    /// (V) what they see.
    pub(crate) views: Vec<SceneView>,
    /// (N) places of the moving Gaussians at t-1 (m).
    pub(crate) previous: Vec<DVec3>,
    /// (N) places at t (m).
    pub(crate) truth: Vec<DVec3>,
    /// Both layers, the moving one first.
    pub(crate) joint: Gaussians,
}

impl Scale {
    /// For the names of benchmarks.
    pub(crate) fn label(&self) -> String {
        let Self { name, views, width, moving, .. } = *self;
        format!("{name}_{views}views_{width}x{}_{moving}gaussians", width * 9 / 16)
    }

    /// Half a square that leaves no gaps between neighbouring Gaussians (px).
    fn radius(&self) -> usize {
        (self.width / 640).max(1)
    }

    /// The first `views` views.
    pub(crate) fn scene(&self, views: usize) -> Scene {
        let recipe = Recipe {
            scenario: Scenario::TwoSpeeds,
            views: self.views,
            gaussians: self.moving,
            trackers: 0,
            smooth: 0.0,
            ..Recipe::default()
        };
        let simulated = simulate(&recipe);
        let cameras: Vec<Camera> = simulated.cameras.iter().take(views).map(|c| self.enlarged(c)).collect();
        // As a run keeps its layers.
        let places: Vec<[f32; 3]> = simulated.previous.iter().map(|p| p.as_vec3().to_array()).collect();
        let order = spatial_order(&places);
        let [previous, truth] = [simulated.previous, simulated.truth]
            .map(|column| order.iter().map(|&i| column[i]).collect::<Vec<_>>());
        let views = cameras.par_iter().map(|camera| self.see(camera, &previous, &truth)).collect();
        let joint = self.gaussians(&previous);
        Scene { cameras, views, previous, truth, joint }
    }

    /// The simulator's camera with this scale's image.
    fn enlarged(&self, camera: &Camera) -> Camera {
        let factor = self.width as f64 / camera.size().width as f64;
        let Intrinsics { fx, fy, cx, cy } = camera.intrinsics();
        let intrinsics = Intrinsics { fx: fx * factor, fy: fy * factor, cx: cx * factor, cy: cy * factor };
        let size = ImageSize { width: self.width, height: self.width * 9 / 16 };
        Camera::new(intrinsics, camera.camera_from_world(), size).expect("a camera, enlarged")
    }

    /// Draws the nearest Gaussian at every pixel as a square; errors of a pixel in each tracker.
    fn see(&self, camera: &Camera, previous: &[DVec3], truth: &[DVec3]) -> SceneView {
        let size = camera.size();
        let mut depths = vec![f64::INFINITY; size.pixels()];
        let mut dense = DenseMotion::unknown(size);
        let mut noise = Noise(1);
        let projected: Vec<Option<(DVec2, DVec2, f64)>> = previous
            .iter()
            .zip(truth)
            .map(|(&a, &b)| {
                let (a, b) = (camera.project(a)?, camera.project(b)?);
                camera.shows(a.pixel).then_some((a.pixel, b.pixel - a.pixel, a.depth))
            })
            .collect();
        for &(at, flow, depth) in projected.iter().flatten() {
            let flow = flow + noise.pair();
            for pixel in square(at, self.radius(), size) {
                if depth < depths[pixel] {
                    depths[pixel] = depth;
                    dense.flow[pixel] = flow.as_vec2().to_array();
                    dense.confidence[pixel] = 1.0;
                    dense.visibility[pixel] = 1.0;
                }
            }
        }
        let foreground: Vec<u8> = depths.iter().map(|d| u8::from(d.is_finite())).collect();
        let front = |&&(at, _, depth): &&(DVec2, DVec2, f64)| {
            depth < depths[at.y as usize * size.width + at.x as usize] + 0.1
        };
        let visible: Vec<_> = projected.iter().flatten().filter(front).collect();
        let tracks = self.tracks.map(|count| {
            let mut set = TrackSet::default();
            for &&(at, flow, _) in visible.iter().step_by((visible.len() / count).max(1)) {
                set.src.push(at.as_vec2().to_array());
                set.tgt.push((at + flow + noise.pair()).as_vec2().to_array());
                set.visibility.push(1.0);
            }
            set
        });
        let mut now = vec![0; size.pixels()];
        for (column, row) in truth.iter().filter_map(|&p| camera.pixel_of(p)) {
            let at = DVec2::new(column as f64, row as f64);
            square(at, self.radius(), size).for_each(|pixel| now[pixel] = 1);
        }
        let mask = |data| Mask::new(size, data).expect("one byte per pixel");
        SceneView { mask: mask(foreground), mask_now: mask(now), tracks, dense }
    }

    /// Splats as wide as the distance between the cars' points, and a floor.
    fn gaussians(&self, moving: &[DVec3]) -> Gaussians {
        const CARS_M2: f64 = 56.0;
        const FLOOR_M: f64 = 40.0;
        let spacing = (CARS_M2 / moving.len() as f64).sqrt();
        let side = (self.fixed as f64).sqrt().ceil() as usize;
        let floor = (0..self.fixed).map(|i| {
            let at = |k: usize| (k as f64 / side as f64 - 0.5) * FLOOR_M;
            DVec3::new(at(i % side), at(i / side), 0.0)
        });
        let mut out = Gaussians::empty(0);
        let sizes = [(moving.len(), spacing), (self.fixed, FLOOR_M / side as f64)];
        for (count, spacing) in sizes {
            out.log_scales.extend(std::iter::repeat_n([(0.6 * spacing).ln() as f32; 3], count));
        }
        let floor: Vec<[f32; 3]> = floor.map(|p| p.as_vec3().to_array()).collect();
        out.means.extend(moving.iter().map(|p| p.as_vec3().to_array()));
        out.means.extend(spatial_order(&floor).into_iter().map(|i| floor[i]));
        out.quats.resize(out.means.len(), [1.0, 0.0, 0.0, 0.0]);
        out.opacity_logits.resize(out.means.len(), 1.0);
        out.sh.resize(out.means.len(), [0.0; 3]);
        out
    }
}

/// Pixels of the square of `2 radius + 1` around a position.
fn square(at: DVec2, radius: usize, size: ImageSize) -> impl Iterator<Item = usize> {
    let range = |v: f64, end: usize| (v as usize).saturating_sub(radius)..(v as usize + radius + 1).min(end);
    let columns = range(at.x, size.width);
    range(at.y, size.height).flat_map(move |y| columns.clone().map(move |x| y * size.width + x))
}

/// Errors of about a pixel, from a linear congruential generator.
struct Noise(u64);

impl Noise {
    fn one(&mut self) -> f64 {
        let mut sum = 0.0;
        for _ in 0..3 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (self.0 >> 40) as f64 / (1_u64 << 24) as f64 - 0.5;
        }
        2.0 * sum
    }

    fn pair(&mut self) -> DVec2 {
        DVec2::new(self.one(), self.one())
    }
}
