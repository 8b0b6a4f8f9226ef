//! What views have in common: windows of pixels, compared on the plane of a surface.

use crate::stereo::{NEIGHBOURS, StereoPoint, WIDEST_ANGLE, pairs};
use crate::views::{View, at_depth};
use ffgs_core::{Camera, ImageRgb8, ImageSize, Mask};
use glam::{DVec2, DVec3, Vec2};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Longest side at which images are compared (px): larger ones are reduced.
const LONGEST: usize = 480;
/// Pixels on each side of the middle of a window.
const RADIUS: i32 = 3;
/// Values of a window.
const WINDOW: usize = (2 * RADIUS as usize + 1).pow(2);
/// Least standard deviation of a window (grey, 0 to 1): less is noise, and matches everything.
const LEAST_CONTRAST: f32 = 0.015;
/// Least cosine between a plane's normal and the ray: flatter views of a plane show nothing of it.
const LEAST_COSINE: f64 = 0.08;

/// Neighbours that may show the same surface, wherever they look.
const AROUND: usize = 8;

/// What a view shows about a pixel.
pub(crate) struct Window {
    /// With mean 0 and length 1.
    values: Values,
    /// Distance between two of them (px).
    spacing: f64,
}

type Values = [f32; WINDOW];

/// All views, reduced to grey.
pub(crate) struct Pictures<'a> {
    pub views: &'a [View],
    pub grey: Vec<Grey>,
    /// (V) the nearest views of each that look the same way.
    pub alike: Vec<Vec<usize>>,
    /// (V) the nearest views of each, wherever they look.
    pub around: Vec<Vec<usize>>,
}

/// A view, reduced to grey.
pub(crate) struct Grey {
    pub camera: Camera,
    values: Vec<f32>,
    /// Pixels of the photograph to a pixel of this, on each side.
    reduction: usize,
}

/// A piece of a plane.
pub(crate) struct Patch {
    /// The middle of a window, and what is a pixel right and down from there.
    corners: [DVec3; 3],
    normal: DVec3,
    /// From which side it was seen: the sign of `normal . (camera - middle)`.
    side: f64,
}

/// How a view shows a patch: the pixel of its middle, and what the steps are there (px).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    middle: DVec2,
    right: DVec2,
    down: DVec2,
}

impl Look {
    /// Area in which it shows a pixel of the patch (px^2).
    pub(crate) fn area(self) -> f64 {
        self.right.perp_dot(self.down).abs()
    }
}

impl<'a> Pictures<'a> {
    pub(crate) fn new(views: &'a [View]) -> Self {
        let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
        let alike = neighbours(&cameras, NEIGHBOURS, WIDEST_ANGLE);
        let around = neighbours(&cameras, AROUND, PI);
        Self { views, grey: views.par_iter().map(Grey::new).collect(), alike, around }
    }

    /// The pictures of some views.
    pub(crate) fn of<'b>(&'b self, views: &'b [usize]) -> impl Iterator<Item = &'b Grey> {
        views.iter().map(|&view| &self.grey[view])
    }

    /// Pixels from place to place of grids that have so many places over all views.
    pub(crate) fn stride(&self, places: usize) -> f64 {
        let pixels: usize = self.grey.iter().map(|view| view.camera.size().pixels()).sum();
        (pixels as f64 / places as f64).sqrt().max(1.0)
    }

    /// A point at a pixel of a reduced view, with the photograph's colour there.
    pub(crate) fn point(&self, view: usize, pixel: DVec2, depth: f64) -> StereoPoint {
        let grey = &self.grey[view];
        let colour = self.views[view].colour(grey.unreduced(pixel));
        StereoPoint { position: at_depth(&grey.camera, pixel, depth), colour }
    }

    /// Area (px^2) of a view's mask in the reduced view.
    pub(crate) fn foreground_area(&self, view: usize) -> f64 {
        let count = self.views[view].mask.as_ref().map_or(0, Mask::count);
        count as f64 / self.grey[view].reduction.pow(2) as f64
    }

    /// Whether a pixel of a reduced view lies in the view's mask.
    pub(crate) fn is_foreground(&self, view: usize, pixel: DVec2) -> bool {
        self.views[view].is_foreground(self.grey[view].unreduced(pixel))
    }
}

/// (V) of each camera those that it is paired with.
fn neighbours(cameras: &[Camera], count: usize, widest: f64) -> Vec<Vec<usize>> {
    let mut out = vec![Vec::new(); cameras.len()];
    for (a, b) in pairs(cameras, count, widest) {
        out[a].push(b);
        out[b].push(a);
    }
    out
}

/// Columns and rows of a grid.
pub(crate) fn grid(size: ImageSize, stride: f64) -> [usize; 2] {
    [size.width, size.height].map(|side| ((side as f64 / stride) as usize).max(1))
}

