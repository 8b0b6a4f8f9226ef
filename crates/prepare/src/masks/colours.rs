//! What the colour of a pixel says: colours that the masks of a camera hold are rarer around them, and the other way round
//! (Rother, Kolmogorov and Blake 2004).
//!
//! A background that was learnt wrongly, where something stood for most of the time, denies that thing and calls the free ground
//! foreground; the colours of the rest of the thing and of the ground beside it put both right
//! (docs/adr/0082-backgrounds-with-the-colours-of-masks.md).

use super::background::{Background, colour};
use super::regions;
use ffgs_core::{ImageRgb8, Mask};

/// Bins of a histogram along each channel.
const BINS: usize = 16;
/// Share of an even histogram that is mixed into each, so that colours that were hardly seen say little.
const EVEN: f32 = 0.8;
/// A colour's vote is so many times the logarithm of how much more frequent it is in the masks, and never more than this.
const VOTE: f32 = 0.7;
const MOST: f32 = 0.7;
/// A background is that of a thing, which stood there for most of the time, with this probability where the masks hold its colour as often as
/// their surroundings do; the odds grow with this power of how much more often they hold it.
const WRONG: f32 = 0.1;
const WRONG_POWER: f32 = 3.0;
/// Where it is, the logarithm of how much more frequent the pixel's colour is in the masks counts, and never more than this.
const MOST_ALONE: f32 = 1.5;
/// Fewer pixels have no histogram.
const LEAST_PIXELS: usize = 20;

/// The logarithm of how much more frequent each colour is in the masks of a camera than around them.
pub(crate) struct Colours(Vec<f32>);

impl Colours {
    /// From pictures of one camera and the masks of the first ones of them; `None` where there is too little of either.
    pub(crate) fn learn(background: &Background, images: &[ImageRgb8], masks: &[Mask]) -> Option<Self> {
        let (mut inside, mut around) = (Histogram::new(), Histogram::new());
        for (image, mask) in images.iter().zip(masks) {
            let gain = background.gain(image);
            let (seam, near) = (mask.dilated(regions::radius(mask.size())), regions::surroundings(mask));
            for i in 0..mask.data().len() {
                match (mask.data()[i], seam.data()[i], near.data()[i]) {
                    (1, _, _) => inside.add(colour(image, gain, i)),
                    (_, 0, 1) => around.add(colour(image, gain, i)),
                    _ => {}
                }
            }
        }
        let (inside, around) = (inside.shares()?, around.shares()?);
        Some(Self(inside.iter().zip(&around).map(|(f, b)| (f / b).ln()).collect()))
    }

    /// Weighs the votes of the pixels near the mask, which are by their difference from the background, with what colours say. `changed` is where something
    /// else than the background was ever seen.
    pub(crate) fn weigh(
        &self,
        votes: &mut [f32],
        image: &ImageRgb8,
        background: &Background,
        changed: &Mask,
        mask: &Mask,
    ) {
        let (gain, near) = (background.gain(image), regions::surroundings(mask));
        for i in (0..votes.len()).filter(|&i| near.data()[i] == 1) {
            let there = (changed.data()[i] == 1).then_some(background.colour[i]);
            votes[i] = self.vote(votes[i], colour(image, gain, i), there);
        }
    }

    /// The log odds of foreground of a pixel with colour `here`, whose difference from the background says `own`. The more often the masks hold the
    /// background's colour `there`, the more likely is it that of a thing: then the difference says nothing, and the pixel's colour counts alone. There is none
    /// where nothing else was ever seen: the background is right.
    fn vote(&self, own: f32, here: [f32; 3], there: Option<[f32; 3]>) -> f32 {
        let here = self.0[bin(here)];
        let odds =
            there.map_or(0.0, |there| WRONG / (1.0 - WRONG) * (WRONG_POWER * self.0[bin(there)]).exp());
        let wrong = odds / (1.0 + odds);
        let with_colour = own + (VOTE * here).clamp(-MOST, MOST);
        let alone = here.clamp(-MOST_ALONE, MOST_ALONE);
        -((1.0 - wrong) * (-with_colour).exp() + wrong * (-alone).exp()).ln()
    }
}

fn bin(colour: [f32; 3]) -> usize {
    let [r, g, b] = colour.map(|v| (v as usize * BINS / 256).min(BINS - 1));
    (r * BINS + g) * BINS + b
}

struct Histogram {
    counts: Vec<f32>,
    pixels: usize,
}

impl Histogram {
    fn new() -> Self {
        Self { counts: vec![0.0; BINS * BINS * BINS], pixels: 0 }
    }

    fn add(&mut self, colour: [f32; 3]) {
        self.counts[bin(colour)] += 1.0;
        self.pixels += 1;
    }

