//! Colours of pixels from those of their surroundings.

use ffgs_core::{ImageSize, connected};
use rayon::prelude::*;

/// Sweeps of successive over-relaxation per pixel of the longest side of a hole, the fewest and the most of them, and their factor.
const SWEEPS: usize = 2;
const FEWEST_SWEEPS: usize = 100;
const MOST_SWEEPS: usize = 600;
const RELAXATION: f32 = 1.9;

/// Colours of the pixels `unknown` (ascending) for which the differences to their neighbours are, in the sense of least squares, `step(i, j)`: what
/// pixel `j` has more than `i`. The other pixels keep their colours (Perez et al. 2003).
pub(crate) fn continued(
    colours: &[[f32; 3]],
    size: ImageSize,
    unknown: &[usize],
    step: &(dyn Fn(usize, usize) -> [f32; 3] + Sync),
) -> Vec<[f32; 3]> {
    let mut all = colours.to_vec();
    let holes = holes(unknown, size);
    let found: Vec<Vec<[f32; 3]>> =
        holes.par_iter().map(|hole| Hole::new(hole, colours, size, step).solved(size)).collect();
    for (hole, found) in holes.iter().zip(found) {
        hole.iter().zip(found).for_each(|(&i, colour)| all[i] = colour);
    }
    unknown.iter().map(|&i| all[i]).collect()
}

/// The connected regions of some pixels, each ascending.
fn holes(pixels: &[usize], size: ImageSize) -> Vec<Vec<usize>> {
    let mut seen = vec![true; size.pixels()];
    pixels.iter().for_each(|&i| seen[i] = false);
    let mut out = Vec::new();
    for &start in pixels {
        if !seen[start] {
            let mut hole = connected(start, size.width, &mut seen, |_, _| true);
            hole.sort_unstable();
            out.push(hole);
        }
    }
    out
}

/// A connected region of unknown pixels, ascending.
struct Hole<'a> {
    pixels: &'a [usize],
    colours: Vec<[f32; 3]>,
    around: Vec<Surroundings>,
}

/// The neighbours of a pixel.
#[derive(Default)]
struct Surroundings {
    /// Places, in the hole, of those that are unknown.
    unknown: [u32; 4],
    unknown_count: usize,
    /// The sum of the colours of the others, less the steps to all.
    given: [f32; 3],
    /// All of them.
    count: f32,
}

impl<'a> Hole<'a> {
    fn new(
        pixels: &'a [usize],
        colours: &[[f32; 3]],
        size: ImageSize,
        step: &dyn Fn(usize, usize) -> [f32; 3],
    ) -> Self {
        let around = pixels.iter().map(|&i| Surroundings::new(i, pixels, colours, size, step)).collect();
        Self { pixels, colours: pixels.iter().map(|&i| colours[i]).collect(), around }
    }

    /// The colours, after as many sweeps as it takes from one side to the other.
    fn solved(mut self, size: ImageSize) -> Vec<[f32; 3]> {
        let extent = |at: fn(usize, usize) -> usize| {
            let places = || self.pixels.iter().map(|&i| at(i, size.width));
            places().max().unwrap_or(0) - places().min().unwrap_or(0) + 1
        };
        let longest = extent(|i, width| i % width).max(extent(|i, width| i / width));
        for _ in 0..(SWEEPS * longest).clamp(FEWEST_SWEEPS, MOST_SWEEPS) {
            for (at, around) in self.around.iter().enumerate() {
                for c in 0..3 {
                    let unknown = &around.unknown[..around.unknown_count];
                    let sum =
                        around.given[c] + unknown.iter().map(|&j| self.colours[j as usize][c]).sum::<f32>();
                    let old = self.colours[at][c];
                    self.colours[at][c] = old + RELAXATION * (sum / around.count - old);
                }
            }
        }
        self.colours
    }
}

impl Surroundings {
    fn new(
        i: usize,
        hole: &[usize],
        colours: &[[f32; 3]],
        size: ImageSize,
        step: &dyn Fn(usize, usize) -> [f32; 3],
    ) -> Self {
        let (x, y) = (i % size.width, i / size.width);
        let mut found = Self::default();
        let beside = [
            (x > 0).then(|| i - 1),
            (x + 1 < size.width).then_some(i + 1),
            (y > 0).then(|| i - size.width),
            (y + 1 < size.height).then_some(i + size.width),
        ];
        for j in beside.into_iter().flatten() {
            found.count += 1.0;
            let given = if let Ok(place) = hole.binary_search(&j) {
                found.unknown[found.unknown_count] = place as u32;
                found.unknown_count += 1;
                [0.0; 3]
            } else {
                colours[j]
            };
            let step = step(i, j);
            (0..3).for_each(|c| found.given[c] += given[c] - step[c]);
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gradient with a stripe; what a square hides is found again from the steps, and without them is smooth.
    #[test]
    fn what_is_hidden_is_continued_from_its_border() {
        let size = ImageSize { width: 40, height: 30 };
        let there = |i: usize| {
            let x = i % size.width;
            [4.0 * x as f32, if x == 20 { 90.0 } else { 30.0 }, 5.0]
        };
        let hidden = |i: usize| (12..28).contains(&(i % size.width)) && (8..22).contains(&(i / size.width));
        let unknown: Vec<usize> = (0..size.pixels()).filter(|&i| hidden(i)).collect();
        let given: Vec<[f32; 3]> =
            (0..size.pixels()).map(|i| if hidden(i) { [200.0; 3] } else { there(i) }).collect();
        let step = |i: usize, j: usize| std::array::from_fn(|c| there(j)[c] - there(i)[c]);
        let error = |found: &[[f32; 3]], c: usize| {
            unknown.iter().zip(found).map(|(&i, f)| (f[c] - there(i)[c]).abs()).fold(0.0, f32::max)
        };
        let exact = continued(&given, size, &unknown, &step);
        assert!((0..3).all(|c| error(&exact, c) < 0.1), "{:?}", [0, 1, 2].map(|c| error(&exact, c)));
        let smooth = continued(&given, size, &unknown, &|_, _| [0.0; 3]);
        assert!(error(&smooth, 0) < 0.1 && error(&smooth, 1) > 20.0, "{}", error(&smooth, 1));
    }
}