/// The pixel of a place of a grid.
pub(crate) fn pixel(place: usize, columns: usize, stride: f64) -> DVec2 {
    DVec2::new((place % columns) as f64 + 0.5, (place / columns) as f64 + 0.5) * stride
}

impl Patch {
    /// On the plane through the point of a pixel at a depth (m); `None` where the view is too flat.
    pub(crate) fn new(camera: &Camera, pixel: DVec2, depth: f64, normal: DVec3) -> Option<Self> {
        let middle = at_depth(camera, pixel, depth);
        let on_plane = |pixel: DVec2| {
            let ray = camera.ray(pixel);
            let cosine = ray.dot(normal);
            let along = (middle - camera.center()).dot(normal) / cosine;
            (cosine.abs() > LEAST_COSINE && along > 0.0).then(|| camera.center() + ray * along)
        };
        let corners = [middle, on_plane(pixel + DVec2::X)?, on_plane(pixel + DVec2::Y)?];
        Some(Self { corners, normal, side: normal.dot(camera.center() - middle).signum() })
    }

    /// Angle between the rays of two cameras to its middle (radians).
    pub(crate) fn angle(&self, a: &Camera, b: &Camera) -> f64 {
        let [a, b] = [a, b].map(|camera| self.corners[0] - camera.center());
        a.angle_between(b)
    }

    /// Whether a camera is on the side from which it was seen.
    fn faces(&self, camera: &Camera) -> bool {
        self.side * self.normal.dot(camera.center() - self.corners[0]) > 0.0
    }
}

impl Grey {
    fn new(View { camera, image, .. }: &View) -> Self {
        let size = image.size();
        let wanted = size.width.max(size.height).div_ceil(LONGEST).max(1);
        let camera = camera.reduced(wanted);
        // What is a few pixels high stays as it is.
        let reduction = if camera.size() == size { 1 } else { wanted };
        Self { camera, values: grey(image, camera.size(), reduction), reduction }
    }

    /// The pixel of the photograph.
    fn unreduced(&self, pixel: DVec2) -> DVec2 {
        pixel * self.reduction as f64
    }

    /// Values between pixels about a middle, with mean 0 and length 1; `None` at and beyond the border, and where it is bare.
    fn values(&self, Look { middle, right, down }: Look, spacing: f64) -> Option<Values> {
        let ImageSize { width, height } = self.camera.size();
        let [first, right, down] = [middle - 0.5, right * spacing, down * spacing].map(DVec2::as_vec2);
        let at = |x: i32, y: i32| first + right * x as f32 + down * y as f32;
        let last = Vec2::new(width as f32, height as f32) - 1.0;
        let inside = |p: Vec2| p.cmpge(Vec2::ZERO).all() && p.cmplt(last).all();
        if ![-RADIUS, RADIUS].into_iter().all(|y| inside(at(-RADIUS, y)) && inside(at(RADIUS, y))) {
            return None;
        }
        let mut out = [0.0; WINDOW];
        let offsets = (-RADIUS..=RADIUS).flat_map(|y| (-RADIUS..=RADIUS).map(move |x| (x, y)));
        for (value, (x, y)) in out.iter_mut().zip(offsets) {
            let p = at(x, y);
            let [column, row] = p.to_array().map(|v| v as usize);
            let (u, v) = (p.x - column as f32, p.y - row as f32);
            let upper = row * width + column;
            let across = |from: usize| self.values[from] * (1.0 - u) + self.values[from + 1] * u;
            *value = across(upper) * (1.0 - v) + across(upper + width) * v;
        }
        let mean = out.iter().sum::<f32>() / WINDOW as f32;
        out.iter_mut().for_each(|value| *value -= mean);
        let length = out.iter().map(|v| v * v).sum::<f32>().sqrt();
        (length > LEAST_CONTRAST * (WINDOW as f32).sqrt()).then(|| out.map(|value| value / length))
    }

    /// The window about a pixel of this view, whose values are so far from each other (px); `None` at the border and where it is bare.
    pub(crate) fn own_window(&self, pixel: DVec2, spacing: f64) -> Option<Window> {
        let values = self.values(Look { middle: pixel, right: DVec2::X, down: DVec2::Y }, spacing)?;
        Some(Window { values, spacing })
    }

    /// How this view shows a patch; `None` where it does not, or from behind.
    pub(crate) fn look(&self, patch: &Patch) -> Option<Look> {
        if !patch.faces(&self.camera) {
            return None;
        }
        let [middle, right, down] = patch.corners.map(|p| self.camera.project(p).map(|p| p.pixel));
        Some(Look { middle: middle?, right: right? - middle?, down: down? - middle? })
    }

    /// Correlation of another view's window with what this one shows there, -1 to 1; `None` outside of the image and where this one is bare.
    pub(crate) fn correlation(&self, look: Look, own: &Window) -> Option<f32> {
        let there = self.values(look, own.spacing)?;
        Some(own.values.iter().zip(there).map(|(a, b)| a * b).sum())
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
