//! A dense field in 16-bit numbers: 8 bytes per pixel instead of 16.

use bytemuck::{Pod, Zeroable};
use ffgs_core::DenseMotion;

/// One pixel, as `unpack_field` reads it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct PackedPixel {
    /// Flow from the middle, in 32767 steps to the reach.
    pub flow: [i16; 2],
    /// Visibility and confidence, in 65535 steps to 1.
    pub certainty: [u16; 2],
}

/// Flow and confidence of some pixels. Steps are as fine as the pixels' own range allows: an object moves as a whole, so
/// its flows differ by far less than they are long, and fixed steps over that range are finer than half floats are.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Packed {
    /// Middle of the range of the flow (px).
    pub middle: [f32; 2],
    /// From there to its ends (px).
    pub reach: [f32; 2],
    /// The pixels.
    pub pixels: Vec<PackedPixel>,
}

impl Packed {
    /// Of the pixels with these numbers; where the flow is no number, nothing is known.
    pub(crate) fn new(field: &DenseMotion, numbers: &[u32]) -> Self {
        let known = |p: usize| field.confidence[p] > 0.0 && field.flow[p].iter().all(|v| v.is_finite());
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for flow in numbers.iter().map(|&p| p as usize).filter(|&p| known(p)).map(|p| field.flow[p]) {
            for a in 0..2 {
                (low[a], high[a]) = (low[a].min(flow[a]), high[a].max(flow[a]));
            }
        }
        let any = low[0] <= high[0];
        let middle = [0, 1].map(|a| if any { 0.5 * (low[a] + high[a]) } else { 0.0 });
        let reach = [0, 1].map(|a| if any { (high[a] - middle[a]).max(middle[a] - low[a]) } else { 0.0 });
        let steps = |value: f32, reach: f32| {
            if reach > 0.0 { (value / reach * 32767.0).round() as i16 } else { 0 }
        };
        let pixel = |&number: &u32| {
            let p = number as usize;
            if !known(p) {
                return PackedPixel::zeroed();
            }
            // What is known must stay known.
            let confidence = unit(field.confidence[p]).max(1);
            PackedPixel {
                flow: [0, 1].map(|a| steps(field.flow[p][a] - middle[a], reach[a])),
                certainty: [unit(field.visibility[p]), confidence],
            }
        };
        Self { middle, reach, pixels: numbers.iter().map(pixel).collect() }
    }
}

fn unit(value: f32) -> u16 {
    (value * 65535.0).round() as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    fn field(flow: impl Fn(usize) -> [f32; 2]) -> (DenseMotion, Vec<u32>) {
        let mut field = DenseMotion::unknown(ImageSize { width: 64, height: 1 });
        for p in 0..64 {
            field.flow[p] = flow(p);
            field.confidence[p] = p as f32 / 63.0;
        }
        (field, (0..64).collect())
    }

    #[test]
    fn steps_are_a_65534th_of_the_range() {
        let (field, numbers) = field(|p| [812.3 + 0.37 * p as f32, -95.1 - (p as f32 * 0.7).sin()]);
        let packed = Packed::new(&field, &numbers);
        for (p, pixel) in packed.pixels.iter().enumerate().skip(1) {
            for a in 0..2 {
                let found = packed.middle[a] + f32::from(pixel.flow[a]) / 32767.0 * packed.reach[a];
                let bound = packed.reach[a] / 65534.0 + 2e-4;
                assert!((found - field.flow[p][a]).abs() <= bound, "pixel {p}: {found}");
            }
            assert!((f32::from(pixel.certainty[1]) / 65535.0 - field.confidence[p]).abs() < 1e-5);
        }
    }

    #[test]
    fn what_is_unknown_or_no_number_is_unknown_and_does_not_widen_the_range() {
        let (mut field, numbers) = field(|p| [if p == 0 { 1e9 } else { p as f32 }, 3.0]);
        field.flow[5] = [f32::NAN, 0.0];
        field.flow[6] = [0.0, f32::INFINITY];
        field.confidence[7] = 1e-9;
        let packed = Packed::new(&field, &numbers);
        assert_eq!((packed.middle, packed.reach), ([32.0, 3.0], [31.0, 0.0]));
        for unknown in [0, 5, 6] {
            assert_eq!(packed.pixels[unknown], PackedPixel::zeroed());
        }
        assert_eq!(packed.pixels[7].certainty[1], 1, "hardly known is known");
        assert!(Packed::new(&field, &[]).pixels.is_empty());
    }
}
