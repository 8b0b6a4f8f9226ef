//! Exposures of the photographs of a frame against the scene that they show (docs/adr/0090-exposures-and-light-are-followed.md).

use crate::background::{SkyBehind, outside};
use crate::exposures::{CLIPPED, factor};
use ffgs_core::{Gaussians, SkyCube, TrainingView, scale_odds, upper_median};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};

/// Pixels of a view beyond which it is reduced: three numbers need no more.
const MOST_PIXELS: usize = 160 * 160;
/// Blocks along each side of a picture.
const BLOCKS: usize = 4;
/// Fewest blocks that tell the exposure of a view,
const FEWEST_BLOCKS: usize = 6;
/// and pixels that tell that of a block.
const FEWEST_PIXELS: usize = 40;
/// Residual at which the weight is a quarter, in units of the median residual,
const SOFT: f32 = 1.5;
/// and the least of it: renders never fit better.
const LEAST_SCALE: f32 = 0.01;
/// Rounds of reweighting.
const ROUNDS: usize = 8;
/// Standard deviation of a normal distribution over the median distance from its middle.
const NORMAL: f64 = 1.4826;
/// Standard error of a median over that of a mean.
const OF_MEDIAN: f64 = 1.2533;

/// How a photograph differs from the scene, per channel (red, green, blue).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotographExposure {
    /// Log odds of the photograph's values minus those of the scene's; positive is brighter.
    pub offsets: [f64; 3],
    /// Standard error of these: large where the parts of the picture contradict each other.
    pub errors: [f64; 3],
}

/// Render and photograph of one channel of a pixel.
type Shown = (f32, f32);

/// How each of the photographs `views` differs from `layer` before `sky` where no mask, widened by `mask_dilation` pixels, is; `None` of a view that
/// shows too little of them.
///
/// Of each block of a picture the offset with the least robust squared difference is found, and the middle one of these is the picture's: a third of the
/// blocks may show what the scene does not have. Values rather than log odds are compared, as a render that is blurred is right in the mean.
pub fn photograph_exposures(
    layer: &Gaussians,
    sky: &SkyCube,
    views: &[TrainingView],
    mask_dilation: usize,
) -> Vec<Option<PhotographExposure>> {
    let (mut tape, mut behind) = (RenderTape::default(), SkyBehind::new());
    let measure = |view: &TrainingView| {
        let view = view.reduced(factor(view, MOST_PIXELS));
        let background = Background::Image(behind.render(sky, &view.camera));
        let frame = View { camera: &view.camera, background, tiles: None };
        CpuRasterizer::default().render(layer, &frame, &mut tape);
        let shown = |c: usize, p: usize| (tape.image().pixel(p)[c], view.image.pixel(p)[c]);
        compared(&view, mask_dilation, &shown)
    };
    views.iter().map(measure).collect()
}

/// What `shown` says of channels and pixels outside the mask.
fn compared(
    view: &TrainingView,
    mask_dilation: usize,
    shown: &dyn Fn(usize, usize) -> Shown,
) -> Option<PhotographExposure> {
    let (size, counts) = (view.camera.size(), outside(view, mask_dilation));
    let mut out = PhotographExposure { offsets: [0.0; 3], errors: [0.0; 3] };
    for c in 0..3 {
        let mut blocks = vec![Vec::new(); BLOCKS * BLOCKS];
        for p in (0..size.pixels()).filter(|&p| counts.data()[p] != 0) {
            let (render, photograph) = shown(c, p);
            if tells(render) && tells(photograph) {
                let (x, y) = (p % size.width * BLOCKS / size.width, p / size.width * BLOCKS / size.height);
                blocks[y * BLOCKS + x].push((render, photograph));
            }
        }
        blocks.retain(|block| block.len() >= FEWEST_PIXELS);
        if blocks.len() < FEWEST_BLOCKS {
            return None;
        }
        let offsets: Vec<f64> = blocks.iter().map(|block| brighter(block)).collect();
        let middle = upper_median(offsets.iter().copied()).unwrap_or(0.0);
        let spread =
            NORMAL * upper_median(offsets.iter().map(|offset| (offset - middle).abs())).unwrap_or(0.0);
        out.offsets[c] = middle;
        out.errors[c] = OF_MEDIAN * spread / (offsets.len() as f64).sqrt();
    }
    Some(out)
}

fn tells(value: f32) -> bool {
    let clipped = CLIPPED as f32;
    value > clipped && value < 1.0 - clipped
}

