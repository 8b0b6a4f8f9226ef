//! What moving things hide in the first frame: the surfaces around them, continued behind them (docs/adr/0093-surfaces-continue-behind-what-moves.md).

use crate::disocclusion::hidden;
use crate::outside::{HIDDEN_BELOW, shown_weights};
use crate::reconstructor::Reconstructor;
use anyhow::Result;
use ffgs_core::{Camera, Gaussians, ImageSize, Mask, Scene, StageLog, TrainingView, connected, stage};
use ffgs_fusion::first_of_each_cell;
use ffgs_motion::MarkingConfig;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, TopContributors, View};
use ffgs_trainer::from_points;
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// With less opacity, the static layer has a hole; with more of it, a surface.
const OPAQUE: f32 = 0.75;
/// Width of the ring around a mask whose surfaces continue behind it; in pixels of an image of 320, as `marking.dilation`.
const RING: usize = 12;
/// Fewest surface Gaussians of a ring that fix a plane.
const LEAST_SURFACE: usize = 12;
/// Three Gaussians are tried as a plane so often.
const TRIALS: usize = 200;
/// Share of a ring that lies in the plane which is continued.
const PLANE_SHARE: f64 = 0.3;
/// Distance from a plane, as a share of that from the camera, at which a Gaussian lies in it.
const TOLERANCE: f64 = 0.01;
/// A plane ends at so many times the distance of the ring's farthest Gaussian.
const REACH: f64 = 1.5;
/// Pixels from one point to the next; of photographs that are as large as the moving layer's splats can show, whatever their own size.
const STRIDE: usize = 2;
/// Views that show a surface in the open behind a point deny it.
const DENIALS: usize = 2;
/// Margin of depth for that.
const IN_FRONT: f64 = 0.97;
/// Opacity of what continues a surface.
const OPACITY: f32 = 0.9;

/// What a view shows of the layers.
struct Shown<'a> {
    view: &'a TrainingView,
    mask: Mask,
    /// Index of the static Gaussian that each pixel shows most of; -1 where there is a hole.
    surface: Vec<i32>,
    /// Depth of the moving Gaussian that each pixel shows most of; 0 where there is none.
    body: Vec<f32>,
}

/// A point of a continued surface.
struct Point {
    position: DVec3,
    colour: [f32; 3],
    spacing: f64,
}

impl Reconstructor<'_> {
    /// Static Gaussians behind what moves in a first frame, where nothing is known yet of what is hidden there. `views` are all that it was trained on.
    pub(crate) fn continue_surfaces(
        &self,
        scene: &mut Scene,
        views: &[TrainingView],
        log: &mut StageLog,
    ) -> Result<()> {
        let config = &self.config.disocclusion;
        // Marking in every frame would take what lies behind the masks for what moves.
        let is_off = !config.continued || config.iterations == 0 || self.config.marking.every_frame;
        if is_off || !self.method.births() || !scene.hidden.is_empty() {
            return Ok(());
        }
        let start = Instant::now();
        let views = &self.reduced(scene, views).views;
        let added = behind(&self.config.marking, scene, views);
        let rounds = hidden(config, &added, views, self.config.marking.dilation)?;
        let added = added.select(&(0..added.len()).filter(|&i| rounds[i] > 0).collect::<Vec<_>>());
        Arc::make_mut(&mut scene.static_layer).extend(&added);
        log.change("continued behind what moves", added.len());
        log.since(stage::DISOCCLUSION, start);
        Ok(())
    }
}

/// Gaussians that continue the surfaces around the masks of `views` where the static layer has holes behind them, and that none of the views shows.
fn behind(marking: &MarkingConfig, scene: &Scene, views: &[TrainingView]) -> Gaussians {
    let [fixed, moving] = scene.layers();
    let shown: Vec<Shown> = views.par_iter().map(|view| Shown::new(marking, fixed, moving, view)).collect();
    let points = shown.par_iter().flat_map_iter(|shown| shown.continued(fixed));
    let points = points.filter(|point| !is_denied(point.position, fixed, &shown)).collect();
    let (positions, colours): (Vec<_>, Vec<_>) =
        thinned(points).iter().map(|p| (p.position.as_vec3().to_array(), p.colour)).unzip();
    let added = from_points(&positions, &colours, fixed.sh_degree(), OPACITY).with_filter(fixed.filter);
    let mut all = added.clone();
    all.extend(fixed);
    all.extend(moving);
    let weights = shown_weights(marking, &all, views);
    added.select(&(0..added.len()).filter(|&i| weights[i][1] < HIDDEN_BELOW).collect::<Vec<_>>())
}

