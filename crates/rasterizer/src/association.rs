//! Motion fields to displaced projections of Gaussians, with every contributor (Algorithm 1, lines 15 to 19).

use crate::blend::TilePlane;
use crate::chunks::ChunkBounds;
use crate::contract::{Background, RenderOptions, View};
use crate::cpu::CpuRasterizer;
use crate::footprint::{EntrySums, PixelChannels};
use crate::tape::RenderTape;
use crate::tiles::TileMask;
use ffgs_core::{Camera, DenseMotion, Gaussians, Mask};
use glam::{DVec2, DVec3};
use std::ops::Range;

/// What the trackers of one view say at t-1.
#[derive(Clone, Copy, Debug)]
pub struct Association<'a> {
    /// Camera at t-1: the flow leads from its image to the image at t, camera motion included.
    pub camera: &'a Camera,
    /// Pixels that count.
    pub mask: &'a Mask,
    /// (L) motion fields of the mask's size.
    pub fields: &'a [DenseMotion],
    /// Least motion in the weight (px); 0 = literal.
    pub flow_floor_px: f32,
    /// Least sum of blending weights of a Gaussian that is observed.
    pub min_coverage: f32,
    /// Least number of its pixels.
    pub min_hits: u32,
}

/// One tracker's observations of N Gaussians in one view; what is not observed stays as it is.
#[derive(Debug)]
pub struct Observed<'a> {
    /// (N) displaced projections (px).
    pub targets: &'a mut [DVec2],
    /// (N) weights.
    pub weights: &'a mut [f64],
}

/// Memory that calls reuse.
#[derive(Debug, Default)]
pub struct AssociationScratch {
    tape: RenderTape,
    sums: EntrySums,
}

/// The Gaussians of t-1, for all views.
#[derive(Debug)]
pub struct AssociationScene<'a> {
    gaussians: &'a Gaussians,
    means: &'a [DVec3],
    bounds: ChunkBounds,
}

impl<'a> AssociationScene<'a> {
    /// The first N of `gaussians` move and lie at `means` (m); the others only hide what is behind them.
    pub fn new(gaussians: &'a Gaussians, means: &'a [DVec3]) -> Self {
        Self { gaussians, means, bounds: ChunkBounds::new(gaussians) }
    }
}

/// Where a tracker's sums are.
struct Place {
    /// Channel of its coverage: channel 0, the blending weight itself, when it knows the motion of every pixel.
    coverage: usize,
    /// First of flow x, flow y, weight.
    first: usize,
}

/// The first channel is the blending weight itself.
struct Channels<'a> {
    association: Association<'a>,
    places: Vec<Place>,
    count: usize,
}

impl<'a> Channels<'a> {
    fn new(association: Association<'a>) -> Self {
        let mut count = 1;
        let place = |field: &DenseMotion| {
            let masked = association.mask.data().iter().zip(&field.confidence);
            let knows_all = masked.into_iter().all(|(&inside, &confidence)| inside == 0 || confidence > 0.0);
            let coverage = if knows_all { 0 } else { count };
            let first = count + usize::from(!knows_all);
            count = first + 3;
            Place { coverage, first }
        };
        let places = association.fields.iter().map(place).collect();
        Self { association, places, count }
    }
}

impl PixelChannels for Channels<'_> {
    fn count(&self) -> usize {
        self.count
    }

    fn gather(&self, pixels: Range<usize>, local: usize, planes: &mut [TilePlane], open: &mut TilePlane) {
        let Association { mask, fields, flow_floor_px, .. } = self.association;
        let mask = &mask.data()[pixels.clone()];
        if mask.iter().all(|&inside| inside == 0) {
            return;
        }
        for (k, &inside) in mask.iter().enumerate() {
            open.0[local + k] = f32::from(inside != 0);
            planes[0].0[local + k] = open.0[local + k];
        }
        for (place, field) in self.places.iter().zip(fields) {
            let (flow, confidence) = (&field.flow[pixels.clone()], &field.confidence[pixels.clone()]);
            for k in 0..mask.len() {
                // A tracker that knows nothing at a pixel must not pull the mean displacement toward zero.
                let known = if mask[k] != 0 && confidence[k] > 0.0 { 1.0 } else { 0.0 };
                let [x, y] = flow[k].map(|v| known * v);
                let at = local + k;
                planes[place.first].0[at] = x;
                planes[place.first + 1].0[at] = y;
                planes[place.first + 2].0[at] =
                    known * confidence[k] * (x * x + y * y).sqrt().max(flow_floor_px);
                if place.coverage != 0 {
                    planes[place.coverage].0[at] = known;
                }
            }
        }
    }
}

impl Observed<'_> {
    /// Notes what the tracker says of Gaussian `i`, seen at `pixel`: `sums` under its footprint of `alpha T` where the
    /// tracker knows the motion, times flow x and y (px), and times the weight.
    pub fn take(&mut self, i: usize, pixel: DVec2, sums: [f32; 4], min_coverage: f32) {
        let [coverage, x, y, weight] = sums.map(f64::from);
        if coverage > f64::from(min_coverage) && weight > 0.0 {
            self.targets[i] = pixel + DVec2::new(x, y) / coverage;
            self.weights[i] = weight;
        }
    }
}

impl Association<'_> {
    /// Renders `scene` and gives each tracker's mean flow and weight under the footprint of each of its N moving
    /// Gaussians: `x = project(mean) + sum a F / sum a`, `w = sum a C max(|F|, floor)` with `a = alpha T`, over the
    /// mask. Colours are not looked at.
    pub fn observe(&self, scene: &AssociationScene, out: &mut [Observed], scratch: &mut AssociationScratch) {
        let AssociationScratch { tape, sums } = scratch;
        let AssociationScene { gaussians, means, bounds } = scene;
        let tiles = TileMask::covering(self.mask);
        let view =
            View { camera: self.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
        let rasterizer = CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: Some(0) });
        let channels = Channels::new(*self);
        rasterizer.sum_entries(gaussians, Some(bounds), means.len(), &view, &channels, tape, sums);
        sums.for_each(tape, means.len(), |i, values, hits| {
            if values[0] <= self.min_coverage || hits < self.min_hits {
                return;
            }
            let Some(projection) = self.camera.project(means[i]) else { return };
            for (out, place) in out.iter_mut().zip(&channels.places) {
                let [x, y, weight] = [0, 1, 2].map(|c| values[place.first + c]);
                out.take(i, projection.pixel, [values[place.coverage], x, y, weight], self.min_coverage);
            }
        });
    }
}
