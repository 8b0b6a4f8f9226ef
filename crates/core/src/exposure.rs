//! The exposure of a camera as an offset of the log odds of its colours; removed from photographs, applied to renders.

use crate::{ImageRgb8, PlanarImage};

/// How a camera's colours differ from those that all cameras of a capture share: one offset of the log odds `ln(v / (1 - v))` per
/// channel. Exposure and white balance are nearly that, as the curve of a camera saturates at both ends; black stays
/// black, white stays white, every value has one counterpart, and differences of cameras add up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Log odds of the camera's value minus those of the common value: red, green, blue. Positive is brighter.
    pub offsets: [f64; 3],
}

impl Exposure {
    /// A camera that shows the common colours.
    pub const NEUTRAL: Self = Self { offsets: [0.0; 3] };

    /// A photograph of the camera in the common colours.
    #[must_use]
    pub fn removed(&self, photograph: &ImageRgb8) -> ImageRgb8 {
        let tables = self.offsets.map(|offset| {
            let value = |byte: usize| scale_odds(byte as f32 / 255.0, (-offset).exp() as f32);
            std::array::from_fn::<u8, 256, _>(|byte| (value(byte) * 255.0).round() as u8)
        });
        let data = photograph.data().iter().enumerate().map(|(i, &byte)| tables[i % 3][usize::from(byte)]);
        ImageRgb8::new(photograph.size(), data.collect()).expect("one byte per byte")
    }

    /// A render in the common colours as the camera would show it; values are clamped to 0..=1 unless the camera is neutral.
    pub fn apply(&self, rendered: &mut PlanarImage) {
        if *self == Self::NEUTRAL {
            return;
        }
        let pixels = rendered.size().pixels();
        for (plane, offset) in rendered.data_mut().chunks_mut(pixels.max(1)).zip(self.offsets) {
            let odds = offset.exp() as f32;
            plane.iter_mut().for_each(|v| *v = scale_odds(v.clamp(0.0, 1.0), odds));
        }
    }
}

impl Exposure {
    /// A common colour as the camera shows it, and the derivative of that per channel. Values outside 0..=1, which are clipped, stay where they are.
    pub(crate) fn of_colour(self, colour: [f32; 3]) -> ([f32; 3], [f32; 3]) {
        let odds = self.offsets.map(|offset| offset.exp() as f32);
        let inside = colour.map(|v| v.clamp(0.0, 1.0));
        let shown = std::array::from_fn(|c| colour[c] - inside[c] + scale_odds(inside[c], odds[c]));
        let slopes = std::array::from_fn(|c| odds[c] / (1.0 - inside[c] + inside[c] * odds[c]).powi(2));
        (shown, slopes)
    }
}

/// The value whose odds are `odds` times those of `value`, which is in 0..=1.
pub fn scale_odds(value: f32, odds: f32) -> f32 {
    value * odds / (1.0 - value + value * odds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImageSize;

    #[test]
    fn a_colour_changes_as_a_render_does_and_its_slope_is_the_difference_quotient() {
        let exposure = Exposure { offsets: [0.4, -0.9, 0.0] };
        for value in [0.0, 0.05, 0.5, 0.97, 1.0] {
            let mut render = PlanarImage::zeros(ImageSize { width: 1, height: 1 });
            render.set_pixel(0, [value; 3]);
            exposure.apply(&mut render);
            let (shown, slopes) = exposure.of_colour([value; 3]);
            assert_eq!(shown, render.pixel(0));
            if value > 0.0 && value < 1.0 {
                let at = |v: f32| exposure.of_colour([v; 3]).0;
                let (above, below) = (at(value + 1e-3), at(value - 1e-3));
                for c in 0..3 {
                    assert!(((above[c] - below[c]) / 2e-3 - slopes[c]).abs() < 2e-3, "{value}, {c}");
                }
            }
        }
        assert_eq!(exposure.of_colour([1.5, -0.5, 0.0]).0, [1.5, -0.5, 0.0], "clipped values stay");
    }

    #[test]
    fn black_and_white_stay_and_a_photograph_returns() {
        let size = ImageSize { width: 256, height: 1 };
        let bytes: Vec<u8> = (0..=255).flat_map(|v| [v; 3]).collect();
        let photograph = ImageRgb8::new(size, bytes.clone()).unwrap();
        let exposure = Exposure { offsets: [0.0, 0.7, -0.7] };
        let common = exposure.removed(&photograph);
        assert_eq!(common.pixel(0), [0.0; 3]);
        assert_eq!(common.pixel(255), [1.0; 3]);
        // Mid-grey: odds 128 / 127.
        let expected = |offset: f32| 128.0 / (128.0 + 127.0 * offset.exp());
        let grey = common.pixel(128);
        for (found, offset) in grey.iter().zip([0.0, 0.7, -0.7]) {
            assert!((found - expected(offset)).abs() < 0.5 / 255.0, "{grey:?}");
        }
        let mut back = PlanarImage::from(&common);
        exposure.apply(&mut back);
        let furthest = ImageRgb8::from(&back).data().iter().zip(&bytes).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(furthest <= Some(2), "{furthest:?}");
        assert_eq!(Exposure::NEUTRAL.removed(&photograph), photograph);
    }
}
