//! Structural similarity (Wang et al. 2004), its gradient, and the training loss that uses it.

use crate::window::{Plane, RADIUS, WINDOW, by_bands, filter};
use crate::{SizeMismatch, same_size};
use ffgs_core::kernel::{self, Kernel};
use ffgs_core::{ImageRgb8, ImageSize, Mask, PlanarImage};
use rayon::prelude::*;
use std::ops::Range;
use thiserror::Error;

/// Stabilisers (K1 L)^2 and (K2 L)^2 with K1 = 0.01, K2 = 0.03 and range L = 1 (Wang et al. 2004).
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;
/// Share of 1 - SSIM in the 3DGS loss (Kerbl et al. 2023, eq. 7).
const LAMBDA: f64 = 0.2;

/// What happens at the image border.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// The images are zero outside; the map has the size of the image (the 3DGS convention).
    Same,
    /// Only windows that lie wholly in the image count; the map is 10 pixels smaller in each direction.
    Valid,
}

impl Border {
    fn margin(self) -> usize {
        match self {
            Self::Same => 0,
            Self::Valid => RADIUS,
        }
    }
}

/// Why two images cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SsimError {
    /// A slice does not hold `channels * height * width` values, or that is zero.
    #[error("images of {channels}x{height}x{width} need as many values (at least one), found {found:?}")]
    Length {
        /// Channels C.
        channels: usize,
        /// Rows H.
        height: usize,
        /// Columns W.
        width: usize,
        /// Lengths of the two slices.
        found: [usize; 2],
    },
    /// No window fits in the image ([`Border::Valid`] only).
    #[error("an image of {height}x{width} is smaller than the {WINDOW}x{WINDOW} window")]
    SmallerThanWindow {
        /// Rows H.
        height: usize,
        /// Columns W.
        width: usize,
    },
}

/// Two images of one shape, (C, H, W) row-major slices with values nominally in [0, 1]. Invariant: equal, matching
/// lengths and at least one value.
#[derive(Clone, Copy, Debug)]
pub struct SsimPair<'a> {
    shape: [usize; 3],
    rendered: &'a [f32],
    target: &'a [f32],
}

impl<'a> SsimPair<'a> {
    /// `shape` is [C, H, W]; both slices hold C * H * W values.
    ///
    /// # Errors
    /// When an image is empty or does not hold as many values as its shape says.
    pub fn new(shape: [usize; 3], rendered: &'a [f32], target: &'a [f32]) -> Result<Self, SsimError> {
        let [channels, height, width] = shape;
        let found = [rendered.len(), target.len()];
        let values = channels.checked_mul(height).and_then(|n| n.checked_mul(width)).unwrap_or(0);
        if values == 0 || found != [values; 2] {
            return Err(SsimError::Length { channels, height, width, found });
        }
        Ok(Self { shape, rendered, target })
    }

    /// Number of map values that the mean runs over.
    fn map_size(&self, border: Border) -> Result<usize, SsimError> {
        let [channels, height, width] = self.shape;
        let margin = 2 * border.margin();
        if height <= margin || width <= margin {
            return Err(SsimError::SmallerThanWindow { height, width });
        }
        Ok(channels * (height - margin) * (width - margin))
    }

    fn channel(&self, c: usize) -> Channel<'a> {
        let [_, height, width] = self.shape;
        let range = c * height * width..(c + 1) * height * width;
        Channel { height, width, rendered: &self.rendered[range.clone()], target: &self.target[range] }
    }
}

/// A mean or loss, and its gradient with respect to the rendered image.
#[derive(Clone, Debug, PartialEq)]
pub struct LossAndGradient {
    /// The value.
    pub value: f64,
    /// (C, H, W) derivative of `value` with respect to the rendered image.
    pub gradient: Vec<f64>,
    /// (C, h, w) SSIM map; (h, w) is smaller than (H, W) by 10 with [`Border::Valid`].
    pub map: Vec<f64>,
}

/// Mean SSIM over all channels and map pixels.
///
/// # Errors
/// When the window does not fit into the images.
pub fn ssim(images: SsimPair<'_>, border: Border) -> Result<f64, SsimError> {
    let count = images.map_size(border)?;
    let sums = (0..images.shape[0]).map(|c| images.channel(c).map(border).iter().sum::<f64>());
    Ok(sums.sum::<f64>() / count as f64)
}

