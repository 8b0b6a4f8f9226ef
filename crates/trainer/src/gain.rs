//! Information on every parameter in the photographs of a frame, and the noise of their pixels.

use crate::background::SkyBehind;
use crate::lengths::TILE_DILATION;
use ffgs_core::{Gaussians, ImageSize, PlanarImage, SkyCube, TrainingView};
use ffgs_rasterizer::{Background, CpuRasterizer, Information, RenderTape, TileMask, View};
use rayon::prelude::*;
use std::ops::Range;

/// Views that are rendered side by side at most, each with an image of its own; their information is added in order.
const MAX_AT_ONCE: usize = 8;
/// Longest distance at which errors of pixels are compared (px).
const MAX_LAG: usize = 6;
/// Correlation below which errors count as independent.
const MIN_CORRELATION: f64 = 0.1;
/// Standard deviation of a normal variable over its mean absolute value, `sqrt(pi / 2)`.
const SIGMA_OF_ABSOLUTE: f64 = 1.253_314;
/// Least standard deviation of a pixel: that of rounding to 8 bits.
const MIN_NOISE: f64 = 0.29 / 255.0;

/// How far pixels of a trained frame are off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelNoise {
    /// Standard deviation of a channel of a foreground pixel (0..1).
    pub sigma: f64,
    /// Values (pixels times channels) that share one error: so many count as one.
    pub correlated: f64,
}

/// The information of one frame.
#[derive(Clone, Debug)]
pub struct Gain {
    /// Information of every parameter.
    pub information: Information,
    /// Noise it was made with.
    pub noise: PixelNoise,
}

/// The information that the views hold on the last of the `layers`, which are rendered together, in the tiles of the foreground:
/// those in which it is trained. Foreground and background have each their own noise in every view, so that a camera that fits badly
/// counts less; views without foreground tell nothing.
pub fn information_gain(layers: &[&Gaussians], sky: &SkyCube, views: &[TrainingView]) -> Gain {
    let rasterizer = CpuRasterizer::default();
    let mut information = layers
        .last()
        .map_or_else(Information::default, |layer| Information::none(layer.len(), layer.sh_degree()));
    let mut foreground = Vec::new();
    let views: Vec<&TrainingView> = views.iter().filter(|view| view.mask.count() > 0).collect();
    let at_once = rayon::current_num_threads().min(MAX_AT_ONCE);
    let mut rendered: Vec<Rendered> = (0..at_once).map(|_| Rendered::new()).collect();
    for views in views.chunks(at_once) {
        let pairs = rendered.par_iter_mut().zip(views);
        pairs.for_each(|(rendered, view)| rendered.render(&rasterizer, layers, sky, view));
        for (rendered, view) in rendered.iter().zip(views) {
            foreground.extend(rendered.foreground.map(|noise| (noise, view.mask.count())));
            let background = Background::Image(rendered.behind.image());
            let frame = View { camera: &view.camera, background, tiles: rendered.tiles.as_ref() };
            rasterizer.add_information(layers, &frame, &rendered.tape, &rendered.weights, &mut information);
        }
    }
    Gain { information, noise: mean_noise(&foreground) }
}

/// A view as the layers show it, and what its pixels are worth.
struct Rendered {
    tape: RenderTape,
    behind: SkyBehind,
    tiles: Option<TileMask>,
    /// Inverse variance of an independent value, pixel by pixel.
    weights: Vec<f32>,
    /// Noise inside the mask.
    foreground: Option<PixelNoise>,
}

impl Rendered {
    fn new() -> Self {
        let (tape, behind) = (RenderTape::default(), SkyBehind::new());
        Self { tape, behind, tiles: None, weights: Vec::new(), foreground: None }
    }

    fn render(
        &mut self,
        rasterizer: &CpuRasterizer,
        layers: &[&Gaussians],
        sky: &SkyCube,
        view: &TrainingView,
    ) {
        let tiles = TileMask::covering(&view.mask.widened(TILE_DILATION));
        let background = Background::Image(self.behind.render(sky, &view.camera));
        let frame = View { camera: &view.camera, background, tiles: Some(&tiles) };
        rasterizer.render_layers(layers, &frame, &mut self.tape);
        let errors = Errors::new(view, self.tape.image(), tiles.pixel_runs(view.camera.size()));
        let (outside, inside) = rayon::join(|| errors.noise(0), || errors.noise(1));
        self.weights = errors.weights([outside, inside]);
        (self.tiles, self.foreground) = (Some(tiles), inside);
    }
}

