//! Photometric loss of 3D Gaussian Splatting: `0.8 L1 + 0.2 (1 - SSIM)`, fused with its gradient.
//!
//! SSIM has an 11-tap Gaussian window (sigma = 1.5 px), zero padding, C1 = 0.01^2, C2 = 0.03^2. Two passes over
//! bands of 16 rows: window statistics and partial derivatives; then the derivatives filtered back. Only 16 x 16
//! tiles that hold a counted pixel are visited. Sums run in a fixed order: the result does not depend on the number
//! of threads.

mod block;
mod region;
#[cfg(test)]
mod tests;
mod window;

use block::{Channel, EMPTY_MAPS, Factors, Gradient, RowMaps, Statistics, Sums};
use ffgs_core::kernel::dispatch;
use ffgs_core::{ImageRgb8, ImageSize, Mask, PlanarImage};
use rayon::prelude::*;
use region::Spans;
use window::LANES;

/// Rows of a band.
const BAND: usize = 16;
/// Tiles that one span joins at most.
const MAX_TILES: usize = 4;
const MAX_COLUMNS: usize = MAX_TILES * LANES;

/// Weight of `1 - SSIM` in the loss; L1 has the rest (3DGS `lambda_dssim`).
pub const SSIM_WEIGHT: f64 = 0.2;

/// The pixels that count.
#[derive(Clone, Copy, Debug)]
pub enum LossRegion<'a> {
    /// Every pixel.
    Full,
    /// The foreground of a mask. Outside it the target takes the rendered image's place, so that windows at the
    /// edge see no foreign error; means are over the foreground.
    Mask(&'a Mask),
}

/// Value of the loss and of its parts, means over counted pixels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossValue {
    /// `0.8 l1 + 0.2 (1 - ssim)`.
    pub total: f64,
    /// Mean absolute difference.
    pub l1: f64,
    /// Mean structural similarity.
    pub ssim: f64,
    /// Mean squared difference.
    pub mse: f64,
}

/// Where the partial derivatives of a band lie: three maps of [`BAND`] rows, [`LANES`] zero columns on both sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Padded {
    stride: usize,
}

impl Padded {
    fn of_width(width: usize) -> Self {
        Self { stride: width.next_multiple_of(LANES) + 2 * LANES }
    }

    #[inline(always)]
    fn at(self, map: usize, row: usize, column: usize) -> usize {
        (map * BAND + row) * self.stride + LANES + column
    }

    #[inline(always)]
    fn band_len(self) -> usize {
        3 * BAND * self.stride
    }
}

/// The loss with its scratch memory; after the first call at a size nothing is allocated.
#[derive(Default)]
pub struct PhotometricLoss {
    size: Option<ImageSize>,
    layout: Padded,
    spans: Spans,
    previous: Spans,
    /// Channel-major, band by band. Invariant: zero outside the spans of the last call.
    partials: Vec<f32>,
    maps: Vec<RowMaps>,
    sums: Vec<Sums>,
}

impl PhotometricLoss {
    /// No scratch yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Loss of `rendered` against `target` over `region`, and its gradient by the rendered pixels (same size,
    /// zero where a pixel does not count; previous content is replaced). An empty mask gives a value of zero.
    ///
    /// # Panics
    /// When the sizes of the images and the mask differ.
    pub fn evaluate(
        &mut self,
        rendered: &PlanarImage,
        target: &ImageRgb8,
        region: LossRegion,
        gradient: &mut PlanarImage,
    ) -> LossValue {
        let size = rendered.size();
        assert_eq!(size, target.size(), "target size");
        let (mask, counted) = match region {
            LossRegion::Full => (None, size.pixels()),
            LossRegion::Mask(mask) => (Some(mask), mask.count()),
        };
        assert!(mask.is_none_or(|m| m.size() == size), "mask size");
        self.prepare(size, region);
        if mask.is_some() || gradient.size() != size {
            gradient.reset(size);
        }
        if counted == 0 {
            return LossValue::default();
        }
        let samples = 3.0 * counted as f64;
        let factors =
            Factors { l1: ((1.0 - SSIM_WEIGHT) / samples) as f32, ssim: (-SSIM_WEIGHT / samples) as f32 };
        let channel =
            |index| Channel { index, size, rendered: rendered.plane(index), target: target.data(), mask };
        self.statistics(&channel);
        self.gradient(&channel, factors, gradient);
        self.value(samples)
    }