/// Mean SSIM with its map and its gradient with respect to the rendered image.
///
/// # Errors
/// When the window does not fit into the images.
pub fn ssim_and_gradient(images: SsimPair<'_>, border: Border) -> Result<LossAndGradient, SsimError> {
    let count = images.map_size(border)? as f64;
    let parts: Vec<(Vec<f64>, Vec<f64>)> =
        (0..images.shape[0]).into_par_iter().map(|c| images.channel(c).map_and_gradient(border)).collect();
    let (maps, gradients): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
    let map = maps.concat();
    let gradient = gradients.concat().into_iter().map(|g| g / count).collect();
    Ok(LossAndGradient { value: map.iter().sum::<f64>() / count, gradient, map })
}

/// The 3DGS loss 0.8 L1 + 0.2 (1 - SSIM), both means over all values, SSIM with [`Border::Same`].
/// The gradient of |0| is 0.
///
/// # Errors
/// When the window does not fit into the images.
pub fn loss_3dgs(images: SsimPair<'_>) -> Result<LossAndGradient, SsimError> {
    let LossAndGradient { value, gradient, map } = ssim_and_gradient(images, Border::Same)?;
    let count = gradient.len() as f64;
    let difference = |i: usize| f64::from(images.rendered[i]) - f64::from(images.target[i]);
    let l1 = (0..gradient.len()).map(|i| difference(i).abs()).sum::<f64>() / count;
    let sign = |d: f64| if d == 0.0 { 0.0 } else { d.signum() };
    let combine = |(i, g): (usize, f64)| (1.0 - LAMBDA) * sign(difference(i)) / count - LAMBDA * g;
    let gradient = gradient.into_iter().enumerate().map(combine).collect();
    Ok(LossAndGradient { value: (1.0 - LAMBDA) * l1 + LAMBDA * (1.0 - value), gradient, map })
}

/// SSIM ([`Border::Same`]) of a render, clamped to [0, 1] (NaN counts as 0), against an 8-bit target, at every pixel.
#[derive(Clone, Debug)]
pub struct SsimMap {
    size: ImageSize,
    /// (H, W) of each channel.
    channels: [Vec<f64>; 3],
}

impl SsimMap {
    /// Compares the images.
    ///
    /// # Errors
    /// When they differ in size.
    pub fn new(rendered: &PlanarImage, target: &ImageRgb8) -> Result<Self, SizeMismatch> {
        let size = rendered.size();
        same_size(size, target.size())?;
        let (clamped, target) = (clamped(rendered), PlanarImage::from(target));
        let shape = [3, size.height, size.width];
        let pair = SsimPair { shape, rendered: &clamped, target: target.data() };
        Ok(Self { size, channels: [0, 1, 2].map(|c| pair.channel(c).map(Border::Same)) })
    }

    /// Mean over all pixels.
    pub fn mean(&self) -> f64 {
        self.mean_of(self.size.pixels(), |_| true)
    }

    /// Mean over the pixels of `mask`; `None` for an empty mask. The windows of pixels at its edge reach beyond it.
    ///
    /// # Errors
    /// When the mask has another size.
    pub fn mean_inside(&self, mask: &Mask) -> Result<Option<f64>, SizeMismatch> {
        same_size(self.size, mask.size())?;
        let count = mask.count();
        Ok((count > 0).then(|| self.mean_of(count, |pixel| mask.data()[pixel] != 0)))
    }

    /// Mean over the `count` pixels that count.
    fn mean_of(&self, count: usize, counts: impl Fn(usize) -> bool) -> f64 {
        let sum =
            |map: &Vec<f64>| map.iter().enumerate().filter(|(p, _)| counts(*p)).map(|(_, s)| s).sum::<f64>();
        self.channels.iter().map(sum).sum::<f64>() / (3 * count) as f64
    }
}

fn clamped(image: &PlanarImage) -> Vec<f32> {
    image.data().iter().map(|&v| if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) }).collect()
}

#[derive(Clone, Copy)]
struct Channel<'a> {
    height: usize,
    width: usize,
    rendered: &'a [f32],
    target: &'a [f32],
}

/// Local moments under the window: means, and means of the squares and the product.
struct Moments {
    mean: [Vec<f64>; 2],
    square: [Vec<f64>; 2],
    product: Vec<f64>,
}

/// SSIM at one pixel and its derivatives by the rendered image's mean, mean square and mean product.
struct Local {
    ssim: f64,
    by_mean: f64,
    by_square: f64,
    by_product: f64,
}