/// Mean over views, weighted by their foreground.
fn mean_noise(views: &[(PixelNoise, usize)]) -> PixelNoise {
    let pixels: f64 = views.iter().map(|v| v.1 as f64).sum();
    let mean = |of: &dyn Fn(&PixelNoise) -> f64| views.iter().map(|v| of(&v.0) * v.1 as f64).sum::<f64>();
    if views.is_empty() {
        return PixelNoise { sigma: MIN_NOISE, correlated: 1.0 };
    }
    PixelNoise {
        sigma: (mean(&|n| n.sigma.powi(2)) / pixels).sqrt(),
        correlated: mean(&|n| n.correlated) / pixels,
    }
}

/// Errors of a rendered view: photograph minus render.
struct Errors {
    size: ImageSize,
    /// Where something was rendered.
    runs: Vec<Range<usize>>,
    planes: PlanarImage,
    /// (pixels) 0 or 1 as in the mask; 2 where nothing was rendered.
    regions: Vec<u8>,
}

impl Errors {
    /// In the pixels of `runs`.
    fn new(view: &TrainingView, rendered: &PlanarImage, runs: Vec<Range<usize>>) -> Self {
        let size = view.camera.size();
        let (mut planes, mut regions) = (PlanarImage::zeros(size), vec![2; size.pixels()]);
        for run in &runs {
            regions[run.clone()].copy_from_slice(&view.mask.data()[run.clone()]);
            for pixel in run.clone() {
                let (photograph, render) = (view.image.pixel(pixel), rendered.pixel(pixel));
                planes.set_pixel(pixel, std::array::from_fn(|c| photograph[c] - render[c]));
            }
        }
        Self { size, runs, planes, regions }
    }

    /// The pixels outside (0) or inside (1) the mask.
    fn pixels(&self, region: u8) -> impl Iterator<Item = usize> {
        self.runs.iter().cloned().flatten().filter(move |&pixel| self.regions[pixel] == region)
    }

    /// Inverse variance of an independent value, pixel by pixel, given the noise outside and inside the mask.
    fn weights(&self, noise: [Option<PixelNoise>; 2]) -> Vec<f32> {
        let weight = |noise: PixelNoise| (1.0 / (noise.sigma.powi(2) * noise.correlated)) as f32;
        let of = noise.map(|noise| noise.map_or(0.0, weight));
        self.regions.iter().map(|&region| of.get(usize::from(region)).copied().unwrap_or(0.0)).collect()
    }

    /// Noise outside (0) or inside (1) the mask; `None` without pixels.
    fn noise(&self, region: u8) -> Option<PixelNoise> {
        let count = self.pixels(region).count();
        if count == 0 {
            return None;
        }
        let squares: f64 = (0..3).map(|c| self.products(self.planes.plane(c), region, [0, 0]).0).sum();
        let sizes = |c: usize| self.pixels(region).map(move |p| f64::from(self.planes.plane(c)[p].abs()));
        let absolute: f64 = (0..3).map(|c| sizes(c).sum::<f64>()).sum();
        let mut grey = vec![0.0; self.regions.len()];
        self.pixels(region).for_each(|p| grey[p] = self.planes.pixel(p).iter().sum());
        let own = self.products(&grey, region, [0, 0]);
        let channels = own.0 / squares.max(f64::MIN_POSITIVE);
        let along = |step: [usize; 2]| 1.0 + 2.0 * self.correlations(&grey, region, step, own);
        let correlated = (channels * along([1, 0]) * along([0, 1])).max(1.0);
        // Few pixels that the model cannot show must not hide what all others tell: the mean absolute error, not the square.
        let sigma = (SIGMA_OF_ABSOLUTE * absolute / (3 * count) as f64).max(MIN_NOISE);
        Some(PixelNoise { sigma, correlated })
    }

    /// Sum of the correlations with pixels one, two, ... steps (columns, rows) away, until they are small. `own` are the products without
    /// a distance.
    fn correlations(&self, values: &[f32], region: u8, step: [usize; 2], own: (f64, usize)) -> f64 {
        let mean = |(sum, count): (f64, usize)| sum / count.max(1) as f64;
        let of = |lag: usize| {
            mean(self.products(values, region, step.map(|s| lag * s))) / mean(own).max(f64::MIN_POSITIVE)
        };
        (1..=MAX_LAG).map(of).take_while(|&r| r > MIN_CORRELATION).sum()
    }

