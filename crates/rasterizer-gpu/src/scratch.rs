//! The working memory of a render, and how it grows when a view turns out to need more.

use crate::layout::{Job, SPLAT_BYTES, plan};
use crate::view::STATES;
use ffgs_gpu::{Buffer, Gpu, GpuError};
use ffgs_rasterizer::constants::{AREA, ENTRY};

/// Elements of one block of scan and sort.
pub(crate) const BLOCK: usize = 1024;
/// Digits of a sort's pass.
pub(crate) const DIGITS: usize = 16;
/// Bits of a digit.
pub(crate) const DIGIT_BITS: u32 = 4;

/// How much a [`Scratch`] has room for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Capacity {
    /// Gaussians.
    pub gaussians: usize,
    /// Rows of tiles that splats touch.
    pub spans: usize,
    /// (tile, splat) pairs.
    pub pairs: usize,
    /// Pixels of the largest view.
    pub pixels: usize,
}

impl Capacity {
    /// A first guess, which a render corrects.
    pub fn guess(gaussians: usize, pixels: usize) -> Self {
        Self { gaussians, spans: 4 * gaussians + 1024, pairs: 8 * gaussians + 4096, pixels }
    }

    /// The larger of both in every field.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            gaussians: self.gaussians.max(other.gaussians),
            spans: self.spans.max(other.spans),
            pairs: self.pairs.max(other.pairs),
            pixels: self.pixels.max(other.pixels),
        }
    }

    /// Half as much again of what depends on where the Gaussians are, for what training may add.
    #[must_use]
    pub fn with_margin(self) -> Self {
        Self { spans: self.spans + self.spans / 2, pairs: self.pairs + self.pairs / 2, ..self }
    }
}

/// Memory that renders of one lane share: 120 B per Gaussian, 4 B per span, 64 B per pair, 36 B per pixel.
#[derive(Debug)]
pub struct Scratch {
    /// What it has room for.
    pub capacity: Capacity,
    pub(crate) splats: Buffer,
    pub(crate) keys: [Buffer; 2],
    pub(crate) extents: Buffer,
    pub(crate) counts: Buffer,
    pub(crate) spans: Buffer,
    pub(crate) spans_used: Buffer,
    pub(crate) sums: Buffer,
    pub(crate) histogram: Buffer,
    pub(crate) plan: Buffer,
    pub(crate) pairs: [Buffer; 2],
    pub(crate) pair_splats: Buffer,
    pub(crate) list: Buffer,
    pub(crate) entries: Buffer,
    /// Row-major (RGB, transmittance) of the last render.
    pub pixels: Buffer,
    /// Row-major derivatives by the same.
    pub upstream: Buffer,
    pub(crate) last: Buffer,
    pub(crate) jobs: Jobs,
}

/// Uniforms of the scans and of every pass of the sorts.
#[derive(Debug)]
pub(crate) struct Jobs {
    pub scan_gaussians: Buffer,
    pub sort_gaussians: Vec<Buffer>,
    pub histogram_of_gaussians: Buffer,
    pub sort_pairs: Vec<Buffer>,
    pub histogram_of_pairs: Buffer,
}

impl Jobs {
    fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let job = |length_at, histogram, shift| {
            gpu.uniform("job", &Job { length_at, histogram, shift, padding: 0 })
        };
        let passes = |length_at| -> Result<Vec<Buffer>, GpuError> {
            (0..u32::BITS / DIGIT_BITS).map(|p| job(length_at, 0, p * DIGIT_BITS)).collect()
        };
        Ok(Self {
            scan_gaussians: job(plan::COUNT, 0, 0)?,
            sort_gaussians: passes(plan::COUNT)?,
            histogram_of_gaussians: job(plan::COUNT, 1, 0)?,
            sort_pairs: passes(plan::PAIRS)?,
            histogram_of_pairs: job(plan::PAIRS, 1, 0)?,
        })
    }
}

impl Scratch {
    /// Allocates for `capacity`.
    ///
    /// # Errors
    /// When the device has too little memory.
    pub fn new(gpu: &Gpu, capacity: Capacity) -> Result<Self, GpuError> {
        let Capacity { gaussians, spans, pairs, pixels } = capacity;
        let make = |what: &str, items: usize, bytes: u64| gpu.buffer(what, items as u64 * bytes);
        let histogram = DIGITS * gaussians.max(pairs).div_ceil(BLOCK);
        let sums = gaussians.max(histogram).div_ceil(BLOCK) + 1;
        Ok(Self {
            capacity,
            splats: make("splats", gaussians, SPLAT_BYTES)?,
            keys: [make("depths", gaussians, 8)?, make("depths", gaussians, 8)?],
            extents: make("extents", gaussians, 16)?,
            counts: make("pair counts", gaussians, 4)?,
            spans: make("tile spans", spans, 4)?,
            spans_used: make("counter", 1, 4)?,
            sums: make("block sums", sums, 4)?,
            histogram: make("histogram", histogram, 4)?,
            plan: make("plan", plan::LENGTH, 4)?,
            pairs: [make("tile pairs", pairs, 8)?, make("tile pairs", pairs, 8)?],
            pair_splats: make("splats of pairs", pairs, 4)?,
            list: make("tile lists", pairs, 8)?,
            entries: gpu.buffer("gradients of pairs", (pairs * ENTRY + STATES * AREA * 4) as u64 * 4)?,
            pixels: make("image", pixels, 16)?,
            upstream: make("image gradient", pixels, 16)?,
            last: make("last contributions", pixels, 4)?,
            jobs: Jobs::new(gpu)?,
        })
    }

    /// Grows to hold `capacity`, with all content lost; nothing happens when it does already.
    ///
    /// # Errors
    /// When the device has too little memory.
    pub fn ensure(&mut self, gpu: &Gpu, capacity: Capacity) -> Result<(), GpuError> {
        let needed = self.capacity.max(capacity);
        if needed != self.capacity {
            // The old memory is let go before there is new: both at once may not fit.
            *self = Self::new(gpu, Capacity::default())?;
            gpu.release_unused();
            *self = Self::new(gpu, needed)?;
        }
        Ok(())
    }

    /// Starts counting what renders of `gaussians` Gaussians need.
    pub fn restart(&self, gpu: &Gpu, gaussians: usize) {
        gpu.write(&self.plan, &[gaussians as u32, 0, 0, 0]);
    }

    /// What the renders since [`Scratch::restart`] needed. Waits for the device.
    ///
    /// # Errors
    /// When the device failed.
    pub fn needed(&self, gpu: &Gpu) -> Result<Capacity, GpuError> {
        let plan: Vec<u32> = gpu.download(&self.plan, plan::LENGTH)?;
        Ok(Capacity {
            spans: plan[plan::NEEDED_SPANS] as usize,
            pairs: plan[plan::NEEDED_PAIRS] as usize,
            ..Capacity::default()
        })
    }

    /// Whether it has room for `needed`.
    pub fn holds(&self, needed: Capacity) -> bool {
        self.capacity.max(needed) == self.capacity
    }
}
