//! Which static Gaussians colour which pixels of a view, and with what weights: the coefficients of the linear solve.

use super::Tracing;
use ffgs_core::{Camera, Gaussians};
use ffgs_rasterizer::{
    Background, CpuRasterizer, RenderOptions, RenderTape, TopContributors, View, sh_basis,
};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

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

/// Pixels whose contributions are collected by one task.
const PIXELS: usize = 4096;

/// Memory that tracing takes, for one view after another.
#[derive(Debug, Default)]
pub(super) struct Tracer {
    tape: RenderTape,
    top: TopContributors,
    place: Vec<u32>,
}

impl ViewTrace {
    /// The heaviest contributors of every pixel of the lattice, with a basis of the given degree.
    pub(super) fn new(camera: &Camera, layer: &Gaussians, tracing: Tracing, tracer: &mut Tracer) -> Self {
        let Tracing { contributors: count, stride, degree } = tracing;
        let Tracer { tape, top, place } = tracer;
        let view = View { camera, background: Background::Colour([0.0; 3]), tiles: None };
        let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
        rasterizer.prepare(&[layer], &view, tape);
        top.list(tape, camera.size(), count, lattice(camera.size().width, stride));
        let is_seen: Vec<AtomicBool> = (0..layer.len()).map(|_| AtomicBool::new(false)).collect();
        let present = top.indices.par_iter().filter_map(|&i| is_seen.get(usize::try_from(i).ok()?));
        present.for_each(|is_seen| is_seen.store(true, Relaxed));
        let seen: Vec<u32> = (0..).zip(&is_seen).filter(|(_, is)| is.load(Relaxed)).map(|(i, _)| i).collect();
        place.resize(layer.len(), 0);
        seen.iter().zip(0..).for_each(|(&i, at)| place[i as usize] = at);
        let (starts, contributions) = packed(top, place);
        let center = camera.center().as_vec3();
        let direction = |&i: &u32| (Vec3::from(layer.means[i as usize]) - center).normalize_or_zero();
        let directions = seen.par_iter().map(direction).collect();
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
    pub(super) fn on_lattice(&self) -> impl Fn(usize) -> bool + Sync + use<> {
        lattice(self.camera.size().width, self.stride)
    }

    /// Number of pixels.
    pub(super) fn pixels(&self) -> usize {
        self.starts.len() - 1
    }
}

/// Contributions without the gaps of short lists, by the place of their Gaussians, and where those of each pixel start, (pixels + 1).
fn packed(top: &TopContributors, place: &[u32]) -> (Vec<u32>, Vec<Contribution>) {
    let count = top.count.max(1);
    let lists = top.indices.par_chunks(PIXELS * count).zip(top.weights.par_chunks(PIXELS * count));
    let parts: Vec<(Vec<u32>, Vec<Contribution>)> = lists
        .map(|(indices, weights)| {
            let (mut ends, mut packed) = (Vec::with_capacity(PIXELS), Vec::new());
            for (indices, weights) in indices.chunks(count).zip(weights.chunks(count)) {
                let present = indices.iter().zip(weights).filter(|(i, _)| **i >= 0);
                packed.extend(present.map(|(&i, &weight)| (place[i as usize], weight)));
                ends.push(packed.len() as u32);
            }
            (ends, packed)
        })
        .collect();
    let mut starts = Vec::with_capacity(top.indices.len() / count + 1);
    starts.push(0);
    for (ends, _) in &parts {
        let first = starts[starts.len() - 1];
        starts.extend(ends.iter().map(|end| first + end));
    }
    let mut contributions = Vec::with_capacity(starts[starts.len() - 1] as usize);
    parts.iter().for_each(|(_, packed)| contributions.extend_from_slice(packed));
    (starts, contributions)
}

/// Whether a pixel of an image of a width is on the lattice of a stride.
fn lattice(width: usize, stride: usize) -> impl Fn(usize) -> bool + Sync {
    move |pixel| (pixel % width).is_multiple_of(stride) && (pixel / width).is_multiple_of(stride)
}
