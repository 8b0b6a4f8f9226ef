//! Points from plane sweeps: for a grid of pixels of every view the plane on which neighbouring views agree (Collins 1996; planes of
//! two directions after Gallup et al. 2007), kept where the neighbours found the same place.

use crate::stereo::{StereoPoint, pairs};
use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Longest side at which images are compared (px): larger ones are reduced.
const LONGEST: usize = 480;
/// Pixels that are looked at, over all views.
const PIXELS: usize = 30_000;
/// Planes of each direction at most.
const PLANES: usize = 192;
/// Pixels on each side of the middle of a window.
const RADIUS: i32 = 3;
/// Values of a window.
const WINDOW: usize = (2 * RADIUS as usize + 1).pow(2);
/// Least standard deviation of a window (grey, 0 to 1): less is noise, and matches everything.
const LEAST_CONTRAST: f32 = 0.015;
/// Least mean correlation with the neighbours that agree best.
const LEAST_SCORE: f32 = 0.75;
/// Neighbours that must agree; others may be occluded.
const AGREEING: usize = 2;
/// The best plane must be better by this than any that is not beside it.
const DISTINCT: f32 = 0.03;
/// Planes beside the best one.
const BESIDE: usize = 3;
/// Neighbours that must have found the same place, where there are at least so many; one of fewer. Stripes that repeat look alike in two views
/// at several depths, but seldom in three.
const CONFIRMING: usize = 2;
const MANY: usize = 4;
/// Largest difference to what a neighbour found (planes).
const SAME: f64 = 2.0;
/// The nearest plane, as a share of the distance to the nearest neighbour, where nothing is known of depths.
const NEAREST: f64 = 0.5;
/// Share of the known depths that lie before the nearest plane but for a factor, and that factor.
const KNOWN_NEAREST: (f64, f64) = (0.02, 0.5);
/// Fewest known points in a view that say how near things are.
const LEAST_KNOWN: usize = 20;
/// Least cosine between a plane's normal and the ray: flatter views of a plane show nothing of it.
const LEAST_COSINE: f64 = 0.08;

/// A view, reduced to grey.
struct Grey {
    camera: Camera,
    values: Vec<f32>,
}

/// What was found at the pixels of a view's grid.
struct Depths {
    stride: f64,
    columns: usize,
    /// Distance between two planes (1/m).
    step: f64,
    /// Inverse depth (1/m) per place of the grid; NaN where nothing was found.
    inverse: Vec<f64>,
}

/// A plane through the point of a pixel at a depth: one of two directions.
type Normal = DVec3;

/// The depths that plane sweeps found in all views.
pub(crate) struct Sweeps<'a> {
    views: &'a [(Camera, ImageRgb8)],
    grey: Vec<Grey>,
    neighbours: Vec<Vec<usize>>,
    depths: Vec<Depths>,
}

impl<'a> Sweeps<'a> {
    /// Sweeps all views. `known` points say how near things are.
    pub(crate) fn new(views: &'a [(Camera, ImageRgb8)], known: &[StereoPoint]) -> Self {
        let grey: Vec<Grey> = views.par_iter().map(|(camera, image)| Grey::new(camera, image)).collect();
        let cameras: Vec<Camera> = views.iter().map(|view| view.0).collect();
        let neighbours = neighbours(&cameras);
        let pixels: usize = grey.iter().map(|view| view.camera.size().pixels()).sum();
        let stride = (pixels as f64 / PIXELS as f64).sqrt().max(1.0);
        let up = up(&cameras);
        let depths = (0..grey.len())
            .map(|view| {
                let others: Vec<&Grey> = neighbours[view].iter().map(|&other| &grey[other]).collect();
                let nearest = nearest(&cameras, view, &neighbours[view], known);
                Depths::find(&grey[view], &others, up, nearest, stride)
            })
            .collect();
        Self { views, grey, neighbours, depths }
    }

