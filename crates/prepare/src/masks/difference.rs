//! How much each pixel of a photograph differs from its background, with shadows discounted.

use super::background::{Background, colour, stride};
use super::regions;
use ffgs_core::{ImageRgb8, ImageSize, Mask};
use std::ops::RangeInclusive;

/// A difference scores 1 if it is as large as so many standard deviations of the background and the camera's levels: this share of what
/// differs most, but for a hundredth, among what stands still, within this range (docs/adr/0077-thresholds-of-masks-follow-what-stands-still.md).
const SHARE: f32 = 0.4;
const LEVELS: RangeInclusive<f32> = 4.0..=9.0;
const DEVIATIONS: f32 = 2.5;
/// Scores end here, so that in their means over 3 x 3 pixels an edge stays where it is: half of the pixels give 1.
const HIGHEST: f32 = 2.0;
/// Scores from which a pixel may be foreground, may be if other views say so, and surely is: all around it differs.
const WEAK: f32 = 1.0;
pub(crate) const WITH_OTHERS: f32 = 0.6;
const STRONG: f32 = 1.9;
/// A shadow leaves between these parts of the light,
const SHADOW: (f32, f32) = (0.35, 0.95);
/// and the colour as it was, to so many grey levels,
const SHADOW_COLOUR: f32 = 7.0;
/// and counts for so much.
const SHADOW_SCORE: f32 = 0.5;

/// The levels (0 to 255) of a camera, from pictures of it with the masks that were made before; the most of the range without masks.
pub(crate) fn levels(background: &Background, images: &[ImageRgb8], masks: &[Mask]) -> f32 {
    let mut still: Vec<f32> = Vec::new();
    for (image, mask) in images.iter().zip(masks) {
        let (gain, near) = (background.gain(image), regions::surroundings(mask));
        let pixels = near.data().len();
        let free = (0..pixels).step_by(stride(pixels)).filter(|&i| near.data()[i] == 0);
        still.extend(free.map(|i| background.difference(image, gain, i)));
    }
    if still.is_empty() {
        return *LEVELS.end();
    }
    let at = still.len() * 99 / 100;
    let (_, high, _) = still.select_nth_unstable_by(at, f32::total_cmp);
    (SHARE * *high).clamp(*LEVELS.start(), *LEVELS.end())
}

/// How much each pixel differs from the background.
pub(crate) fn raw(image: &ImageRgb8, background: &Background, levels: f32) -> Vec<f32> {
    let gain = background.gain(image);
    let score = |i: usize| {
        let score = background.difference(image, gain, i) / (levels + DEVIATIONS * background.spread[i]);
        if is_shadow(colour(image, gain, i), background.colour[i]) { score * SHADOW_SCORE } else { score }
    };
    (0..background.size.pixels()).map(score).collect()
}

/// Cut off above, where a pixel is `always_covered` the highest, and smoothed over 3 x 3 pixels.
pub(crate) fn scores(raw: &[f32], always_covered: &Mask) -> Vec<f32> {
    let score = |(raw, covered): (&f32, &u8)| if *covered == 1 { HIGHEST } else { raw.min(HIGHEST) };
    smoothed(&raw.iter().zip(always_covered.data()).map(score).collect::<Vec<_>>(), always_covered.size())
}

/// The background's colour with less light.
pub(crate) fn is_shadow(here: [f32; 3], there: [f32; 3]) -> bool {
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let light = dot(here, there) / dot(there, there).max(1.0);
    let residual = (0..3).map(|c| (here[c] - light * there[c]).abs()).fold(0.0, f32::max);
    light > SHADOW.0 && light < SHADOW.1 && residual < SHADOW_COLOUR
}

/// Weak pixels that hang together with strong ones.
pub(crate) fn foreground(scores: &[f32], size: ImageSize) -> Mask {
    let weak =
        Mask::new(size, scores.iter().map(|s| u8::from(*s > WEAK)).collect()).expect("one value per pixel");
    regions::touched_by(&weak, |i| scores[i] > STRONG)
}

fn smoothed(raw: &[f32], ImageSize { width, height }: ImageSize) -> Vec<f32> {
    let mean = |i: usize| {
        let (x, y) = (i % width, i / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let count = (rows.len() * columns.len()) as f32;
        rows.flat_map(|r| columns.clone().map(move |c| r * width + c)).map(|j| raw[j]).sum::<f32>() / count
    };
    (0..raw.len()).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of one colour.
    fn background(size: ImageSize, colour: [f32; 3]) -> Background {
        let pixels = size.pixels();
        Background {
            size,
            colour: vec![colour; pixels],
            spread: vec![1.5; pixels],
            clipped: vec![[false; 3]; pixels],
        }
    }

    #[test]
    fn shadows_score_less_than_things() {
        // The rest tells the exposure.
        let size = ImageSize { width: 5, height: 1 };
        let grass = [90, 140, 60];
        let background = background(size, grass.map(f32::from));
        let score = |pixel: [u8; 3]| {
            let image = ImageRgb8::new(size, [pixel, grass, grass, grass, grass].concat()).unwrap();
            raw(&image, &background, 10.0)[0]
        };
        assert!(score(grass.map(|v| (0.82 * f32::from(v)) as u8)) < WEAK);
        assert!(score([140, 90, 60]) > HIGHEST);
        assert!(score(grass.map(|v| v + 3)) < WEAK);
    }

    #[test]
    fn a_weak_difference_counts_where_little_else_differs() {
        // The rest tells the exposure.
        let size = ImageSize { width: 5, height: 1 };
        let background = background(size, [100.0; 3]);
        let pixels = [[100, 110, 100], [100; 3], [100; 3], [100; 3], [100; 3]];
        let image = ImageRgb8::new(size, pixels.concat()).unwrap();
        let score = |levels: f32| raw(&image, &background, levels)[0];
        assert!(score(4.0) > WEAK && score(9.0) < WEAK, "{} {}", score(4.0), score(9.0));
    }

    /// 24 x 20 pixels of grey with noise, and a bright block that a mask covers.
    #[test]
    fn levels_follow_what_stands_still() {
        let size = ImageSize { width: 24, height: 20 };
        let block = |i: usize| i % 24 < 4 && i / 24 < 4;
        let background = background(size, [100.0; 3]);
        let found = |noise: usize, mask: bool| {
            let grey =
                |i: usize| if block(i) { 250 } else { 100 + (i * 7 % (2 * noise + 1)) as u8 - noise as u8 };
            let image =
                ImageRgb8::new(size, (0..size.pixels()).flat_map(|i| [grey(i); 3]).collect()).unwrap();
            let masks = Mask::new(size, (0..size.pixels()).map(|i| u8::from(block(i))).collect()).unwrap();
            levels(&background, &[image], if mask { std::slice::from_ref(&masks) } else { &[] })
        };
        assert_eq!([found(1, true), found(60, true)], [4.0, 9.0]);
        assert!((found(16, true) - 6.4).abs() < 0.41, "{}", found(16, true));
        assert_eq!(found(1, false), 9.0, "not known");
        assert_eq!(levels(&background, &[], &[Mask::filled(size, true)]), 9.0, "nothing stands still");
    }
}