impl Channel<'_> {
    fn map(&self, border: Border) -> Vec<f64> {
        let (margin, width) = (border.margin(), self.width);
        by_bands(margin..self.height - margin, width - 2 * margin, |rows, out| {
            let moments = self.moments(rows);
            let lines = out.chunks_exact_mut(width - 2 * margin);
            for (y, out) in lines.enumerate() {
                kernel::dispatch(Similarities { moments: &moments, first: y * width + margin, out });
            }
        })
    }

    /// The map, and the gradient of its sum. The window is symmetric and the padding zero, so the adjoint of the
    /// filter is the filter itself.
    fn map_and_gradient(&self, border: Border) -> (Vec<f64>, Vec<f64>) {
        let moments = self.moments(0..self.height);
        let pixels = self.height * self.width;
        let mut by = [vec![0.0; pixels], vec![0.0; pixels], vec![0.0; pixels]];
        let mut map = Vec::with_capacity(pixels);
        for i in self.inside(border) {
            let local = moments.at(i);
            map.push(local.ssim);
            [by[0][i], by[1][i], by[2][i]] = [local.by_mean, local.by_square, local.by_product];
        }
        let filtered = |plane: Vec<f64>| {
            by_bands(0..self.height, self.width, |rows, out| {
                out.copy_from_slice(&self.filter(Plane::Weights(&plane), rows));
            })
        };
        let [mean, square, product] = by.map(filtered);
        let chain = |i: usize| {
            mean[i] + 2.0 * f64::from(self.rendered[i]) * square[i] + f64::from(self.target[i]) * product[i]
        };
        (map, (0..pixels).map(chain).collect())
    }

    /// Indices of the map's pixels, row by row.
    fn inside(&self, border: Border) -> impl Iterator<Item = usize> + use<> {
        let (margin, width) = (border.margin(), self.width);
        let columns = margin..width - margin;
        (margin..self.height - margin).flat_map(move |y| columns.clone().map(move |x| y * width + x))
    }

    /// Of the pixels of some rows.
    fn moments(&self, rows: Range<usize>) -> Moments {
        let (a, b) = (self.rendered, self.target);
        let mean = |plane| self.filter(plane, rows.clone());
        Moments {
            mean: [a, b].map(|values| mean(Plane::Values(values))),
            square: [a, b].map(|values| mean(Plane::Product(values, values))),
            product: mean(Plane::Product(a, b)),
        }
    }

    fn filter(&self, plane: Plane, rows: Range<usize>) -> Vec<f64> {
        filter(plane, [self.height, self.width], rows)
    }
}

impl Moments {
    fn at(&self, i: usize) -> Local {
        local(self.mean.each_ref().map(|m| m[i]), self.square.each_ref().map(|s| s[i]), self.product[i])
    }
}

/// SSIM of one pixel from the moments of both images there.
#[inline(always)]
fn local([m1, m2]: [f64; 2], [q1, q2]: [f64; 2], product: f64) -> Local {
    let (s1, s2, s12) = (q1 - m1 * m1, q2 - m2 * m2, product - m1 * m2);
    let (a, b) = (2.0 * m1 * m2 + C1, 2.0 * s12 + C2);
    let (c, d) = (m1 * m1 + m2 * m2 + C1, s1 + s2 + C2);
    let ssim = a * b / (c * d);
    let by_square = -ssim / d;
    let by_product = 2.0 * a / (c * d);
    let by_mean = 2.0 * m2 * b / (c * d) - 2.0 * m1 * ssim / c - 2.0 * m1 * by_square - m2 * by_product;
    Local { ssim, by_mean, by_square, by_product }
}

/// SSIM of as many pixels as `out` holds, from the moments of pixel `first` on.
struct Similarities<'a> {
    moments: &'a Moments,
    first: usize,
    out: &'a mut [f64],
}

impl Kernel for Similarities<'_> {
    type Output = ();

    /// Never fused, so that every machine has the same bits.
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { moments: Moments { mean, square, product }, first, out } = self;
        let range = first..first + out.len();
        let [m1, m2] = [&mean[0][range.clone()], &mean[1][range.clone()]];
        let [q1, q2] = [&square[0][range.clone()], &square[1][range.clone()]];
        let p = &product[range];
        for i in 0..out.len() {
            out[i] = local([m1[i], m2[i]], [q1[i], q2[i]], p[i]).ssim;
        }
    }
}
