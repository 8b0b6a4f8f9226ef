//! The cheapest outline: what each pixel says for itself, weighed against the length of the outline, which costs least
//! along the edges of the photograph (Boykov and Jolly 2001).
//!
//! The minimum cut is found as the convex problem that it is (Chan, Esedoglu and Nikolova 2006), by primal and dual steps
//! (Chambolle and Pock 2011).

use super::background::{Background, colour};
use ffgs_core::kernel::{Kernel, dispatch};
use ffgs_core::{ImageRgb8, ImageSize, Mask};

/// Steps; the start is near the end, so that few are enough.
const STEPS: usize = 80;
/// Length of a primal and of a dual step: their product times 8, the squared norm of the differences, is at most 1.
const STEP: f32 = 0.35;
/// What a pixel's length of outline costs where the photograph is even, in units of the pixels' own votes,
const OUTLINE: f32 = 2.0;
/// and the least that it costs across an edge.
const OUTLINE_AT_EDGES: f32 = 0.15;

/// Steps that follow each other down the rows, so that what they share stays in the cache.
const AT_ONCE: usize = 8;
const _: () = assert!(STEPS.is_multiple_of(AT_ONCE));

/// The mask of least cost. `votes` are positive for foreground; `start` is where the steps begin.
pub(crate) fn cheapest(votes: &[f32], image: &ImageRgb8, background: &Background, start: &Mask) -> Mask {
    let costs = Costs::new(image, background);
    let soft = dispatch(Descent::new(votes, &costs, start));
    Mask::new(start.size(), soft.iter().map(|&u| u8::from(u > 0.5)).collect()).expect("one value per pixel")
}

/// The convex problem, and how far it is solved.
struct Descent<'a> {
    votes: &'a [f32],
    costs: &'a Costs,
    size: ImageSize,
    /// Between 0 (background) and 1 for each pixel,
    soft: Vec<f32>,
    /// and ahead of that, whence the next dual step starts.
    ahead: Vec<f32>,
    /// Duals between a pixel and the one to its right; each row begins with the 0 that is left of its first pixel.
    right: Vec<f32>,
    /// Duals between a pixel and the one below it, after a row of zeros.
    below: Vec<f32>,
}

impl<'a> Descent<'a> {
    fn new(votes: &'a [f32], costs: &'a Costs, start: &Mask) -> Self {
        let size = start.size();
        let soft: Vec<f32> = start.data().iter().map(|&m| f32::from(m)).collect();
        let right = vec![0.0; (size.width + 1) * size.height];
        let below = vec![0.0; size.width * (size.height + 1)];
        Self { votes, costs, size, ahead: soft.clone(), soft, right, below }
    }

    /// A dual step of a row. Nothing lies to the right of the last column nor below the last row, and the duals there stay 0.
    #[inline(always)]
    fn climb(&mut self, y: usize) {
        let ImageSize { width, height } = self.size;
        let row = y * width..(y + 1) * width;
        let here = &self.ahead[row.clone()];
        let right = &mut self.right[y * (width + 1)..][1..width];
        climb(right, &here[1..], here, &self.costs.right[row.clone()]);
        if y + 1 < height {
            let below = &mut self.below[(y + 1) * width..][..width];
            climb(below, &self.ahead[(y + 1) * width..], here, &self.costs.below[row]);
        }
    }

    /// A primal step of a row.
    #[inline(always)]
    fn descend(&mut self, y: usize) {
        let width = self.size.width;
        let row = y * width..(y + 1) * width;
        let duals = &self.right[y * (width + 1)..][..=width];
        let (left, right) = (&duals[..width], &duals[1..]);
        let (above, below) = self.below[y * width..][..2 * width].split_at(width);
        let votes = &self.votes[row.clone()];
        let (soft, ahead) = (&mut self.soft[row.clone()], &mut self.ahead[row]);
        for x in 0..width {
            let divergence = right[x] - left[x] + below[x] - above[x];
            let next = (soft[x] + STEP * (divergence + votes[x])).clamp(0.0, 1.0);
            ahead[x] = 2.0 * next - soft[x];
            soft[x] = next;
        }
    }
}

/// A dual step between some pixels `here` and those `beside` them.
#[inline(always)]
fn climb(duals: &mut [f32], beside: &[f32], here: &[f32], most: &[f32]) {
    for (((dual, beside), here), most) in duals.iter_mut().zip(beside).zip(here).zip(most) {
        *dual = (*dual + STEP * (beside - here)).max(-most).min(*most);
    }
}