/// One point per cell of the median spacing, the finest first.
fn thinned(mut points: Vec<Point>) -> Vec<Point> {
    points.sort_by(|a, b| a.spacing.total_cmp(&b.spacing));
    let Some(cell) = points.get(points.len() / 2).map(|p| p.spacing) else { return points };
    first_of_each_cell(&mut points, cell, |p| p.position);
    points
}

/// Whether a place lies before what moves in any view, or before a static surface in [`DENIALS`] of them.
fn is_denied(place: DVec3, fixed: &Gaussians, shown: &[Shown]) -> bool {
    let mut denials = 0;
    for Shown { view, mask, surface, body } in shown {
        let Some((x, y)) = view.camera.pixel_of(place) else { continue };
        let pixel = y * view.camera.size().width + x;
        let depth_here = depth(&view.camera, place);
        if depth_here < f64::from(body[pixel]) {
            return true;
        }
        if let Some(surface) = usize::try_from(surface[pixel]).ok().filter(|_| !mask.contains(x, y)) {
            denials += usize::from(depth_here < IN_FRONT * depth(&view.camera, at(fixed, surface)));
        }
    }
    denials >= DENIALS
}

fn at(layer: &Gaussians, i: usize) -> DVec3 {
    Vec3::from(layer.means[i]).as_dvec3()
}

fn depth(camera: &Camera, place: DVec3) -> f64 {
    camera.project(place).map_or(0.0, |p| p.depth)
}

impl<'a> Shown<'a> {
    fn new(marking: &MarkingConfig, fixed: &Gaussians, moving: &Gaussians, view: &'a TrainingView) -> Self {
        let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
        let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: None };
        let mut tape = RenderTape::default();
        rasterizer.render(fixed, &frame, &mut tape);
        let top = TopContributors::of(&tape, view.camera.size(), 1, |_| true);
        let pixels = top.indices.iter().zip(tape.transmittance());
        let surface = pixels.map(|(&i, &behind)| if 1.0 - behind < OPAQUE { -1 } else { i }).collect();
        let top = rasterizer.top_contributors(moving, &frame, 1, &mut tape);
        let body = top
            .indices
            .iter()
            .map(|&i| usize::try_from(i).map_or(0.0, |i| depth(&view.camera, at(moving, i)) as f32));
        Self { view, mask: view.mask.widened(marking.dilation), surface, body: body.collect() }
    }

    /// Points in the holes behind the mask.
    fn continued(&self, fixed: &Gaussians) -> Vec<Point> {
        let ImageSize { width, .. } = self.view.camera.size();
        let held = self.mask.data();
        let mut seen = vec![false; held.len()];
        let mut out = Vec::new();
        for start in 0..held.len() {
            if held[start] == 0 || seen[start] {
                continue;
            }
            let part = connected(start, width, &mut seen, |_, other| held[other] != 0);
            if part.iter().any(|&p| self.surface[p] < 0) {
                out.extend(self.behind_part(&part, fixed));
            }
        }
        out
    }

    /// Those behind a part of the mask.
    fn behind_part(&self, part: &[usize], fixed: &Gaussians) -> Vec<Point> {
        let camera = &self.view.camera;
        let size = camera.size();
        let mut data = vec![0; size.pixels()];
        part.iter().for_each(|&p| data[p] = 1);
        let Some(ring) = Mask::new(size, data).map(|mask| mask.widened(RING)) else { return Vec::new() };
        // Pixels that show each Gaussian around the part.
        let mut around = BTreeMap::<usize, f64>::new();
        for p in (0..size.pixels()).filter(|&p| ring.data()[p] != 0 && self.mask.data()[p] == 0) {
            if let Ok(i) = usize::try_from(self.surface[p]) {
                *around.entry(i).or_default() += 1.0;
            }
        }
        let around: Vec<Sample> =
            around.iter().filter_map(|(&i, &weight)| self.sample(at(fixed, i), weight)).collect();
        let Some(plane) = plane(&around) else { return Vec::new() };
        let reach = REACH * around.iter().map(|s| s.depth).fold(0.0, f64::max);
        let holes = part.iter().filter(|&&p| {
            self.surface[p] < 0
                && (p % size.width).is_multiple_of(STRIDE)
                && (p / size.width).is_multiple_of(STRIDE)
        });
        holes.filter_map(|&p| self.point(p, &plane, reach)).collect()
    }

    fn sample(&self, position: DVec3, weight: f64) -> Option<Sample> {
        let camera = &self.view.camera;
        let projection = camera.project(position)?;
        let (x, y) = camera.pixel_of(position)?;
        let colour = self.view.image.pixel(y * camera.size().width + x);
        Some(Sample { position, pixel: projection.pixel, depth: projection.depth, colour, weight })
    }

    /// Where a pixel looks at the plane, if that is behind the body.
    fn point(&self, p: usize, plane: &Plane, reach: f64) -> Option<Point> {
        let camera = &self.view.camera;
        let width = camera.size().width;
        let pixel = DVec2::new((p % width) as f64 + 0.5, (p / width) as f64 + 0.5);
        let (ray, centre) = (camera.ray(pixel), camera.center());
        let along = (plane.offset - plane.normal.dot(centre)) / plane.normal.dot(ray);
        let position = centre + along * ray;
        let depth = depth(camera, position);
        let spacing = STRIDE as f64 * depth / camera.intrinsics().focal();
        let is_behind = along > 0.0 && depth > f64::from(self.body[p]) && depth < reach;
        is_behind.then(|| Point { position, colour: plane.colour(pixel), spacing })
    }
}