    /// Places that a view and enough of its neighbours found.
    pub(crate) fn points(&self) -> Vec<StereoPoint> {
        let of_view = |view: usize| {
            let places = 0..self.depths[view].inverse.len();
            places.filter_map(move |place| self.point(view, place))
        };
        (0..self.grey.len()).into_par_iter().flat_map_iter(of_view).collect()
    }

    fn point(&self, view: usize, place: usize) -> Option<StereoPoint> {
        let position = self.depths[view].point(&self.grey[view].camera, place)?;
        let neighbours = &self.neighbours[view];
        let least = if neighbours.len() < MANY { 1 } else { CONFIRMING };
        (self.finders(neighbours.iter().copied(), position) >= least).then_some(())?;
        let (camera, image) = &self.views[view];
        let (x, y) = camera.pixel_of(position)?;
        Some(StereoPoint { position, colour: image.pixel(y * image.size().width + x) })
    }

    /// Whether a place that was found in another way was found by sweeps, too.
    pub(crate) fn confirm(&self, position: DVec3) -> bool {
        self.finders(0..self.grey.len(), position) >= CONFIRMING
    }

    /// How many of the views found a place.
    fn finders(&self, views: impl Iterator<Item = usize>, position: DVec3) -> usize {
        views.filter(|&view| self.depths[view].holds(&self.grey[view].camera, position)).count()
    }
}

/// (V) the neighbours of each camera.
fn neighbours(cameras: &[Camera]) -> Vec<Vec<usize>> {
    let mut out = vec![Vec::new(); cameras.len()];
    for (a, b) in pairs(cameras) {
        out[a].push(b);
        out[b].push(a);
    }
    out
}

/// Against gravity, as far as the cameras stand upright.
fn up(cameras: &[Camera]) -> DVec3 {
    cameras.iter().map(|camera| -(camera.rotation().row(1))).sum::<DVec3>().normalize_or(DVec3::Y)
}

/// Depth of the nearest plane (m).
fn nearest(cameras: &[Camera], view: usize, neighbours: &[usize], known: &[StereoPoint]) -> f64 {
    let camera = &cameras[view];
    let seen = known.iter().filter_map(|point| camera.project(point.position));
    let mut depths: Vec<f64> = seen.filter(|p| camera.shows(p.pixel)).map(|p| p.depth).collect();
    if depths.len() >= LEAST_KNOWN {
        depths.sort_by(f64::total_cmp);
        return KNOWN_NEAREST.1 * depths[(KNOWN_NEAREST.0 * depths.len() as f64) as usize];
    }
    let distance = |&other: &usize| cameras[other].center().distance(camera.center());
    NEAREST * neighbours.iter().map(distance).fold(f64::INFINITY, f64::min)
}

impl Grey {
    fn new(camera: &Camera, image: &ImageRgb8) -> Self {
        let old = image.size();
        let factor = old.width.max(old.height).div_ceil(LONGEST).max(1);
        let size = ImageSize { width: (old.width / factor).max(1), height: (old.height / factor).max(1) };
        let scale = 1.0 / factor as f64;
        let Intrinsics { fx, fy, cx, cy } = camera.intrinsics();
        let intrinsics = Intrinsics { fx: fx * scale, fy: fy * scale, cx: cx * scale, cy: cy * scale };
        let Ok(reduced) = Camera::new(intrinsics, camera.camera_from_world(), size) else {
            return Self { camera: *camera, values: grey(image, old, 1) };
        };
        Self { camera: reduced, values: grey(image, size, factor) }
    }

    /// Between pixels; `None` at and beyond the border.
    fn at(&self, pixel: DVec2) -> Option<f32> {
        let width = self.camera.size().width;
        let (x, y) = (pixel.x - 0.5, pixel.y - 0.5);
        let inside =
            x >= 0.0 && y >= 0.0 && x < (width - 1) as f64 && y < (self.camera.size().height - 1) as f64;
        if !inside {
            return None;
        }
        let (u, v) = (x.fract() as f32, y.fract() as f32);
        let first = y as usize * width + x as usize;
        let row = |from: usize| self.values[from] * (1.0 - u) + self.values[from + 1] * u;
        Some(row(first) * (1.0 - v) + row(first + width) * v)
    }

