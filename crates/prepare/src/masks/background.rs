//! What a fixed camera sees where nothing moves: a colour and its spread per pixel, from samples over time.

use super::continuation::continued;
use ffgs_core::{ImageRgb8, ImageSize, Mask, median};
use rayon::prelude::*;
use std::borrow::Borrow;

/// Colours (0 to 255) that differ by less in every channel show the same thing: noise and compression.
const SAME_COLOUR: f32 = 14.0;
/// Least standard deviation of a pixel (grey levels).
const LEAST_SPREAD: f32 = 1.5;
/// Below this share of a pixel's samples, those of one colour need not be the background: something may have covered it for longer.
const SURE: f32 = 0.6;
/// What a share of the samples is worth in grey levels away from what the surroundings tell of such a pixel.
const SHARE_LEVELS: f32 = 120.0;
/// A colour of at least this share, or one that is this near to what the surroundings tell (grey levels), is believed.
const LEAST_SHARE: f32 = 0.35;
const NEAR: f32 = 25.0;
/// Standard deviation (grey levels) of a background that no sample shows.
const UNSEEN_SPREAD: f32 = 4.0;
/// A channel of at least this value (0 to 255) is clipped: the scene may be brighter than it tells.
const CLIPPED: u8 = 250;
/// Pixels of a picture that tell its exposure, and what differs in it.
const ENOUGH_PIXELS: usize = 4000;

/// What a fixed camera sees where nothing moves.
#[derive(Clone, Debug)]
pub(crate) struct Background {
    pub size: ImageSize,
    /// Colour (0 to 255).
    pub colour: Vec<[f32; 3]>,
    /// Standard deviation of the samples (grey levels).
    pub spread: Vec<f32>,
    /// The channels that were clipped in samples of this colour.
    pub clipped: Vec<[bool; 3]>,
}

impl Background {
    /// The colour that most samples agree on at each pixel; samples inside `masks` (one each, or none at all) do not
    /// count as long as others are left. Exposure differences are taken out before.
    pub(crate) fn learn<I: Borrow<ImageRgb8>>(images: &[I], masks: &[Mask]) -> Self {
        let images: Vec<&ImageRgb8> = images.iter().map(Borrow::borrow).collect();
        let size = images[0].size();
        let gains: Vec<[f32; 3]> = {
            let reference = median_image(&images);
            images.iter().map(|image| gain(image, &reference)).collect()
        };
        let samples = Samples { images, masks, gains };
        let modes: Vec<Group> = (0..size.pixels()).into_par_iter().map(|i| mode(&samples.at(i))).collect();
        let mut colour: Vec<[f32; 3]> = modes.iter().map(|m| m.colour).collect();
        let mut spread: Vec<f32> = modes.iter().map(|m| m.spread).collect();
        let unsure = |i: usize| modes[i].share < SURE || samples.free(i).next().is_none();
        let unsure: Vec<usize> = (0..size.pixels()).filter(|&i| unsure(i)).collect();
        let step = |i: usize, j: usize| samples.step(i, j);
        let expected = continued(&colour, size, &unsure, &step);
        for (&i, expected) in unsure.iter().zip(expected) {
            let hidden = samples.free(i).next().is_none();
            (colour[i], spread[i]) = likeliest(&samples.at(i), hidden, expected);
        }
        let clipped = (0..size.pixels()).into_par_iter().map(|i| samples.clipped(i, &colour[i])).collect();
        Self { size, colour, spread, clipped }
    }

    /// Largest difference of a channel of pixel `i` of a picture, which has the background's exposure with `gain`. A channel that is
    /// clipped in one of them may differ less than it seems to, when that one is the darker.
    pub(crate) fn difference(&self, image: &ImageRgb8, gain: [f32; 3], i: usize) -> f32 {
        let (here, there) = (colour(image, gain, i), self.colour[i]);
        let clipped = |c: usize| {
            if here[c] < there[c] { image.data()[i * 3 + c] >= CLIPPED } else { self.clipped[i][c] }
        };
        (0..3).filter(|&c| !clipped(c)).map(|c| (here[c] - there[c]).abs()).fold(0.0, f32::max)
    }

    /// Factors by which an image is multiplied to have the background's exposure.
    pub(crate) fn gain(&self, image: &ImageRgb8) -> [f32; 3] {
        gain(image, &self.colour)
    }
}

/// Colour (0 to 255) of pixel `i` of a picture, with the background's exposure.
pub(super) fn colour(image: &ImageRgb8, gain: [f32; 3], i: usize) -> [f32; 3] {
    std::array::from_fn(|c| f32::from(image.data()[i * 3 + c]) * gain[c])
}

/// Largest difference of a channel.
fn farthest_channel(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max)
}