impl Kernel for Descent<'_> {
    type Output = Vec<f32>;

    /// Each step takes a row after the one before it has taken the next, which is all that it needs of it.
    #[inline(always)]
    fn run<const FMA: bool>(mut self) -> Vec<f32> {
        let height = self.size.height;
        for _ in 0..STEPS / AT_ONCE {
            for first in 0..height + AT_ONCE - 1 {
                let rows = (0..AT_ONCE).filter_map(|step| first.checked_sub(step));
                for y in rows.filter(|&y| y < height) {
                    self.climb(y);
                    self.descend(y);
                }
            }
        }
        self.soft
    }
}

/// What an outline costs.
struct Costs {
    /// Between a pixel and the one to its right,
    right: Vec<f32>,
    /// and the one below it.
    below: Vec<f32>,
}

impl Costs {
    fn new(image: &ImageRgb8, background: &Background) -> Self {
        let size = image.size();
        let gain = background.gain(image);
        let here = |i: usize| colour(image, gain, i);
        // An edge that the background has too is not that of a thing before it.
        let contrast = |i: usize, j: usize| {
            let (a, b) = (here(i), here(j));
            let (c, d) = (background.colour[i], background.colour[j]);
            let square = |f: &dyn Fn(usize) -> f32| (0..3).map(|k| f(k) * f(k)).sum::<f32>();
            square(&|k| a[k] - b[k]).min(square(&|k| (a[k] - b[k]) - (c[k] - d[k])))
        };
        let neighbours = |i: usize| {
            let (x, y) = (i % size.width, i / size.width);
            [(x + 1 < size.width).then_some(i + 1), (y + 1 < size.height).then_some(i + size.width)]
        };
        let contrasts: Vec<[f32; 2]> =
            (0..size.pixels()).map(|i| neighbours(i).map(|j| j.map_or(0.0, |j| contrast(i, j)))).collect();
        let mean = contrasts.iter().flatten().sum::<f32>() / (2 * contrasts.len()) as f32;
        let scale = 1.0 / (2.0 * mean).max(1.0);
        let cost = |c: f32| OUTLINE * (OUTLINE_AT_EDGES + (1.0 - OUTLINE_AT_EDGES) * (-c * scale).exp());
        let costs = |to: usize| contrasts.iter().map(|pair| cost(pair[to])).collect();
        Self { right: costs(0), below: costs(1) }
    }
}

/// A pixel's vote is so many times the logarithm of its score, and never more than this: a thing may look like its
/// background.
const VOTE: f32 = 1.5;
const MOST: f32 = 2.0;
/// What a pixel that other views deny or confirm says besides. They deny softly: what hides a thing from them is not known, nor is what
/// lies beyond the region that they look at together.
const DENIED: f32 = -0.7;
const CONFIRMED: f32 = 1.0;

/// What each pixel says for itself, by its score.
pub(crate) fn votes(scores: &[f32], size: ImageSize) -> Vec<f32> {
    let highest = around(scores, size);
    let vote = |i: usize| {
        // A pixel that the outline crosses differs half as much as the one beside it.
        let part = scores[i] / highest[i].max(1e-3);
        let score = if part < 0.5 { scores[i].min(2.0 * part) } else { scores[i] };
        (VOTE * score.max(1e-3).ln()).clamp(-MOST, MOST)
    };
    (0..scores.len()).map(vote).collect()
}

/// Adds what other views say, who find a pixel `possible` and have `confirmed` it, or have not.
pub(crate) fn add_other_views(votes: &mut [f32], possible: &Mask, confirmed: &Mask) {
    for (i, vote) in votes.iter_mut().enumerate() {
        *vote += match (possible.data()[i], confirmed.data()[i]) {
            (0, _) => DENIED,
            (_, 1) => CONFIRMED,
            _ => 0.0,
        };
    }
}

/// What is `always_covered` is foreground where other views find it possible.
pub(crate) fn cover(votes: &mut [f32], always_covered: &Mask, possible: &Mask) {
    for (i, vote) in votes.iter_mut().enumerate() {
        if always_covered.data()[i] == 1 && possible.data()[i] == 1 {
            *vote = vote.max(MOST);
        }
    }
}