    /// A window about a pixel, as an affine map shows it: the pixel and what a step right and down are; with mean 0 and length 1.
    fn window(&self, [middle, right, down]: [DVec2; 3]) -> Option<[f32; WINDOW]> {
        let mut out = [0.0; WINDOW];
        let offsets = (-RADIUS..=RADIUS).flat_map(|y| (-RADIUS..=RADIUS).map(move |x| (x, y)));
        for (value, (x, y)) in out.iter_mut().zip(offsets) {
            *value = self.at(middle + right * f64::from(x) + down * f64::from(y))?;
        }
        let mean = out.iter().sum::<f32>() / WINDOW as f32;
        out.iter_mut().for_each(|value| *value -= mean);
        let length = out.iter().map(|v| v * v).sum::<f32>().sqrt();
        (length > LEAST_CONTRAST * (WINDOW as f32).sqrt()).then(|| out.map(|value| value / length))
    }
}

/// Means over squares of `factor` pixels.
fn grey(image: &ImageRgb8, size: ImageSize, factor: usize) -> Vec<f32> {
    let old = image.size().width;
    let mean = |x: usize, y: usize| {
        let square = (0..factor * factor).map(|i| (y * factor + i / factor) * old + x * factor + i % factor);
        square.map(|pixel| image.pixel(pixel).iter().sum::<f32>()).sum::<f32>() / (3 * factor * factor) as f32
    };
    (0..size.pixels()).map(|i| mean(i % size.width, i / size.width)).collect()
}

impl Depths {
    fn find(view: &Grey, others: &[&Grey], up: Normal, nearest: f64, stride: f64) -> Self {
        let size = view.camera.size();
        let [columns, rows] = [size.width, size.height].map(|side| ((side as f64 / stride) as usize).max(1));
        let step = step(view, others, nearest);
        let find = |place: usize| {
            let pixel = pixel(place, columns, stride);
            inverse_depth(view, others, pixel, [None, Some(up)], (1.0 / nearest, step)).unwrap_or(f64::NAN)
        };
        let found = nearest.is_finite() && nearest > 0.0 && !others.is_empty();
        let places = if found { columns * rows } else { 0 };
        Self { stride, columns, step, inverse: (0..places).into_par_iter().map(find).collect() }
    }

    fn point(&self, camera: &Camera, place: usize) -> Option<DVec3> {
        let inverse = self.inverse[place];
        (!inverse.is_nan()).then(|| on_ray(camera, pixel(place, self.columns, self.stride), 1.0 / inverse))
    }

    /// Whether the view found this place, too.
    fn holds(&self, camera: &Camera, position: DVec3) -> bool {
        let Some(projection) = camera.project(position).filter(|p| camera.shows(p.pixel)) else {
            return false;
        };
        let [x, y] = projection.pixel.to_array().map(|v| (v / self.stride) as usize);
        let near = |v: usize| v.saturating_sub(1)..=v + 1;
        let inverse = 1.0 / projection.depth;
        let columns = self.columns;
        near(y).flat_map(|row| near(x).map(move |column| (column, row))).any(|(column, row)| {
            let found = (column < columns).then(|| self.inverse.get(row * columns + column)).flatten();
            found.is_some_and(|found| (found - inverse).abs() < SAME * self.step)
        })
    }
}

/// The pixel of a place of the grid.
fn pixel(place: usize, columns: usize, stride: f64) -> DVec2 {
    DVec2::new((place % columns) as f64 + 0.5, (place / columns) as f64 + 0.5) * stride
}

/// The point behind a pixel at a depth (m).
fn on_ray(camera: &Camera, pixel: DVec2, depth: f64) -> DVec3 {
    let ray = camera.ray(pixel);
    camera.center() + ray * (depth / camera.rotation().row(2).dot(ray))
}