/// What a fixed camera saw at several times.
struct Samples<'a> {
    images: Vec<&'a ImageRgb8>,
    masks: &'a [Mask],
    gains: Vec<[f32; 3]>,
}

impl Samples<'_> {
    /// The samples of a pixel that no mask covers.
    fn free(&self, i: usize) -> impl Iterator<Item = usize> {
        (0..self.images.len()).filter(move |s| self.masks.get(*s).is_none_or(|m| m.data()[i] == 0))
    }

    fn colour(&self, s: usize, i: usize) -> [f32; 3] {
        colour(self.images[s], self.gains[s], i)
    }

    /// The colours of a pixel where it is free, else all of them.
    fn at(&self, i: usize) -> Vec<[f32; 3]> {
        let free: Vec<[f32; 3]> = self.free(i).map(|s| self.colour(s, i)).collect();
        if free.is_empty() { (0..self.images.len()).map(|s| self.colour(s, i)).collect() } else { free }
    }

    /// The channels of a pixel that are clipped in a sample of about this colour.
    fn clipped(&self, i: usize, colour: &[f32; 3]) -> [bool; 3] {
        let is = |s: usize, c: usize| self.images[s].data()[i * 3 + c] >= CLIPPED;
        std::array::from_fn(|c| (0..self.images.len()).any(|s| is(s, c) && same(&self.colour(s, i), colour)))
    }

    /// The median, per channel, of what pixel `j` has more than `i` in the samples that show both (Weiss 2001).
    fn step(&self, i: usize, j: usize) -> [f32; 3] {
        let both = self.free(i).filter(|&s| self.masks.get(s).is_none_or(|m| m.data()[j] == 0));
        let steps: Vec<[f32; 3]> = both
            .map(|s| {
                let (from, to) = (self.colour(s, i), self.colour(s, j));
                std::array::from_fn(|c| to[c] - from[c])
            })
            .collect();
        std::array::from_fn(|c| middle(steps.iter().map(|step| step[c])))
    }
}

/// The middle value; 0 of none.
pub(super) fn middle(values: impl Iterator<Item = f32>) -> f32 {
    median(values.map(f64::from)).unwrap_or(0.0) as f32
}

fn same(a: &[f32; 3], b: &[f32; 3]) -> bool {
    farthest_channel(a, b) <= SAME_COLOUR
}

/// Whether any two of them are the same, as those of most pixels are.
fn are_all_same(samples: &[[f32; 3]]) -> bool {
    let [low, high] = [f32::min, f32::max].map(|of: fn(f32, f32) -> f32| {
        samples.iter().copied().reduce(|a, b| std::array::from_fn(|c| of(a[c], b[c])))
    });
    low.zip(high).is_some_and(|(low, high)| same(&low, &high))
}

/// Samples of one colour.
struct Group {
    /// Their mean,
    colour: [f32; 3],
    /// standard deviation (grey levels),
    spread: f32,
    /// and share of all.
    share: f32,
}

impl Group {
    fn around(best: &[f32; 3], samples: &[[f32; 3]]) -> Self {
        let members: Vec<&[f32; 3]> = samples.iter().filter(|b| same(best, b)).collect();
        let n = members.len() as f32;
        let mean: [f32; 3] = std::array::from_fn(|c| members.iter().map(|m| m[c]).sum::<f32>() / n);
        let square = |m: &[f32; 3]| (0..3).map(|c| (m[c] - mean[c]) * (m[c] - mean[c])).fold(0.0, f32::max);
        let variance = members.iter().map(|m| square(m)).sum::<f32>() / n;
        Self { colour: mean, spread: variance.sqrt().max(LEAST_SPREAD), share: n / samples.len() as f32 }
    }
}

/// The largest group of samples of one colour; among equals the one that scatters least.
fn mode(samples: &[[f32; 3]]) -> Group {
    if are_all_same(samples) {
        return Group::around(&samples[0], samples);
    }
    let group = |a: &[f32; 3]| {
        let distance = |b: &[f32; 3]| a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f32>();
        let members = samples.iter().filter(|b| same(a, b));
        members.fold((0, 0.0), |(count, scatter), b| (count + 1, scatter + distance(b)))
    };
    let groups = samples.iter().map(|a| (group(a), a));
    let better =
        |(a, _): &((usize, f32), _), (b, _): &((usize, f32), _)| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1));
    Group::around(groups.max_by(better).expect("there are samples").1, samples)
}

