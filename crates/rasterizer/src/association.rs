//! Motion fields to displaced projections of Gaussians, with every contributor or the heaviest of each pixel
//! (Algorithm 1, lines 15 to 19).

use crate::blend::TilePlane;
use crate::chunks::ChunkBounds;
use crate::cpu::CpuRasterizer;
use crate::footprint::{EntrySums, PixelChannels, Summed};
use crate::tape::RenderTape;
use crate::tiles::TileMask;
use crate::view::{Background, RenderOptions, View};
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
    /// A pixel is finished before the contribution that would bring its transmittance to this value.
    pub min_transmittance: f32,
    /// Gaussians that each pixel counts for, those with the largest `alpha T`; 0 = all.
    pub contributors: usize,
    /// Whether the flow under a footprint is its mean, weighted by `alpha T`; else the sum.
    pub normalise: bool,
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
    layers: Vec<&'a Gaussians>,
    means: &'a [DVec3],
    bounds: ChunkBounds,
}

impl<'a> AssociationScene<'a> {
    /// The first N Gaussians of `layers` together move and lie at `means` (m); the others only occlude what is behind them.
    pub fn new(layers: &[&'a Gaussians], means: &'a [DVec3]) -> Self {
        Self { layers: layers.to_vec(), means, bounds: ChunkBounds::new(layers) }
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

    fn finished(&self) -> f32 {
        self.association.min_transmittance
    }

    fn contributors(&self) -> usize {
        self.association.contributors
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
                let [x, y] = if known > 0.0 { flow[k] } else { [0.0; 2] };
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
    /// tracker knows the motion, times flow x and y (px), and times the weight. The flow is the mean if `normalise`, else the sum.
    pub fn take(&mut self, i: usize, pixel: DVec2, sums: [f32; 4], min_coverage: f32, normalise: bool) {
        let [coverage, x, y, weight] = sums.map(f64::from);
        if coverage > f64::from(min_coverage) && weight > 0.0 {
            self.targets[i] = pixel + DVec2::new(x, y) / if normalise { coverage } else { 1.0 };
            self.weights[i] = weight;
        }
    }
}

impl Association<'_> {
    /// Renders `scene` and gives each tracker's mean flow and weight under the footprint of each of its N moving
    /// Gaussians: `x = project(mean) + sum a F / sum a`, `w = sum a C max(|F|, floor)` with `a = alpha T`, over the
    /// mask. With `contributors` each pixel counts for the heaviest `a` only, of all Gaussians. Colours are not looked at.
    pub fn observe(&self, scene: &AssociationScene, out: &mut [Observed], scratch: &mut AssociationScratch) {
        let AssociationScratch { tape, sums } = scratch;
        let AssociationScene { layers, means, bounds } = scene;
        let tiles = TileMask::covering(self.mask);
        let view =
            View { camera: self.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
        let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
        let channels = Channels::new(*self);
        let summed = Summed { layers, bounds: Some(bounds), wanted: means.len() };
        rasterizer.sum_entries(&summed, &view, &channels, tape, sums);
        sums.for_each(tape, means.len(), |i, values, hits| {
            if values[0] <= self.min_coverage || hits < self.min_hits {
                return;
            }
            let Some(projection) = self.camera.project(means[i]) else { return };
            for (out, place) in out.iter_mut().zip(&channels.places) {
                let [x, y, weight] = [0, 1, 2].map(|c| values[place.first + c]);
                out.take(
                    i,
                    projection.pixel,
                    [values[place.coverage], x, y, weight],
                    self.min_coverage,
                    self.normalise,
                );
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::DMat4;

    /// Four equal splats one behind the other, wide enough to be flat over the mask: each lets a fifth through.
    #[test]
    fn what_is_hidden_is_not_observed() {
        let size = ImageSize { width: 32, height: 32 };
        let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 16.0, cy: 16.0 };
        let camera = Camera::new(intrinsics, DMat4::IDENTITY, size).unwrap();
        let mut gaussians = Gaussians::zeros(4, 0);
        for i in 0..4 {
            gaussians.means[i] = [0.0, 0.0, 10.0 + 0.01 * i as f32];
            gaussians.quats[i] = [1.0, 0.0, 0.0, 0.0];
            gaussians.log_scales[i] = [1.0; 3];
            gaussians.opacity_logits[i] = 4.0_f32.ln();
        }
        let means: Vec<DVec3> = (0..4).map(|i| DVec3::new(0.0, 0.0, 10.0 + 0.01 * f64::from(i))).collect();
        let mut inside = vec![0; size.pixels()];
        [15 * 32 + 15, 15 * 32 + 16, 16 * 32 + 15, 16 * 32 + 16].into_iter().for_each(|p| inside[p] = 1);
        let mask = Mask::new(size, inside).unwrap();
        let mut field = DenseMotion::unknown(size);
        field.flow.fill([3.0, -4.0]);
        field.confidence.fill(1.0);
        // The second tracker knows three of the four pixels; whatever it says of the fourth may not come in.
        let mut gap = field.clone();
        (gap.flow[15 * 32 + 16], gap.confidence[15 * 32 + 16]) = ([f32::NAN; 2], 0.0);
        let scene = AssociationScene::new(&[&gaussians], &means);
        // The transmittances behind them are 0.2, 0.04, 0.008 and 0.0016.
        for (min_transmittance, seen) in [(1e-4, 4), (5e-3, 3), (1e-2, 2), (0.1, 1), (0.5, 0)] {
            let mut columns = [0, 1].map(|_| (vec![DVec2::ZERO; 4], vec![0.0; 4]));
            let mut out = columns.each_mut().map(|(targets, weights)| Observed { targets, weights });
            let (camera, mask, fields) = (&camera, &mask, &[field.clone(), gap.clone()]);
            let (flow_floor_px, min_coverage, min_hits, contributors) = (0.25, 1e-3, 2, 0);
            Association {
                camera,
                mask,
                fields,
                flow_floor_px,
                min_coverage,
                min_hits,
                min_transmittance,
                contributors,
                normalise: true,
            }
            .observe(&scene, &mut out, &mut AssociationScratch::default());
            for ((targets, weights), pixels) in columns.iter().zip([4.0, 3.0]) {
                for i in 0..4 {
                    // Alpha 0.8, a motion of 5 px.
                    let expected = if i < seen { pixels * 0.8 * 0.2_f64.powi(i as i32) * 5.0 } else { 0.0 };
                    assert!((weights[i] - expected).abs() <= 0.03 * expected, "splat {i}: {weights:?}");
                    let moved = DVec2::new(19.0, 12.0);
                    assert!(i >= seen || (targets[i] - moved).length() < 1e-4, "splat {i}: {targets:?}");
                }
            }
        }
    }
}
