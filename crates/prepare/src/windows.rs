//! What views have in common: windows of pixels, compared on the plane of a surface.

use crate::stereo::{StereoPoint, pairs};
use crate::views::{View, at_depth};
use ffgs_core::{Camera, ImageRgb8, ImageSize};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

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

/// Values with mean 0 and length 1.
pub(crate) type Window = [f32; WINDOW];

/// All views, reduced to grey.
pub(crate) struct Pictures<'a> {
    pub views: &'a [View],
    pub grey: Vec<Grey>,
    /// (V) the neighbours of each view.
    pub neighbours: Vec<Vec<usize>>,
}

/// A view, reduced to grey.
pub(crate) struct Grey {
    pub camera: Camera,
    values: Vec<f32>,
    /// Pixels of the photograph to a pixel of this, on each side.
    reduction: usize,
}

/// The middle of a window on a plane, and what a step of a pixel right and down from there is.
pub(crate) struct Patch([DVec3; 3]);

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
        let mut neighbours = vec![Vec::new(); views.len()];
        for (a, b) in pairs(&cameras) {
            neighbours[a].push(b);
            neighbours[b].push(a);
        }
        Self { views, grey: views.par_iter().map(Grey::new).collect(), neighbours }
    }

    /// The neighbours of a view.
    pub(crate) fn others(&self, view: usize) -> impl Iterator<Item = &Grey> {
        self.neighbours[view].iter().map(|&other| &self.grey[other])
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

    /// Whether a pixel of a reduced view lies in the view's mask.
    pub(crate) fn is_foreground(&self, view: usize, pixel: DVec2) -> bool {
        self.views[view].is_foreground(self.grey[view].unreduced(pixel))
    }
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
        Some(Self([middle, on_plane(pixel + DVec2::X)?, on_plane(pixel + DVec2::Y)?]))
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

    /// A window with mean 0 and length 1.
    fn window(&self, Look { middle, right, down }: Look) -> Option<Window> {
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

    /// The window about a pixel of this view; `None` at the border and where it is bare.
    pub(crate) fn own_window(&self, pixel: DVec2) -> Option<Window> {
        self.window(Look { middle: pixel, right: DVec2::X, down: DVec2::Y })
    }

    /// How this view shows a patch; `None` where it does not.
    pub(crate) fn look(&self, Patch(corners): &Patch) -> Option<Look> {
        let [middle, right, down] = corners.map(|p| self.camera.project(p).map(|p| p.pixel));
        Some(Look { middle: middle?, right: right? - middle?, down: down? - middle? })
    }

    /// Correlation of another view's window with what this one shows there, -1 to 1; `None` outside of the image and where this one is bare.
    pub(crate) fn correlation(&self, look: Look, own: &Window) -> Option<f32> {
        let there = self.window(look)?;
        Some(own.iter().zip(there).map(|(a, b)| a * b).sum())
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

/// Against gravity, as far as the cameras stand upright.
pub(crate) fn up(cameras: &[Camera]) -> DVec3 {
    cameras.iter().map(|camera| -(camera.rotation().row(1))).sum::<DVec3>().normalize_or(DVec3::Y)
}