/// Colour and spread by how many samples agree and by what the surroundings tell; where masks hid the pixel in all samples, by the latter first.
fn likeliest(samples: &[[f32; 3]], hidden: bool, expected: [f32; 3]) -> ([f32; 3], f32) {
    let groups = samples.iter().map(|best| Group::around(best, samples));
    let far = |g: &Group| farthest_channel(&g.colour, &expected);
    let worth = |g: &Group| SHARE_LEVELS * g.share - far(g);
    let best = groups.max_by(|a, b| worth(a).total_cmp(&worth(b))).expect("there are samples");
    if !hidden && best.share > LEAST_SHARE || far(&best) < NEAR {
        (best.colour, best.spread)
    } else {
        (expected, UNSEEN_SPREAD)
    }
}

/// Every so many pixels of so many are enough to tell a share or a median of them.
pub(super) fn stride(pixels: usize) -> usize {
    (pixels / ENOUGH_PIXELS).max(1)
}

/// Per pixel and channel the median of the images, at the pixels that serve for the exposure.
fn median_image(images: &[&ImageRgb8]) -> Vec<[f32; 3]> {
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

    fn picture_of(grey: impl Fn(usize) -> u8) -> ImageRgb8 {
        ImageRgb8::new(SIZE, (0..SIZE.pixels()).flat_map(|i| [grey(i); 3]).collect()).unwrap()
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

    /// A patterned thing, 14 columns long, moves by a column per frame: some columns are hidden in all ten frames, others in most.
    #[test]
    fn what_covers_a_pixel_for_most_of_the_time_is_not_its_background() {
        let gradient = |i: usize| 60.0 + 3.0 * (i % 32) as f32;
        let thing = |i: usize, t: usize| (4 + t..18 + t).contains(&(i % 32)).then(|| i % 32 - t - 4);
        let pattern = |column: usize| [250, 10, 190, 40, 220, 160, 5][column / 2];
        let images: Vec<ImageRgb8> =
            (0..10).map(|t| picture(|i| thing(i, t).map_or(gradient(i) as u8, pattern))).collect();
        let background = Background::learn(&images, &[]);
        let error = |i: usize| (background.colour[i][0] - gradient(i)).abs();
        let worst = (0..SIZE.pixels()).map(error).fold(0.0, f32::max);
        assert!(worst < 25.0, "{worst}");
    }

    /// A white wall is clipped in pictures of an exposure that rises by a third, and a lamp is brighter than any of them shows.
    #[test]
    fn what_is_clipped_does_not_differ() {
        let light = |i: usize| if i % 32 < 8 { 280.0 } else { 40.0 + 5.0 * (i % 32) as f32 };
        let shown = |exposure: f32| picture_of(|i| (light(i) * exposure).min(255.0) as u8);
        let images: Vec<ImageRgb8> = [0.75, 0.8, 0.85, 0.9, 0.95, 1.0].map(shown).into();
        let background = Background::learn(&images, &[]);
        let worst = |image: &ImageRgb8| {
            let gain = background.gain(image);
            (0..SIZE.pixels()).map(|i| background.difference(image, gain, i)).fold(0.0, f32::max)
        };
        assert!(
            images.iter().all(|image| worst(image) < 14.0),
            "{:?}",
            images.iter().map(worst).collect::<Vec<_>>()
        );
        let dark = picture_of(|i| if i == 3 { 150 } else { (light(i) * 0.9).min(255.0) as u8 });
        assert!(worst(&dark) > 60.0, "something dark before the wall: {}", worst(&dark));
    }

    /// One picture of ten is twice as bright: what is brighter than a grey wall still differs from it.
    #[test]
    fn a_flash_hides_nothing_bright() {
        let wall = |i: usize| 60.0 + 3.0 * (i % 32) as f32;
        let shown = |exposure: f32| picture_of(|i| (wall(i) * exposure).min(255.0) as u8);
        let mut images = vec![shown(1.0); 9];
        images.push(shown(2.0));
        let background = Background::learn(&images, &[]);
        let shirt = picture_of(|i| if i == 31 { 230 } else { wall(i) as u8 });
        let difference = background.difference(&shirt, background.gain(&shirt), 31);
        assert!(difference > 50.0, "{difference}");
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

    /// A pixel that masks hide in all samples shows what its surroundings continue, not the thing that stood there.
    #[test]
    fn what_was_always_hidden_is_continued() {
        let hidden = |i: usize| (10..16).contains(&(i % 32));
        let images: Vec<ImageRgb8> = (0..5).map(|_| picture(|i| if hidden(i) { 200 } else { 90 })).collect();
        let mask = Mask::new(SIZE, (0..SIZE.pixels()).map(|i| u8::from(hidden(i))).collect()).unwrap();
        let background = Background::learn(&images, &vec![mask; 5]);
        let worst = background.colour.iter().map(|c| (c[0] - 90.0).abs()).fold(0.0, f32::max);
        assert!(worst < 1.0, "{worst}");
    }
}
