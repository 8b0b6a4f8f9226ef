//! Derivatives by the texels of a sky, summed over the pixels of a view in parallel.
//!
//! Texels are divided into bands of consecutive ones. One task adds up a band, in the order of the pixels, so that sums are the
//! same bits with any number of threads. It passes over groups of pixels that do not reach its band.

use glam::Vec3;
use rayon::prelude::*;

/// Bands at most: one bit each of a group's mask.
const BANDS: usize = u64::BITS as usize;
/// Pixels of a group.
const GROUP: usize = 64;
/// Groups that are looked at by one task.
const GROUPS: usize = 64;

/// Derivatives by the texels, and which texels have any: those to hand to a sparse Adam step.
#[derive(Clone, Debug)]
pub struct TexelGradients {
    /// Sum of derivatives of each texel, (6 * `face_size`^2).
    pub sums: Vec<[f32; 3]>,
    /// Whether a texel received any.
    pub touched: Vec<bool>,
    /// Texels of a band, a power of two.
    band: usize,
    /// Those that were touched, of each band, counted from its first.
    lists: Vec<Vec<u32>>,
    /// Bands that each group of pixels reaches.
    reached: Vec<u64>,
}

impl TexelGradients {
    /// All zero, for a cube of so many texels.
    pub fn new(texels: usize) -> Self {
        let band = texels.div_ceil(BANDS).next_power_of_two();
        Self {
            sums: vec![[0.0; 3]; texels],
            touched: vec![false; texels],
            band,
            lists: vec![Vec::new(); texels.div_ceil(band)],
            reached: Vec::new(),
        }
    }

    /// Back to zero, at a cost of what was touched.
    pub fn clear(&mut self) {
        self.bands().for_each(|Band { sums, touched, list }| {
            for texel in list.drain(..) {
                sums[texel as usize] = [0.0; 3];
                touched[texel as usize] = false;
            }
        });
    }

    /// Adds the derivatives by so many pixels, each shared out to four texels.
    pub(crate) fn add(
        &mut self,
        pixels: usize,
        gradient: impl Fn(usize) -> Vec3 + Sync,
        shares: impl Fn(usize) -> [(usize, f32); 4] + Sync,
    ) {
        let bits = self.band.trailing_zeros();
        let group = |number: usize| {
            let pixels = number * GROUP..(number * GROUP + GROUP).min(pixels);
            let derivatives = pixels.map(|pixel| (pixel, gradient(pixel)));
            derivatives.filter(|(_, derivative)| *derivative != Vec3::ZERO)
        };
        let mut reached = std::mem::take(&mut self.reached);
        (0..pixels.div_ceil(GROUP))
            .into_par_iter()
            .with_min_len(GROUPS)
            .map(|number| {
                let texels = group(number).flat_map(|(pixel, _)| shares(pixel));
                texels.fold(0, |bands, (texel, _)| bands | 1 << (texel >> bits))
            })
            .collect_into_vec(&mut reached);
        self.bands().enumerate().for_each(|(number, mut band)| {
            let groups = reached.iter().enumerate().filter(|(_, bands)| *bands >> number & 1 == 1);
            for (pixel, derivative) in groups.flat_map(|(number, _)| group(number)) {
                for (texel, weight) in shares(pixel) {
                    if texel >> bits == number && weight > 0.0 {
                        band.add(texel - (number << bits), weight * derivative);
                    }
                }
            }
        });
        self.reached = reached;
    }

    fn bands(&mut self) -> impl IndexedParallelIterator<Item = Band<'_>> {
        let sums = self.sums.par_chunks_mut(self.band);
        let touched = self.touched.par_chunks_mut(self.band);
        let parts = sums.zip(touched).zip(&mut self.lists);
        parts.map(|((sums, touched), list)| Band { sums, touched, list })
    }
}

/// Consecutive texels.
struct Band<'a> {
    sums: &'a mut [[f32; 3]],
    touched: &'a mut [bool],
    list: &'a mut Vec<u32>,
}

impl Band<'_> {
    #[inline(always)]
    fn add(&mut self, texel: usize, gradient: Vec3) {
        if !self.touched[texel] {
            self.touched[texel] = true;
            self.list.push(texel as u32);
        }
        self.sums[texel] = (Vec3::from(self.sums[texel]) + gradient).to_array();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 1000;

    /// A third of the pixels have no derivative.
    fn derivative(pixel: usize) -> Vec3 {
        let at = |k: usize| ((pixel * k) as f32).sin();
        if pixel.is_multiple_of(3) { Vec3::ZERO } else { Vec3::new(at(3), at(5), at(7)) }
    }

    /// Neighbours wherever the pixel lies, with bilinear weights; some are zero.
    fn shares(pixel: usize, texels: usize) -> [(usize, f32); 4] {
        let (first, share) = (pixel * 37 % texels, (pixel % 5) as f32 / 4.0);
        let texel = |k: usize| (first + k * texels / 7) % texels;
        [(texel(0), 1.0 - share), (texel(1), share), (texel(2), 0.5 * share), (texel(3), 0.25)]
    }

    #[test]
    fn bands_give_the_bits_of_a_sum_from_pixel_to_pixel() {
        for texels in [6, 24, 96, 1536, 6 * 50 * 50] {
            let mut expected = vec![Vec3::ZERO; texels];
            let mut touched = vec![false; texels];
            for pixel in (0..PIXELS).filter(|&pixel| derivative(pixel) != Vec3::ZERO) {
                for (texel, weight) in shares(pixel, texels).into_iter().filter(|(_, weight)| *weight > 0.0) {
                    expected[texel] += weight * derivative(pixel);
                    touched[texel] = true;
                }
            }
            let mut sums = TexelGradients::new(texels);
            // What was there before is gone, and memory of a larger picture is no harm.
            sums.add(2 * PIXELS, derivative, |pixel| shares(pixel + 1, texels));
            sums.clear();
            assert!(sums.sums.iter().flatten().all(|&v| v == 0.0) && !sums.touched.contains(&true));
            sums.add(PIXELS, derivative, |pixel| shares(pixel, texels));
            assert_eq!(sums.touched, touched, "{texels} texels");
            let bits = |v: [f32; 3]| v.map(f32::to_bits);
            let same = sums.sums.iter().zip(&expected).all(|(a, b)| bits(*a) == bits(b.to_array()));
            assert!(same, "{texels} texels");
        }
    }
}