    /// The share of each bin, of which a quarter goes to each of its neighbours along each channel; `None` of too few pixels.
    fn shares(&self) -> Option<Vec<f32>> {
        let smooth = [1, BINS, BINS * BINS].iter().fold(self.counts.clone(), |counts, &stride| {
            let beside = |at: usize, step: isize| {
                let place = (at / stride % BINS) as isize + step;
                if (0..BINS as isize).contains(&place) {
                    at.wrapping_add_signed(step * stride as isize)
                } else {
                    at
                }
            };
            let mean = |at: usize| 0.5 * counts[at] + 0.25 * (counts[beside(at, -1)] + counts[beside(at, 1)]);
            (0..counts.len()).map(mean).collect()
        });
        let even = EVEN / smooth.len() as f32;
        let share = |count: &f32| count / self.pixels as f32 + even;
        (self.pixels >= LEAST_PIXELS).then(|| smooth.iter().map(share).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    const SIZE: ImageSize = ImageSize { width: 80, height: 40 };
    const ROAD: [u8; 3] = [90, 92, 95];
    const CAR: [u8; 3] = [200, 30, 30];
    const TYRE: [u8; 3] = [15, 15, 18];

    /// A car of two colours on a road; its lower rows are tyres.
    fn picture() -> ImageRgb8 {
        let colour = |i: usize| match (i % SIZE.width, i / SIZE.width) {
            (30..50, 10..20) => CAR,
            (30..50, 20..24) => TYRE,
            _ => ROAD,
        };
        ImageRgb8::new(SIZE, (0..SIZE.pixels()).flat_map(colour).collect()).unwrap()
    }

    fn mask(inside: impl Fn(usize, usize) -> bool) -> Mask {
        let data = (0..SIZE.pixels()).map(|i| u8::from(inside(i % SIZE.width, i / SIZE.width)));
        Mask::new(SIZE, data.collect()).unwrap()
    }

    fn background() -> Background {
        let colour = vec![ROAD.map(f32::from); SIZE.pixels()];
        Background {
            size: SIZE,
            colour,
            spread: vec![2.0; SIZE.pixels()],
            clipped: vec![[false; 3]; SIZE.pixels()],
        }
    }

    fn votes(mask: &Mask) -> Vec<f32> {
        let (background, image) = (background(), picture());
        let colours = Colours::learn(&background, std::slice::from_ref(&image), std::slice::from_ref(mask));
        let mut votes = vec![0.0; SIZE.pixels()];
        colours.unwrap().weigh(&mut votes, &image, &background, &Mask::filled(SIZE, true), mask);
        votes
    }

    /// The mask has a strip of road behind the car and lacks half of its tyres, as behind a background with the car's ghost.
    #[test]
    fn colours_deny_ground_that_a_mask_holds_and_confirm_what_it_lacks() {
        let ghost = |x: usize, y: usize| (26..30).contains(&x) && (14..24).contains(&y);
        let missed = |x: usize, y: usize| (40..50).contains(&x) && (20..24).contains(&y);
        let car = |x: usize, y: usize| (30..50).contains(&x) && (10..24).contains(&y);
        let votes = votes(&mask(|x, y| ghost(x, y) || car(x, y) && !missed(x, y)));
        for (i, vote) in votes.iter().enumerate() {
            let (x, y) = (i % SIZE.width, i / SIZE.width);
            assert!(!ghost(x, y) || *vote < -0.5, "ground at {x}, {y}: {vote}");
            assert!(!car(x, y) || *vote > 0.2, "car at {x}, {y}: {vote}");
        }
        assert_eq!(votes[0], 0.0, "far from the mask");
    }

    /// The background holds the left half of the car, which stood there for most of the time; now it stands more to the right.
    #[test]
    fn a_background_with_the_colours_of_the_masks_decides_nothing() {
        let car = |x: usize, y: usize| (30..50).contains(&x) && (10..24).contains(&y);
        let (image, mask) = (picture(), mask(car));
        let wrong = |x: usize, y: usize| (24..40).contains(&x) && (10..20).contains(&y);
        let there = |i: usize| if wrong(i % SIZE.width, i / SIZE.width) { CAR } else { ROAD };
        let wrong_there = Background {
            size: SIZE,
            colour: (0..SIZE.pixels()).map(|i| there(i).map(f32::from)).collect(),
            ..background()
        };
        let (ghost, hole, body, road) = (14 * 80 + 26, 14 * 80 + 35, 14 * 80 + 45, 14 * 80 + 53);
        let by_difference = |i: usize| if i == ghost || i == body { 2.0 } else { -2.0 };
        let weighed = |background: &Background, changed: bool| {
            let colours =
                Colours::learn(background, std::slice::from_ref(&image), std::slice::from_ref(&mask))
                    .unwrap();
            let mut votes: Vec<f32> = (0..SIZE.pixels()).map(by_difference).collect();
            colours.weigh(&mut votes, &image, background, &Mask::filled(SIZE, changed), &mask);
            [ghost, hole, body, road].map(|i| votes[i])
        };
        let [ghost, hole, body, road] = weighed(&wrong_there, true);
        assert!(ghost < -0.5 && hole > 0.5 && body > 2.0 && road < -2.0, "{ghost} {hole} {body} {road}");
        let [ghost, hole, ..] = weighed(&wrong_there, false);
        assert!(ghost > 1.0 && hole < -1.0, "nothing else was ever seen there: {ghost} {hole}");
        let [_, hole, body, road] = weighed(&background(), true);
        assert!(hole < -0.5 && body > 2.0 && road < -2.0, "right: {hole} {body} {road}");
    }

    #[test]
    fn without_a_mask_there_is_nothing_to_learn() {
        let images = [picture()];
        assert!(Colours::learn(&background(), &images, &[]).is_none());
        assert!(Colours::learn(&background(), &images, &[mask(|_, _| false)]).is_none());
        assert!(Colours::learn(&background(), &images, &[mask(|_, _| true)]).is_none());
    }
}
