//! The cheapest outline: what each pixel says for itself, weighed against the length of the outline, which costs least
//! along the edges of the photograph (Boykov and Jolly 2001).
//!
//! The minimum cut is found as the convex problem that it is (Chan, Esedoglu and Nikolova 2006), by primal and dual steps
//! (Chambolle and Pock 2011).

use super::background::{Background, colour};
use ffgs_core::{ImageRgb8, ImageSize, Mask};

/// Steps; the start is near the end, so that few are enough.
const STEPS: usize = 80;
/// Length of a primal and of a dual step: their product times 8, the squared norm of the differences, is at most 1.
const STEP: f32 = 0.35;
/// What a pixel's length of outline costs where the photograph is even, in units of the pixels' own votes,
const OUTLINE: f32 = 2.0;
/// and the least that it costs across an edge.
const OUTLINE_AT_EDGES: f32 = 0.15;

/// The mask of least cost. `votes` are positive for foreground; `start` is where the steps begin.
pub(crate) fn cheapest(votes: &[f32], image: &ImageRgb8, background: &Background, start: &Mask) -> Mask {
    let size = start.size();
    let costs = Costs::new(image, background);
    let mut soft: Vec<f32> = start.data().iter().map(|&m| f32::from(m)).collect();
    let mut ahead = soft.clone();
    let mut right = vec![0.0_f32; soft.len()];
    let mut below = right.clone();
    for _ in 0..STEPS {
        climb(&mut right, &mut below, &ahead, &costs, size.width);
        descend(&mut soft, &mut ahead, [&right, &below], votes, size.width);
    }
    Mask::new(size, soft.iter().map(|&u| u8::from(u > 0.5)).collect()).expect("one value per pixel")
}

/// A dual step. Nothing lies to the right of the last column nor below the last row, and the duals there stay 0.
fn climb(right: &mut [f32], below: &mut [f32], ahead: &[f32], costs: &Costs, width: usize) {
    let step = |dual: &mut [f32], beside: &[f32], here: &[f32], most: &[f32]| {
        for (((dual, beside), here), most) in dual.iter_mut().zip(beside).zip(here).zip(most) {
            *dual = (*dual + STEP * (beside - here)).max(-most).min(*most);
        }
    };
    let rows = right.chunks_exact_mut(width).zip(costs.right.chunks_exact(width));
    for ((dual, most), here) in rows.zip(ahead.chunks_exact(width)) {
        step(&mut dual[..width - 1], &here[1..], here, most);
    }
    step(below, &ahead[width..], ahead, &costs.below);
}

/// A primal step.
fn descend(soft: &mut [f32], ahead: &mut [f32], [right, below]: [&[f32]; 2], votes: &[f32], width: usize) {
    let zeros = vec![0.0; width];
    let mut above = &zeros[..];
    let mut left = zeros.clone();
    for (y, (soft, ahead)) in soft.chunks_exact_mut(width).zip(ahead.chunks_exact_mut(width)).enumerate() {
        let row = y * width..(y + 1) * width;
        let (right, below, votes) = (&right[row.clone()], &below[row.clone()], &votes[row]);
        left[1..].copy_from_slice(&right[..width - 1]);
        for x in 0..width {
            let divergence = right[x] - left[x] + below[x] - above[x];
            let next = (soft[x] + STEP * (divergence + votes[x])).clamp(0.0, 1.0);
            ahead[x] = 2.0 * next - soft[x];
            soft[x] = next;
        }
        above = below;
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

    fn mask(values: &[u8]) -> Mask {
        Mask::new(ImageSize { width: values.len(), height: 1 }, values.to_vec()).unwrap()
    }
}