/// Distance of planes in inverse depth (1/m), at which the picture in the farthest neighbour moves by a pixel.
fn step(view: &Grey, others: &[&Grey], nearest: f64) -> f64 {
    let baseline =
        others.iter().map(|o| o.camera.center().distance(view.camera.center())).fold(0.0, f64::max);
    let pixel = 1.0 / (view.camera.intrinsics().focal() * baseline);
    pixel.max(1.0 / (nearest * PLANES as f64))
}

/// Inverse depth (1/m) of the plane on which `others` agree with `view` about a pixel. Planes face the camera, or have the normals that are given.
fn inverse_depth(
    view: &Grey,
    others: &[&Grey],
    pixel: DVec2,
    normals: [Option<Normal>; 2],
    (nearest, step): (f64, f64),
) -> Option<f64> {
    let own = view.window([pixel, DVec2::X, DVec2::Y])?;
    let planes = (nearest / step) as usize;
    let sweep = |normal: Option<Normal>| -> Vec<f32> {
        (1..=planes)
            .map(|i| score(view, others, (pixel, &own), 1.0 / (step * i as f64), normal).unwrap_or(-1.0))
            .collect()
    };
    let scores = normals.map(sweep);
    let best_of = |scores: &[f32]| (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]));
    let bests = [best_of(&scores[0])?, best_of(&scores[1])?];
    let way = usize::from(scores[1][bests[1]] > scores[0][bests[0]]);
    let (scores, best) = (&scores[way], bests[way]);
    let others = scores.iter().enumerate().filter(|(i, _)| i.abs_diff(best) > BESIDE);
    let second = others.map(|(_, score)| *score).fold(-1.0, f32::max);
    let good = scores[best] > LEAST_SCORE && scores[best] > second + DISTINCT;
    good.then(|| step * (best as f64 + 1.0 + peak(scores, best)))
}

