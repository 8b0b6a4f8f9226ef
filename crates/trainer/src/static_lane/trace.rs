//! Which static Gaussians colour which pixels of a view, and with what weights: the coefficients of the linear solve.

use super::Tracing;
use ffgs_core::{Camera, Gaussians};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, View, sh_basis};
use glam::Vec3;

/// Place in `seen` and weight `alpha T`.
pub(super) type Contribution = (u32, f32);

/// Which Gaussians colour which pixels of one view, and with what weights. It holds as long as camera, geometry and opacities stay.
#[derive(Clone, Debug)]
pub(super) struct ViewTrace {
    pub(super) camera: Camera,
    /// Gaussians that colour a pixel, ascending.
    pub(super) seen: Vec<u32>,
    /// (seen) unit vectors from the camera to each.
    directions: Vec<Vec3>,
    degree: usize,
    stride: usize,
    /// (pixels + 1) where each pixel's contributions start.
    starts: Vec<u32>,
    contributions: Vec<Contribution>,
}

impl ViewTrace {
    /// The heaviest contributors of every pixel of the lattice, with a basis of the given degree.
    pub(super) fn new(camera: &Camera, layer: &Gaussians, tracing: Tracing) -> Self {
        let Tracing { contributors: count, stride, degree } = tracing;
        let on_lattice = lattice(camera.size().width, stride);
        let view = View { camera, background: Background::Colour([0.0; 3]), tiles: None };
        let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
        let top = rasterizer.top_contributors(layer, &view, count, &mut RenderTape::default());
        let mut place = vec![u32::MAX; layer.len()];
        let traced = || top.indices.chunks(count.max(1)).enumerate().filter(|(p, _)| on_lattice(*p));
        let present = || traced().flat_map(|(_, indices)| indices).filter(|i| **i >= 0);
        present().for_each(|&i| place[i as usize] = 0);
        let seen: Vec<u32> = (0..layer.len() as u32).filter(|&i| place[i as usize] == 0).collect();
        seen.iter().enumerate().for_each(|(at, &i)| place[i as usize] = at as u32);
        let mut starts = vec![0];
        let mut contributions = Vec::with_capacity(present().count());
        let pixels = top.indices.chunks(count.max(1)).zip(top.weights.chunks(count.max(1)));
        for (pixel, (indices, weights)) in pixels.enumerate() {
            let present = indices.iter().zip(weights).filter(|(i, _)| **i >= 0 && on_lattice(pixel));
            contributions.extend(present.map(|(&i, &w)| (place[i as usize], w)));
            starts.push(contributions.len() as u32);
        }
        let center = camera.center().as_vec3();
        let direction = |&i: &u32| (Vec3::from(layer.means[i as usize]) - center).normalize_or_zero();
        let directions = seen.iter().map(direction).collect();
        let degree = degree.min(layer.sh_degree());
        Self { camera: *camera, seen, directions, degree, stride, starts, contributions }
    }

    /// SH basis in the direction of a Gaussian, by its place in `seen`; a quarter of the memory of the bases is what the
    /// directions take.
    #[inline]
    pub(super) fn basis(&self, at: usize) -> [f32; 16] {
        sh_basis(self.degree, self.directions[at])
    }

    /// Contributions to a pixel: place in `seen` and weight.
    #[inline]
    pub(super) fn of(&self, pixel: usize) -> &[Contribution] {
        &self.contributions[self.starts[pixel] as usize..self.starts[pixel + 1] as usize]
    }

    /// Whether a pixel, by its number, is on the lattice; the others have no contributions.
    pub(super) fn on_lattice(&self) -> impl Fn(usize) -> bool + use<> {
        lattice(self.camera.size().width, self.stride)
    }

    /// Number of pixels.
    pub(super) fn pixels(&self) -> usize {
        self.starts.len() - 1
    }
}

/// Whether a pixel of an image of a width is on the lattice of a stride.
fn lattice(width: usize, stride: usize) -> impl Fn(usize) -> bool {
    move |pixel| (pixel % width).is_multiple_of(stride) && (pixel / width).is_multiple_of(stride)
}
