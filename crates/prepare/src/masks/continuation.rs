//! Colours of pixels from those of their surroundings.

use ffgs_core::ImageSize;

/// Sweeps of successive over-relaxation per pixel of the longest side of what is continued, and their factor.
const SWEEPS: usize = 2;
const MOST_SWEEPS: usize = 600;
const RELAXATION: f32 = 1.9;

/// Colours of the pixels `unknown` (ascending) for which the differences to their neighbours are, in the sense of least squares, `step(i, j)`: what
/// pixel `j` has more than `i`. The other pixels keep their colours (Perez et al. 2003).
pub(crate) fn continued(
    colours: &[[f32; 3]],
    size: ImageSize,
    unknown: &[usize],
    step: &dyn Fn(usize, usize) -> [f32; 3],
) -> Vec<[f32; 3]> {
    let mut all = colours.to_vec();
    let around: Vec<Surroundings> = unknown.iter().map(|&i| Surroundings::new(i, size, step)).collect();
    let sweeps = (SWEEPS * size.width.max(size.height)).min(MOST_SWEEPS);
    for _ in 0..if unknown.is_empty() { 0 } else { sweeps } {
        for (&i, around) in unknown.iter().zip(&around) {
            for c in 0..3 {
                let sum: f32 = around.neighbours().map(|j| all[j][c]).sum();
                let wanted = (sum - around.steps[c]) / around.count as f32;
                all[i][c] += RELAXATION * (wanted - all[i][c]);
            }
        }
    }
    unknown.iter().map(|&i| all[i]).collect()
}

/// The neighbours of a pixel, and the sum of the steps to them.
struct Surroundings {
    neighbours: [usize; 4],
    count: usize,
    steps: [f32; 3],
}

impl Surroundings {
    fn new(i: usize, size: ImageSize, step: &dyn Fn(usize, usize) -> [f32; 3]) -> Self {
        let (x, y) = (i % size.width, i / size.width);
        let mut found = Self { neighbours: [i; 4], count: 0, steps: [0.0; 3] };
        let beside = [
            (x > 0).then(|| i - 1),
            (x + 1 < size.width).then_some(i + 1),
            (y > 0).then(|| i - size.width),
            (y + 1 < size.height).then_some(i + size.width),
        ];
        for j in beside.into_iter().flatten() {
            found.neighbours[found.count] = j;
            found.count += 1;
            let step = step(i, j);
            (0..3).for_each(|c| found.steps[c] += step[c]);
        }
        found
    }

    fn neighbours(&self) -> impl Iterator<Item = usize> {
        self.neighbours[..self.count].iter().copied()
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