/// Where a parabola through the best score and those beside it has its peak, from -0.5 to 0.5.
fn peak(scores: &[f32], best: usize) -> f64 {
    let beside = |i: usize| scores.get(i).copied().filter(|score| *score > 0.0);
    let (Some(before), Some(after)) = (best.checked_sub(1).and_then(beside), beside(best + 1)) else {
        return 0.0;
    };
    let bend = before - 2.0 * scores[best] + after;
    if bend < 0.0 { f64::from(0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Mean correlation of the neighbours that agree best with the window of a pixel, on a plane at a depth.
fn score(
    view: &Grey,
    others: &[&Grey],
    (pixel, own): (DVec2, &[f32; WINDOW]),
    depth: f64,
    normal: Option<Normal>,
) -> Option<f32> {
    let camera = &view.camera;
    let forward = camera.rotation().row(2);
    let normal = normal.unwrap_or(forward);
    let middle = on_ray(camera, pixel, depth);
    let on_plane = |pixel: DVec2| {
        let ray = camera.ray(pixel);
        let cosine = ray.dot(normal);
        let along = (middle - camera.center()).dot(normal) / cosine;
        (cosine.abs() > LEAST_COSINE && along > 0.0).then(|| camera.center() + ray * along)
    };
    let corners = [Some(middle), on_plane(pixel + DVec2::X), on_plane(pixel + DVec2::Y)];
    let [middle, right, down] = [corners[0]?, corners[1]?, corners[2]?];
    let mut scores: Vec<f32> = others
        .iter()
        .filter_map(|other| {
            let [m, r, d] = [middle, right, down].map(|p| other.camera.project(p).map(|p| p.pixel));
            let (m, r, d) = (m?, r?, d?);
            let there = other.window([m, r - m, d - m])?;
            Some(own.iter().zip(there).map(|(a, b)| a * b).sum())
        })
        .collect();
    scores.sort_unstable_by(|a, b| b.total_cmp(a));
    let agreeing = AGREEING.min(others.len());
    (scores.len() >= agreeing).then(|| scores[..agreeing].iter().sum::<f32>() / agreeing as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat4;

    const SIZE: ImageSize = ImageSize { width: 72, height: 48 };
    /// Wall at this distance (m), floor this far below the cameras (m).
    const WALL: f64 = 6.0;
    const FLOOR: f64 = 1.0;

    /// Grey of a surface at two coordinates (m): smooth noise.
    fn texture(u: f64, v: f64) -> f64 {
        let waves = [(5.1, 1.3), (3.7, -4.1), (-1.9, 6.3), (7.9, 2.7), (0.7, -8.3)];
        0.5 + waves.iter().map(|(a, b)| 0.09 * (a * u + b * v + a * b).sin()).sum::<f64>()
    }

    /// What a camera sees along a ray: the wall, or the floor before it.
    fn hit(camera: &Camera, pixel: DVec2) -> DVec3 {
        let ray = camera.ray(pixel);
        let wall = (WALL - camera.center().z) / ray.z;
        let floor = (FLOOR - camera.center().y) / ray.y;
        camera.center() + ray * if floor > 0.0 { wall.min(floor) } else { wall }
    }

    fn view(i: usize, shade: impl Fn(DVec3, usize) -> f64) -> (Camera, ImageRgb8) {
        let intrinsics = Intrinsics { fx: 60.0, fy: 60.0, cx: 36.0, cy: 24.0 };
        let pose = DMat4::from_translation(DVec3::X * (0.4 - 0.2 * i as f64));
        let camera = Camera::new(intrinsics, pose, SIZE).unwrap();
        let value = |p: usize| {
            let pixel = DVec2::new((p % SIZE.width) as f64 + 0.5, (p / SIZE.width) as f64 + 0.5);
            (shade(hit(&camera, pixel), p) * 255.0).round() as u8
        };
        let data = (0..SIZE.pixels()).flat_map(|p| [value(p); 3]).collect();
        (camera, ImageRgb8::new(SIZE, data).unwrap())
    }

    #[test]
    fn a_wall_and_a_floor_are_found_where_they_are() {
        let shade = |p: DVec3, _| if p.z > WALL - 1e-6 { texture(p.x, p.y) } else { texture(p.x, p.z) };
        let views: Vec<_> = (0..5).map(|i| view(i, shade)).collect();
        let sweeps = Sweeps::new(&views, &[]);
        let found = sweeps.points();
        assert!(found.len() > 5 * SIZE.pixels() / 4, "{} points", found.len());
        let away = |p: &StereoPoint| (p.position.z - WALL).abs().min((p.position.y - FLOOR).abs());
        let mut errors: Vec<f64> = found.iter().map(|p| away(p) / p.position.z).collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 0.01, "median {}", errors[errors.len() / 2]);
        // Two planes are 9 % of the wall's distance apart.
        assert!(errors[errors.len() * 9 / 10] < 0.06, "90 % {}", errors[errors.len() * 9 / 10]);
        let floor = found.iter().filter(|p| p.position.z < 0.8 * WALL && p.position.y > 0.9 * FLOOR).count();
        assert!(floor > found.len() / 10, "{floor} of {} points on the floor", found.len());
        let confirmed = [WALL, 0.5 * WALL].map(|z| sweeps.confirm(DVec3::new(0.0, -0.5, z)));
        assert_eq!(confirmed, [true, false], "on the wall, and before it");
    }

    #[test]
    fn noise_and_bare_walls_give_next_to_nothing() {
        let hash = |i: usize, p: usize| {
            let mixed = ((i * SIZE.pixels() + p) as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            (mixed >> 40) as f64 / (1_u64 << 24) as f64
        };
        let noise: Vec<_> = (0..5).map(|i| view(i, |_, p| hash(i, p))).collect();
        let found = |views: &[_]| Sweeps::new(views, &[]).points().len();
        assert!(found(&noise) < SIZE.pixels() / 50, "{} points in noise", found(&noise));
        let bare: Vec<_> = (0..5).map(|i| view(i, |_, _| 0.6)).collect();
        assert_eq!([found(&bare), found(&bare[..1]), found(&[])], [0; 3]);
    }
}