/// A static Gaussian that is seen beside a mask.
#[derive(Clone, Copy)]
struct Sample {
    position: DVec3,
    pixel: DVec2,
    depth: f64,
    colour: [f32; 3],
    weight: f64,
}

/// A plane, `normal . x = offset` with a unit normal, and what lies in it.
struct Plane {
    normal: DVec3,
    offset: f64,
    members: Vec<Sample>,
}

impl Plane {
    fn through(corners: [&Sample; 3]) -> Option<Self> {
        let [a, b, c] = corners.map(|s| s.position);
        let normal = (b - a).cross(c - a).try_normalize()?;
        Some(Self { normal, offset: normal.dot(a), members: Vec::new() })
    }

    fn holds(&self, sample: &Sample) -> bool {
        (self.normal.dot(sample.position) - self.offset).abs() < TOLERANCE * sample.depth
    }

    /// Mean of its members' colours, by their distances in the image.
    fn colour(&self, pixel: DVec2) -> [f32; 3] {
        let (mut sum, mut weights) = ([0.0_f64; 3], 0.0);
        for member in &self.members {
            let weight = member.weight / (1.0 + member.pixel.distance_squared(pixel));
            weights += weight;
            (0..3).for_each(|c| sum[c] += weight * f64::from(member.colour[c]));
        }
        sum.map(|s| (s / weights) as f32)
    }
}

/// The plane that most of `samples` lie in, if enough do.
fn plane(samples: &[Sample]) -> Option<Plane> {
    if samples.len() < LEAST_SURFACE {
        return None;
    }
    let weight = |plane: Option<&Plane>| -> f64 {
        let members = samples.iter().filter(|s| plane.is_none_or(|plane| plane.holds(s)));
        members.map(|s| s.weight).sum()
    };
    let tried = (1..=TRIALS).filter_map(|k| Plane::through(triple(k, samples)));
    let weighed = tried.map(|plane| (weight(Some(&plane)), plane));
    let (held, mut plane) = weighed.max_by(|a, b| a.0.total_cmp(&b.0))?;
    plane.members = samples.iter().filter(|s| plane.holds(s)).copied().collect();
    (held >= PLANE_SHARE * weight(None)).then_some(plane)
}