    /// Sum over the pixels of a region of products with the value so many columns and rows on, and their number. The end of a row and
    /// the start of the next one follow each other in memory but not in the picture: they are no pair.
    fn products(&self, values: &[f32], region: u8, [columns, rows]: [usize; 2]) -> (f64, usize) {
        let width = self.size.width;
        let distance = columns + rows * width;
        let in_row = |p: usize| columns == 0 || p % width + columns < width;
        let pairs =
            self.pixels(region).filter(|&p| in_row(p) && self.regions.get(p + distance) == Some(&region));
        pairs.fold((0.0, 0), |(sum, count), p| {
            (sum + f64::from(values[p]) * f64::from(values[p + distance]), count + 1)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, Intrinsics, Mask};

    const SIZE: ImageSize = ImageSize { width: 96, height: 64 };

    /// A view whose photograph is 128 plus 8-bit noise that `of(pixel, channel)` gives, without foreground.
    fn view(of: impl Fn(usize, usize) -> i32) -> TrainingView {
        let intrinsics = Intrinsics { fx: 80.0, fy: 80.0, cx: 48.0, cy: 32.0 };
        let camera = Camera::new(intrinsics, glam::DMat4::IDENTITY, SIZE).unwrap();
        let data = (0..3 * SIZE.pixels()).map(|i| (128 + of(i / 3, i % 3)) as u8).collect();
        TrainingView { camera, image: ImageRgb8::new(SIZE, data).unwrap(), mask: Mask::filled(SIZE, false) }
    }

    /// White, -20 or 20.
    fn white(i: usize) -> i32 {
        let mut x = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        x ^= x >> 29;
        x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        if (x >> 40) & 1 == 0 { -20 } else { 20 }
    }

    fn everywhere() -> Vec<Range<usize>> {
        std::iter::once(0..SIZE.pixels()).collect()
    }

    fn flat() -> PlanarImage {
        let mut flat = PlanarImage::zeros(SIZE);
        flat.data_mut().fill(128.0 / 255.0);
        flat
    }

    fn noise(view: &TrainingView) -> PixelNoise {
        Errors::new(view, &flat(), everywhere()).noise(0).unwrap()
    }

    #[test]
    fn as_many_values_count_as_one_as_share_an_error() {
        let independent = noise(&view(|p, c| white(3 * p + c)));
        assert!((independent.sigma - SIGMA_OF_ABSOLUTE * 20.0 / 255.0).abs() < 1e-3);
        assert!((independent.correlated - 1.0).abs() < 0.15, "{independent:?}");
        let grey = noise(&view(|p, _| white(p)));
        assert!((grey.correlated - 3.0).abs() < 0.3, "{grey:?}");
        // Blocks of 4 by 4 pixels: neighbours one, two, three on share it with probability 3/4, 1/2, 1/4.
        let blocks = noise(&view(|p, _| white(p % 96 / 4 + 24 * (p / 96 / 4))));
        assert!((blocks.correlated / 48.0).ln().abs() < 0.35, "{blocks:?}");
    }

    #[test]
    fn the_end_of_a_row_and_the_start_of_the_next_are_no_pair() {
        // Errors in the first and the last column only; the last of a row equals the first of the next.
        let error = |p: usize| match p % 96 {
            0 => white(p),
            95 => white(p + 1),
            _ => 0,
        };
        let along_rows = |shift: usize| {
            let errors = Errors::new(&view(|p, _| error(p + shift)), &flat(), everywhere());
            let values = errors.planes.plane(0);
            errors.correlations(values, 0, [1, 0], errors.products(values, 0, [0, 0]))
        };
        assert_eq!(along_rows(0), 0.0);
        // The same values one pixel on: now those that are equal are neighbours in a row.
        assert!((along_rows(95) - 0.5).abs() < 0.02, "the test could tell: {}", along_rows(95));
    }

    #[test]
    fn what_was_not_rendered_counts_for_nothing() {
        // Left of column 48 noise, right of it a photograph that has nothing to do with what the tape holds.
        let view = view(|p, c| if p % 96 < 48 { white(3 * p + c) } else { 120 });
        let flat = flat();
        let left: Vec<Range<usize>> = (0..SIZE.height).map(|y| y * 96..y * 96 + 48).collect();
        let errors = Errors::new(&view, &flat, left);
        let noise = errors.noise(0).unwrap();
        assert!((noise.sigma - SIGMA_OF_ABSOLUTE * 20.0 / 255.0).abs() < 1e-3, "{noise:?}");
        assert!((noise.correlated - 1.0).abs() < 0.2, "{noise:?}");
        assert_eq!(errors.noise(1), None, "no foreground");
        let weights = errors.weights([Some(noise); 2]);
        assert!((0..SIZE.pixels()).all(|p| (weights[p] > 0.0) == (p % 96 < 48)));
        let everything = Errors::new(&view, &flat, everywhere()).noise(0).unwrap();
        assert!(everything.sigma > 2.0 * noise.sigma, "the test could tell: {everything:?}");
    }

    #[test]
    fn a_frame_that_fits_to_the_bit_is_not_known_for_ever() {
        assert!((noise(&view(|_, _| 0)).sigma - MIN_NOISE).abs() < 1e-9);
    }
}