/// Offset of the log odds from renders to photographs: Gauss-Newton steps on the values, with the weights of Geman and McClure.
fn brighter(shown: &[Shown]) -> f64 {
    let mut offset = 0.0_f64;
    for _ in 0..ROUNDS {
        let odds = offset.exp() as f32;
        let residuals = shown
            .iter()
            .map(|&(render, photograph)| f64::from((photograph - scale_odds(render, odds)).abs()));
        let scale = (SOFT * upper_median(residuals).unwrap_or(0.0) as f32).max(LEAST_SCALE);
        let (mut right, mut square) = (0.0_f64, f64::MIN_POSITIVE);
        for &(render, photograph) in shown {
            let value = scale_odds(render, odds);
            let (residual, slope) = (photograph - value, value * (1.0 - value));
            let weight = (scale * scale / (scale * scale + residual * residual)).powi(2);
            right += f64::from(weight * slope * residual);
            square += f64::from(weight * slope * slope);
        }
        offset += right / square;
    }
    offset
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::from_points;
    use ffgs_core::{Camera, Exposure, ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage};
    use glam::DMat4;

    const SIZE: ImageSize = ImageSize { width: 96, height: 64 };
    const BRIGHTER: Exposure = Exposure { offsets: [0.3, 0.1, -0.2] };

    /// A wall of many colours at z = 2, before a sky.
    fn scene() -> (Gaussians, SkyCube) {
        let points: Vec<[f32; 3]> =
            (0..6000).map(|i| [(i % 100) as f32 * 0.04 - 2.0, (i / 100) as f32 * 0.04 - 1.2, 2.0]).collect();
        let colours: Vec<[f32; 3]> =
            (0..6000).map(|i| [11, 17, 29].map(|k| 0.2 + 0.6 * ((i / 7 * k) % 97) as f32 / 97.0)).collect();
        (from_points(&points, &colours, 0, 0.9), SkyCube::filled(4, [0.3, 0.5, 0.6]))
    }

    /// `change` alters what is drawn before it is photographed.
    fn photograph(change: impl Fn(usize, [f32; 3]) -> [f32; 3]) -> TrainingView {
        let (layer, sky) = scene();
        let intrinsics = Intrinsics { fx: 80.0, fy: 80.0, cx: 48.0, cy: 32.0 };
        let camera = Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap();
        let (mut tape, mut behind) = (RenderTape::default(), SkyBehind::new());
        let background = Background::Image(behind.render(&sky, &camera));
        CpuRasterizer::default().render(
            &layer,
            &View { camera: &camera, background, tiles: None },
            &mut tape,
        );
        let mut image: PlanarImage = tape.image().clone();
        (0..SIZE.pixels()).for_each(|p| image.set_pixel(p, change(p, image.pixel(p))));
        TrainingView { camera, image: ImageRgb8::from(&image), mask: Mask::filled(SIZE, false) }
    }

    fn exposed(exposure: Exposure) -> TrainingView {
        let view = photograph(|_, colour| colour);
        let mut image = PlanarImage::from(&view.image);
        exposure.apply(&mut image);
        TrainingView { image: ImageRgb8::from(&image), ..view }
    }

    fn measured(view: &TrainingView) -> Option<PhotographExposure> {
        let (layer, sky) = scene();
        photograph_exposures(&layer, &sky, std::slice::from_ref(view), 1)[0]
    }

    fn assert_found(view: &TrainingView, expected: Exposure, tolerance: f64) {
        let found = measured(view).unwrap();
        for c in 0..3 {
            assert!((found.offsets[c] - expected.offsets[c]).abs() < tolerance, "{found:?}");
            assert!(found.errors[c] < tolerance, "{found:?}");
        }
    }

    #[test]
    fn the_exposure_of_a_photograph_is_found() {
        assert_found(&exposed(BRIGHTER), BRIGHTER, 0.01);
        assert_found(&exposed(Exposure::NEUTRAL), Exposure::NEUTRAL, 0.003);
    }

    #[test]
    fn what_the_scene_does_not_have_is_outvoted() {
        let mut view = exposed(BRIGHTER);
        let mut data = view.image.data().to_vec();
        data[..SIZE.pixels()].fill(200);
        view.image = ImageRgb8::new(SIZE, data).unwrap();
        assert_found(&view, BRIGHTER, 0.03);
    }

    #[test]
    fn a_shadow_over_half_of_the_picture_is_no_exposure() {
        let dark = |p: usize, colour: [f32; 3]| {
            if p % SIZE.width < SIZE.width / 2 { colour.map(|v| 0.6 * v) } else { colour }
        };
        let found = measured(&photograph(dark)).unwrap();
        for c in 0..3 {
            assert!(found.offsets[c].abs() < 3.0 * found.errors[c], "{found:?}");
        }
    }

    #[test]
    fn what_masks_hide_or_is_clipped_tells_nothing() {
        let masked = TrainingView { mask: Mask::filled(SIZE, true), ..exposed(BRIGHTER) };
        assert_eq!(measured(&masked), None);
        assert_eq!(measured(&photograph(|_, _| [1.0; 3])), None);
        let (layer, sky) = scene();
        assert_eq!(photograph_exposures(&layer, &sky, &[], 1), []);
        let mut broken = layer.clone();
        broken.sh.fill([f32::NAN; 3]);
        let found = photograph_exposures(&broken, &sky, &[exposed(BRIGHTER)], 1)[0];
        assert!(found.is_none_or(|f| f.offsets.iter().all(|o| o.is_finite())), "{found:?}");
    }
}