/// The k-th three of the samples, by a sequence that fills the cube evenly (Roberts' R3).
fn triple(k: usize, samples: &[Sample]) -> [&Sample; 3] {
    [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3_f64]
        .map(|step| &samples[((k as f64 * step).fract() * samples.len() as f64) as usize])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{ball, photographs_from, scene, without_masks};
    use ffgs_core::ImageRgb8;
    use ffgs_trainer::DisocclusionConfig;

    const FLOOR: f32 = -0.65;
    /// Of the cameras: they look down on the floor.
    const HEIGHT: f64 = 3.0;
    const GREEN: [f32; 3] = [0.2, 0.6, 0.3];

    /// A floor of discs every 5 cm under the ball.
    fn floor() -> Gaussians {
        let place = |i: usize| [(i % 81) as f32 * 0.05 - 2.0, (i / 81) as f32 * 0.05 - 2.0, FLOOR];
        let places: Vec<[f32; 3]> = (0..81 * 81).map(place).collect();
        from_points(&places, &vec![GREEN; places.len()], 1, 0.95)
    }

    /// The ball on the floor, its photographs, and the floor that they show.
    fn on_the_floor() -> (Scene, Vec<TrainingView>) {
        let (floor, ball) = (floor(), ball(Vec3::ZERO));
        let mut joint = floor.clone();
        joint.extend(&ball);
        let mut views = photographs_from(&ball, HEIGHT);
        for (view, shown) in views.iter_mut().zip(photographs_from(&joint, HEIGHT)) {
            view.image = shown.image;
        }
        let known = hidden(&DisocclusionConfig::default(), &floor, &views, 1).unwrap();
        let known: Vec<usize> = (0..floor.len()).filter(|&i| known[i] == 0).collect();
        assert!(floor.len() - known.len() > 30, "the ball hides some of it");
        (Scene { static_layer: floor.select(&known).into(), ..scene(&ball) }, views)
    }

    fn found(scene: &Scene, views: &[TrainingView]) -> Gaussians {
        behind(&MarkingConfig { dilation: 1, ..MarkingConfig::default() }, scene, views)
    }

    #[test]
    fn the_floor_goes_on_under_the_ball() {
        let (scene, views) = on_the_floor();
        let added = found(&scene, &views);
        assert!(added.len() >= 8, "{} added", added.len());
        let stride = added.sh_stride();
        for (i, place) in added.positions().iter().enumerate() {
            assert!((place.z - f64::from(FLOOR)).abs() < 0.02, "{place} is not in the floor");
            assert!(place.truncate().length() < 1.5, "{place} is far from the ball");
            let green = 0.5 + ffgs_core::SH_C0 * added.sh[i * stride][1];
            assert!((green - GREEN[1]).abs() < 0.05, "{green}");
        }
    }

    #[test]
    fn without_a_hole_a_mask_or_a_surface_nothing_is_continued() {
        let (scene, views) = on_the_floor();
        let whole = Scene { static_layer: floor().into(), ..scene.clone() };
        assert!(found(&whole, &views).len() < 10, "no hole: {}", found(&whole, &views).len());
        assert_eq!(found(&scene, &without_masks(views.clone())).len(), 0);
        let bare = Scene { static_layer: Gaussians::zeros(0, 1).into(), ..scene.clone() };
        assert_eq!(found(&bare, &views).len(), 0, "no surface");
        assert_eq!(found(&scene, &[]).len(), 0, "no view");
        let black = ImageRgb8::new(views[0].image.size(), vec![0; views[0].image.data().len()]).unwrap();
        let dark: Vec<TrainingView> =
            views.into_iter().map(|view| TrainingView { image: black.clone(), ..view }).collect();
        let stride = scene.static_layer.sh_stride();
        let added = found(&scene, &dark);
        assert!(added.sh.chunks(stride).all(|sh| sh[0][1] < -1.0), "colours are those of the photographs");
    }
}
