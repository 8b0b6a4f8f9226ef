//! What the layer shows of each group in a view.

use ffgs_core::{Camera, Gaussians, PlanarImage, TrainingView};
use ffgs_fusion::Groups;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, TileMask, TopContributors, View};
use glam::{DVec2, DVec3};

/// A point of the surface that a pixel shows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfacePoint {
    /// Where it is (m).
    pub place: DVec3,
    /// Its rendered brightness, 0..1.
    pub value: f64,
    /// The pixel.
    pub pixel: usize,
    /// The Gaussian that shows most there.
    pub gaussian: usize,
}

/// Contributions of a pixel that tell its depth and group.
const CONTRIBUTORS: usize = 8;
/// Least share of a pixel's light that comes from one group.
const LEAST_SHARE: f32 = 0.8;

/// (G) the surface points of each group inside the mask, at most `most` each, evenly chosen. What shows through the layer
/// is the photograph itself, so it differs from nothing.
pub(crate) fn surface_points(
    view: &TrainingView,
    layer: &Gaussians,
    groups: &Groups,
    most: usize,
) -> Vec<Vec<SurfacePoint>> {
    let (tiles, photograph) = (TileMask::covering(&view.mask), PlanarImage::from(&view.image));
    let background = Background::Image(&photograph);
    let shown = View { camera: &view.camera, background, tiles: Some(&tiles) };
    let rasterizer = CpuRasterizer::default();
    let mut tape = RenderTape::default();
    let inside = |pixel: usize| view.mask.data()[pixel] != 0;
    rasterizer.render(layer, &shown, &mut tape);
    let top = TopContributors::of(&tape, view.camera.size(), CONTRIBUTORS, inside);
    let depths =
        Depths { camera: &view.camera, of_gaussians: gaussian_depths(&view.camera, layer), groups, top };
    let mut out: Vec<Vec<SurfacePoint>> = groups.found.iter().map(|_| Vec::new()).collect();
    for pixel in (0..view.mask.data().len()).filter(|&pixel| inside(pixel)) {
        if let Some((gaussian, group, place)) = depths.surface(pixel) {
            let value = brightness(tape.image().pixel(pixel));
            out[group].push(SurfacePoint { place, value, pixel, gaussian });
        }
    }
    out.into_iter().map(|points| thinned(points, most)).collect()
}

/// Mean of the channels.
pub(crate) fn brightness(rgb: [f32; 3]) -> f64 {
    rgb.iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0
}

fn thinned(points: Vec<SurfacePoint>, most: usize) -> Vec<SurfacePoint> {
    let stride = points.len().div_ceil(most.max(1)).max(1);
    points.into_iter().step_by(stride).collect()
}

struct Depths<'a> {
    camera: &'a Camera,
    /// Depths (m) of the centres; `None` behind the camera.
    of_gaussians: Vec<Option<f64>>,
    groups: &'a Groups,
    top: TopContributors,
}

/// Depth (m) of the centre of every Gaussian; `None` behind the camera.
fn gaussian_depths(camera: &Camera, layer: &Gaussians) -> Vec<Option<f64>> {
    let depth = |mean: &[f32; 3]| Some(camera.project(DVec3::from(mean.map(f64::from)))?.depth);
    layer.means.iter().map(depth).collect()
}

impl Depths<'_> {
    /// The Gaussian that a pixel shows most of, its group, and the point (m) at the mean depth of the group there.
    fn surface(&self, pixel: usize) -> Option<(usize, usize, DVec3)> {
        let range = pixel * self.top.count..(pixel + 1) * self.top.count;
        let (indices, weights) = (&self.top.indices[range.clone()], &self.top.weights[range]);
        let heaviest = usize::try_from(*indices.first()?).ok()?;
        let group = self.groups.of[heaviest]?;
        let (mut all, mut own, mut depth) = (0.0, 0.0, 0.0);
        for (&index, &weight) in indices.iter().zip(weights).filter(|(index, _)| **index >= 0) {
            all += weight;
            if self.groups.of[index as usize] == Some(group) {
                own += weight;
                depth += f64::from(weight) * self.of_gaussians[index as usize]?;
            }
        }
        // Light that comes from behind the layer belongs to no group.
        (own >= LEAST_SHARE * all.max(LEAST_SHARE))
            .then(|| (heaviest, group, self.point(pixel, depth / f64::from(own))))
    }

    /// The point at a depth (m) behind the centre of a pixel.
    fn point(&self, pixel: usize, depth: f64) -> DVec3 {
        let width = self.camera.size().width;
        let ray = self.camera.ray(DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5));
        self.camera.center() + ray * (depth / self.camera.rotation().row(2).dot(ray))
    }
}