    fn prepare(&mut self, size: ImageSize, region: LossRegion) {
        std::mem::swap(&mut self.spans, &mut self.previous);
        self.spans.collect(size, region);
        let bands = size.height.div_ceil(BAND);
        if self.size != Some(size) {
            self.size = Some(size);
            self.layout = Padded::of_width(size.width);
            self.maps.resize(3 * bands, EMPTY_MAPS);
            self.partials.clear();
            self.partials.resize(3 * bands * self.layout.band_len(), 0.0);
        } else if self.spans != self.previous {
            self.clear_previous(bands);
        }
        self.sums.clear();
        self.sums.resize(3 * bands, Sums::default());
    }

    fn clear_previous(&mut self, bands: usize) {
        for (index, band) in self.partials.chunks_exact_mut(self.layout.band_len()).enumerate() {
            for span in self.previous.of(index % bands) {
                for row in band.chunks_exact_mut(self.layout.stride) {
                    row[LANES + span.x0..][..span.columns].fill(0.0);
                }
            }
        }
    }

    fn statistics<'a>(&mut self, channel: &(impl Fn(usize) -> Channel<'a> + Sync)) {
        let Self { layout, spans, partials, maps, sums, .. } = self;
        let bands = sums.len() / 3;
        partials
            .par_chunks_exact_mut(layout.band_len())
            .zip(maps.par_iter_mut())
            .zip(sums.par_iter_mut())
            .enumerate()
            .filter(|(index, _)| !spans.of(index % bands).is_empty())
            .for_each(|(index, ((partials, maps), sums))| {
                let (channel, band) = (channel(index / bands), index % bands);
                let (spans, layout) = (spans.of(band), *layout);
                dispatch(Statistics { channel, band, spans, maps, layout, partials, sums });
            });
    }

    fn gradient<'a>(
        &mut self,
        channel: &(impl Fn(usize) -> Channel<'a> + Sync),
        factors: Factors,
        gradient: &mut PlanarImage,
    ) {
        let Self { layout, spans, partials, maps, sums, .. } = self;
        let bands = sums.len() / 3;
        let ImageSize { width, height } = gradient.size();
        let planes = gradient.data_mut().par_chunks_exact_mut(width * height);
        let scratch = maps.par_chunks_exact_mut(bands).zip(sums.par_chunks_exact_mut(bands));
        let partials = partials.par_chunks_exact(bands * layout.band_len());
        planes.zip(scratch).zip(partials).enumerate().for_each(|(c, ((plane, (maps, sums)), partials))| {
            let rows = plane.par_chunks_mut(BAND * width).zip(maps).zip(sums).enumerate();
            let active = rows.filter(|(band, _)| !spans.of(*band).is_empty());
            active.for_each(|(band, ((output, maps), sums))| {
                let (channel, spans, layout) = (channel(c), spans.of(band), *layout);
                dispatch(Gradient { channel, band, spans, maps, layout, partials, factors, output, sums });
            });
        });
    }

    fn value(&self, samples: f64) -> LossValue {
        let mean = |part: fn(&Sums) -> f64| self.sums.iter().map(part).sum::<f64>() / samples;
        let (ssim, l1, mse) = (mean(|s| s.ssim), mean(|s| s.l1), mean(|s| s.squared));
        LossValue { total: (1.0 - SSIM_WEIGHT) * l1 + SSIM_WEIGHT * (1.0 - ssim), l1, ssim, mse }
    }
}
