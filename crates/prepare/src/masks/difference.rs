//! How much each pixel of a photograph differs from its background, with shadows discounted.

use super::background::Background;
use super::regions;
use ffgs_core::{ImageRgb8, ImageSize, Mask};

/// A difference of one is this many grey levels and this many standard deviations of the background.
const LEVELS: f32 = 9.0;
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

/// How much each pixel differs from the background.
pub(crate) fn raw(image: &ImageRgb8, background: &Background) -> Vec<f32> {
    let gain = background.gain(image);
    let score = |i: usize| {
        let here: [f32; 3] = std::array::from_fn(|c| f32::from(image.data()[i * 3 + c]) * gain[c]);
        score(here, background.colour[i], background.spread[i])
    };
    (0..background.size.pixels()).map(score).collect()
}

/// Cut off above and smoothed over 3 x 3 pixels.
pub(crate) fn scores(raw: &[f32], size: ImageSize) -> Vec<f32> {
    smoothed(&raw.iter().map(|r| r.min(HIGHEST)).collect::<Vec<_>>(), size)
}

fn score(here: [f32; 3], there: [f32; 3], spread: f32) -> f32 {
    let difference = (0..3).map(|c| (here[c] - there[c]).abs()).fold(0.0, f32::max);
    let score = difference / (LEVELS + DEVIATIONS * spread);
    if is_shadow(here, there) { score * SHADOW_SCORE } else { score }
}

/// The background's colour with less light.
fn is_shadow(here: [f32; 3], there: [f32; 3]) -> bool {
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let light = dot(here, there) / dot(there, there).max(1.0);
    let residual = (0..3).map(|c| (here[c] - light * there[c]).abs()).fold(0.0, f32::max);
    light > SHADOW.0 && light < SHADOW.1 && residual < SHADOW_COLOUR
}

/// Weak pixels that hang together with strong ones.
pub(crate) fn foreground(scores: &[f32], size: ImageSize) -> Mask {
    let weak =
        Mask::new(size, scores.iter().map(|s| u8::from(*s > WEAK)).collect()).expect("one value a pixel");
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

    #[test]
    fn shadows_score_less_than_things() {
        let grass = [90.0, 140.0, 60.0];
        assert!(score(grass.map(|v| 0.82 * v), grass, 2.0) < WEAK);
        assert!(score([140.0, 90.0, 60.0], grass, 2.0) > HIGHEST);
        assert!(score(grass.map(|v| v + 3.0), grass, 2.0) < WEAK);
    }
}
