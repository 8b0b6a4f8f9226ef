//! Motion fields to displaced projections of Gaussians, with every contributor (Algorithm 1, lines 15 to 19).

use crate::contract::{Background, RenderOptions, View};
use crate::cpu::CpuRasterizer;
use crate::footprint::{FootprintSums, PixelChannels};
use crate::tape::RenderTape;
use crate::tiles::TileMask;
use ffgs_core::{Camera, DenseMotion, Gaussians, Mask};
use glam::{DVec2, DVec3};

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
    sums: FootprintSums,
}

/// The blending weight itself, then [`OF_TRACKER`] for every tracker.
struct Channels<'a>(Association<'a>);

/// A tracker's channels: whether it knows the motion, flow x, flow y, weight.
const OF_TRACKER: usize = 4;

impl PixelChannels for Channels<'_> {
    fn count(&self) -> usize {
        1 + OF_TRACKER * self.0.fields.len()
    }

    fn at(&self, pixel: usize, values: &mut [f32]) -> bool {
        if self.0.mask.data()[pixel] == 0 {
            return false;
        }
        values[0] = 1.0;
        for (values, field) in values[1..].chunks_exact_mut(OF_TRACKER).zip(self.0.fields) {
            let (confidence, [x, y]) = (field.confidence[pixel], field.flow[pixel]);
            // A tracker that knows nothing at a pixel must not pull the mean displacement toward zero.
            let known = f32::from(confidence > 0.0);
            let weight = confidence * (x * x + y * y).sqrt().max(self.0.flow_floor_px);
            values.copy_from_slice(&[known, known * x, known * y, weight]);
        }
        true
    }
}

impl Association<'_> {
    /// Renders `gaussians`, the first N of which move and lie at `means` (m), and gives each tracker's mean flow and
    /// weight under each of their footprints: `x = project(mean) + sum a F / sum a`, `w = sum a C max(|F|, floor)` with
    /// `a = alpha T`, over the mask. Colours are not looked at.
    pub fn observe(
        &self,
        gaussians: &Gaussians,
        means: &[DVec3],
        out: &mut [Observed],
        scratch: &mut AssociationScratch,
    ) {
        let AssociationScratch { tape, sums } = scratch;
        let tiles = TileMask::covering(self.mask);
        let view =
            View { camera: self.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
        let options = RenderOptions { antialiased: true, sh_degree: Some(0) };
        let (rasterizer, channels) = (CpuRasterizer::new(options), Channels(*self));
        rasterizer.sum_footprints(gaussians, means.len(), &view, &channels, tape, sums);
        sums.for_each(means.len(), tape, |i, values, hits| {
            if values[0] <= self.min_coverage || hits < self.min_hits {
                return;
            }
            let Some(projection) = self.camera.project(means[i]) else { return };
            for (out, values) in out.iter_mut().zip(values[1..].chunks_exact(OF_TRACKER)) {
                let (coverage, weight) = (f64::from(values[0]), f64::from(values[3]));
                if coverage > f64::from(self.min_coverage) && weight > 0.0 {
                    let flow = DVec2::new(f64::from(values[1]), f64::from(values[2]));
                    out.targets[i] = projection.pixel + flow / coverage;
                    out.weights[i] = weight;
                }
            }
        });
    }
}