/// The highest of the 3 x 3 values around each.
fn around(values: &[f32], ImageSize { width, height }: ImageSize) -> Vec<f32> {
    let highest = |i: usize| {
        let (x, y) = (i % width, i / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        rows.flat_map(|r| columns.clone().map(move |c| r * width + c)).map(|j| values[j]).fold(0.0, f32::max)
    };
    (0..values.len()).map(highest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize { width: 48, height: 40 };

    fn in_disc(i: usize, radius: f32) -> bool {
        let (x, y) = ((i % SIZE.width) as f32 - 23.5, (i / SIZE.width) as f32 - 19.5);
        x.hypot(y) < radius
    }

    /// A bright disc before a grey wall with a stripe; a quarter of the pixels err.
    #[test]
    fn the_outline_is_that_of_the_disc_though_pixels_err() {
        let wall = |i: usize| if i % SIZE.width < 10 { 60.0 } else { 110.0 };
        let background = Background {
            size: SIZE,
            colour: (0..SIZE.pixels()).map(|i| [wall(i); 3]).collect(),
            spread: vec![2.0; SIZE.pixels()],
            clipped: vec![[false; 3]; SIZE.pixels()],
        };
        let grey = |i: usize| if in_disc(i, 12.0) { 200 } else { wall(i) as u8 };
        let image = ImageRgb8::new(SIZE, (0..SIZE.pixels()).flat_map(|i| [grey(i); 3]).collect()).unwrap();
        let scores: Vec<f32> = (0..SIZE.pixels())
            .map(|i| {
                let errs = i.wrapping_mul(2_654_435_761) % 97 < 24;
                if in_disc(i, 12.0) ^ errs { 3.0 } else { 0.3 }
            })
            .collect();
        let votes = votes(&scores, SIZE);
        let start = Mask::new(SIZE, votes.iter().map(|v| u8::from(*v > 0.0)).collect()).unwrap();
        let wrong = |mask: &Mask| {
            (0..SIZE.pixels()).filter(|&i| mask.data()[i] != u8::from(in_disc(i, 12.0))).count()
        };
        let found = cheapest(&votes, &image, &background, &start);
        assert!(wrong(&start) > 400, "{} pixels err without an outline", wrong(&start));
        assert!(8 * wrong(&found) < wrong(&start), "{} of {} pixels err", wrong(&found), wrong(&start));
    }

    /// As many steps of the whole image, one after the other.
    fn in_whole_steps(votes: &[f32], costs: &Costs, start: &Mask) -> Vec<f32> {
        let mut state = Descent::new(votes, costs, start);
        for _ in 0..STEPS {
            (0..state.size.height).for_each(|y| state.climb(y));
            (0..state.size.height).for_each(|y| state.descend(y));
        }
        state.soft
    }

    #[test]
    fn steps_down_the_rows_are_those_of_the_whole_image() {
        for size in [(48, 40), (1, 5), (7, 1), (9, 3)].map(|(width, height)| ImageSize { width, height }) {
            let value =
                |i: usize, seed: usize| ((i + seed).wrapping_mul(2_654_435_761) >> 7 & 255) as f32 / 255.0;
            let all = |seed: usize| (0..size.pixels()).map(move |i| value(i, seed));
            let votes: Vec<f32> = all(1).map(|v| 4.0 * v - 2.0).collect();
            let costs = Costs { right: all(2).collect(), below: all(3).collect() };
            let start = Mask::new(size, all(4).map(|v| u8::from(v > 0.6)).collect()).unwrap();
            let found = dispatch(Descent::new(&votes, &costs, &start));
            assert_eq!(found, in_whole_steps(&votes, &costs, &start), "{size:?}");
            assert!(found.iter().any(|u| *u != 0.0), "{size:?}");
        }
    }

    #[test]
    fn other_views_deny_what_is_doubtful_and_not_what_is_clear() {
        let found = |score: f32| {
            let mut votes = votes(&[score; 3], ImageSize { width: 3, height: 1 });
            add_other_views(&mut votes, &mask(&[0, 1, 1]), &mask(&[0, 0, 1]));
            votes
        };
        let (doubtful, clear) = (found(1.3), found(5.0));
        assert!(doubtful[0] < 0.0 && doubtful[1] > 0.0 && clear[0] > 0.0, "{doubtful:?} {clear:?}");
        assert!(clear[0] < clear[1] && clear[1] < clear[2], "{clear:?}");
    }

    #[test]
    fn what_is_always_covered_is_foreground_unless_other_views_deny_it() {
        let mut votes = vec![-1.0; 4];
        cover(&mut votes, &mask(&[0, 1, 1, 0]), &mask(&[0, 0, 1, 1]));
        assert_eq!(votes, [-1.0, -1.0, MOST, -1.0]);
    }

    fn mask(values: &[u8]) -> Mask {
        Mask::new(ImageSize { width: values.len(), height: 1 }, values.to_vec()).unwrap()
    }
}
