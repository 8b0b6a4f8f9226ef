use ffgs_core::{ImageRgb8, ImageSize, Mask};
use rayon::prelude::*;

/// Colours (0 to 255) that differ by less in every channel show the same thing: noise and compression.
const SAME_COLOUR: f32 = 14.0;
/// Least standard deviation of a pixel (grey levels).
const LEAST_SPREAD: f32 = 1.5;
/// Pixels that are used for the exposure.
const EXPOSURE_PIXELS: usize = 4000;

/// What a fixed camera sees where nothing moves.
#[derive(Clone, Debug)]
pub(crate) struct Background {
    pub size: ImageSize,
    /// Colour (0 to 255).
    pub colour: Vec<[f32; 3]>,
    /// Standard deviation of the samples (grey levels).
    pub spread: Vec<f32>,
}

impl Background {
    /// The colour that most samples agree on at each pixel; samples inside `masks` (one each, or none at all) do not
    /// count as long as others are left. Exposure differences are taken out before.
    pub(crate) fn learn(images: &[ImageRgb8], masks: &[Mask]) -> Self {
        let size = images[0].size();
        let gains: Vec<[f32; 3]> = {
            let reference = median_image(images);
            images.iter().map(|image| gain(image, &reference)).collect()
        };
        let modes: Vec<([f32; 3], f32)> = (0..size.pixels())
            .into_par_iter()
            .map(|i| {
                let sample =
                    |s: usize| std::array::from_fn(|c| f32::from(images[s].data()[i * 3 + c]) * gains[s][c]);
                let free = |s: &usize| masks.get(*s).is_none_or(|m| m.data()[i] == 0);
                let mut samples: Vec<[f32; 3]> = (0..images.len()).filter(free).map(sample).collect();
                if samples.is_empty() {
                    samples = (0..images.len()).map(sample).collect();
                }
                mode(&samples)
            })
            .collect();
        let (colour, spread) = modes.into_iter().unzip();
        Self { size, colour, spread }
    }

    /// Factors by which an image is multiplied to have the background's exposure.
    pub(crate) fn gain(&self, image: &ImageRgb8) -> [f32; 3] {
        gain(image, &self.colour)
    }
}

/// The mean of the largest group of samples of one colour, and its spread.
fn mode(samples: &[[f32; 3]]) -> ([f32; 3], f32) {
    let same = |a: &[f32; 3], b: &[f32; 3]| a.iter().zip(b).all(|(x, y)| (x - y).abs() <= SAME_COLOUR);
    let group = |a: &[f32; 3]| samples.iter().filter(|b| same(a, b)).count();
    let scatter = |a: &[f32; 3]| -> f32 {
        samples
            .iter()
            .filter(|b| same(a, b))
            .map(|b| a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f32>())
            .sum()
    };
    let better =
        |a: &&[f32; 3], b: &&[f32; 3]| group(a).cmp(&group(b)).then(scatter(b).total_cmp(&scatter(a)));
    let best = samples.iter().max_by(better).expect("there are samples");
    let members: Vec<&[f32; 3]> = samples.iter().filter(|b| same(best, b)).collect();
    let n = members.len() as f32;
    let mean: [f32; 3] = std::array::from_fn(|c| members.iter().map(|m| m[c]).sum::<f32>() / n);
    let square = |m: &[f32; 3]| (0..3).map(|c| (m[c] - mean[c]) * (m[c] - mean[c])).fold(0.0, f32::max);
    let variance = members.iter().map(|m| square(m)).sum::<f32>() / n;
    (mean, variance.sqrt().max(LEAST_SPREAD))
}

fn stride(pixels: usize) -> usize {
    (pixels / EXPOSURE_PIXELS).max(1)
}

/// Per pixel and channel the median of the images, at the pixels that serve for the exposure.
fn median_image(images: &[ImageRgb8]) -> Vec<[f32; 3]> {
    let pixels = images[0].size().pixels();
    let mut out = vec![[0.0; 3]; pixels];
    for i in (0..pixels).step_by(stride(pixels)) {
        out[i] = std::array::from_fn(|c| {
            let mut values: Vec<u8> = images.iter().map(|m| m.data()[i * 3 + c]).collect();
            values.sort_unstable();
            f32::from(values[(values.len() - 1) / 2])
        });
    }
    out
}

/// Medians of the ratios, per channel; 1 for a black picture.
fn gain(image: &ImageRgb8, reference: &[[f32; 3]]) -> [f32; 3] {
    std::array::from_fn(|c| {
        let ratio = |i: usize| {
            let (here, there) = (f32::from(image.data()[i * 3 + c]), reference[i][c]);
            (here > 8.0 && there > 8.0 && here < 250.0 && there < 250.0).then(|| there / here)
        };
        let mut ratios: Vec<f32> =
            (0..reference.len()).step_by(stride(reference.len())).filter_map(ratio).collect();
        ratios.sort_by(f32::total_cmp);
        ratios.get(ratios.len() / 2).copied().unwrap_or(1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize { width: 32, height: 8 };

    fn picture(value: impl Fn(usize) -> u8) -> ImageRgb8 {
        ImageRgb8::new(SIZE, (0..SIZE.pixels()).flat_map(|i| [value(i), value(i) / 2, 80]).collect()).unwrap()
    }

    #[test]
    fn what_passes_is_not_background_and_exposure_is_taken_out() {
        // A white block passes over a gradient; the third picture is a tenth brighter.
        let gradient = |i: usize| 60.0 + 3.0 * (i % 32) as f32;
        let block = |i: usize, t: usize| (4 * t..4 * t + 8).contains(&(i % 32));
        let exposure = |t: usize| if t == 2 { 1.1 } else { 1.0 };
        let images: Vec<ImageRgb8> = (0..6)
            .map(|t| picture(|i| if block(i, t) { 250 } else { (gradient(i) * exposure(t)) as u8 }))
            .collect();
        let background = Background::learn(&images, &[]);
        for i in 0..SIZE.pixels() {
            assert!((background.colour[i][0] - gradient(i)).abs() < 4.0, "{i} {:?}", background.colour[i]);
        }
        assert!((background.gain(&images[2])[0] - 1.0 / 1.1).abs() < 0.02);
    }

    #[test]
    fn masked_samples_do_not_count_while_others_are_left() {
        let images: Vec<ImageRgb8> = [200, 200, 200, 90].map(|v| picture(|_| v)).into();
        let covered = |all: bool| Mask::filled(SIZE, all);
        let learnt =
            Background::learn(&images, &[covered(true), covered(true), covered(true), covered(false)]);
        let median = 200.0 / 90.0;
        assert!((learnt.colour[0][0] - 90.0 * median).abs() < 1.0);
        assert!((Background::learn(&images, &[]).colour[0][0] - 200.0).abs() < 1.0);
    }
}
