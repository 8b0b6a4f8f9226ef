//! Palettes: of numbers by Lloyd's algorithm (1982), of vectors by splitting boxes (Heckbert's median cut, 1982).

/// Rounds of Lloyd's algorithm; the distortion hardly changes after a few.
const ROUNDS: usize = 8;

/// Up to `size` representatives of `values`, ascending; a single 0 of none.
pub(crate) fn codebook(values: impl Iterator<Item = f32>, size: usize) -> Vec<f32> {
    let mut sorted: Vec<f32> = values.collect();
    if sorted.is_empty() {
        return vec![0.0];
    }
    sorted.sort_unstable_by(f32::total_cmp);
    let mut sums = vec![0.0_f64];
    sorted.iter().for_each(|&v| sums.push(sums[sums.len() - 1] + f64::from(v)));
    // Half of the start follows the density, half covers the range, so that rare extremes have a representative too.
    let (low, high) = (sorted[0], sorted[sorted.len() - 1]);
    let spread = (0..size / 2).map(|i| low + (high - low) * i as f32 / (size / 2 - 1).max(1) as f32);
    let dense = (0..size - size / 2).map(|i| sorted[(2 * i + 1) * sorted.len() / (2 * (size - size / 2))]);
    let mut centres: Vec<f32> = spread.chain(dense).collect();
    centres.sort_unstable_by(f32::total_cmp);
    centres.dedup();
    for _ in 0..ROUNDS {
        let ends: Vec<usize> =
            centres.windows(2).map(|c| sorted.partition_point(|&v| v < f32::midpoint(c[0], c[1]))).collect();
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let stops = ends.iter().copied().chain([sorted.len()]);
        for ((start, stop), centre) in starts.zip(stops).zip(&mut centres) {
            if stop > start {
                *centre = ((sums[stop] - sums[start]) / (stop - start) as f64) as f32;
            }
        }
    }
    centres
}

/// Index of the entry of an ascending codebook that is nearest to `value`.
pub(crate) fn nearest(codebook: &[f32], value: f32) -> usize {
    let above = codebook.partition_point(|&c| c < value).min(codebook.len() - 1);
    let below = above.saturating_sub(1);
    if (value - codebook[below]).abs() <= (codebook[above] - value).abs() { below } else { above }
}

/// Vectors grouped into at most `size` cells, and the mean of each cell.
pub(crate) struct Palette {
    /// Mean of each cell.
    pub centroids: Vec<Vec<f32>>,
    /// Cell of each vector.
    pub labels: Vec<usize>,
}

/// Splits the cell with the largest squared error along its widest axis at the mean, until there are `size` or none can be split.
pub(crate) fn palette(vectors: &[Vec<f32>], size: usize) -> Palette {
    let mut order: Vec<usize> = (0..vectors.len()).collect();
    let mut cells = std::collections::BinaryHeap::from([Cell::new(vectors, &order, 0..vectors.len())]);
    let mut done = Vec::new();
    while let Some(cell) = cells.pop() {
        if cells.len() + done.len() + 1 >= size || !(cell.error > 0.0) {
            done.push(cell);
            continue;
        }
        let part = &mut order[cell.rows.clone()];
        part.sort_by_key(|&i| vectors[i][cell.axis] > cell.mean[cell.axis]);
        let below = part.iter().filter(|&&i| vectors[i][cell.axis] <= cell.mean[cell.axis]).count();
        let middle = cell.rows.start + below;
        if below == 0 || middle == cell.rows.end {
            done.push(cell);
            continue;
        }
        cells.push(Cell::new(vectors, &order, cell.rows.start..middle));
        cells.push(Cell::new(vectors, &order, middle..cell.rows.end));
    }
    let mut labels = vec![0; vectors.len()];
    for (label, cell) in done.iter().enumerate() {
        order[cell.rows.clone()].iter().for_each(|&i| labels[i] = label);
    }
    Palette { centroids: done.into_iter().map(|cell| cell.mean).collect(), labels }
}

/// Rows of the order that share a representative.
struct Cell {
    error: f64,
    axis: usize,
    mean: Vec<f32>,
    rows: std::ops::Range<usize>,
}

impl Cell {
    fn new(vectors: &[Vec<f32>], order: &[usize], rows: std::ops::Range<usize>) -> Self {
        let width = vectors.first().map_or(0, Vec::len);
        let (mut sums, mut squares) = (vec![0.0_f64; width], vec![0.0_f64; width]);
        for &i in &order[rows.clone()] {
            for (axis, &v) in vectors[i].iter().enumerate() {
                sums[axis] += f64::from(v);
                squares[axis] += f64::from(v) * f64::from(v);
            }
        }
        let n = rows.len().max(1) as f64;
        let spread = |axis: usize| (squares[axis] - sums[axis] * sums[axis] / n).max(0.0);
        let axis = (0..width).max_by(|&a, &b| spread(a).total_cmp(&spread(b))).unwrap_or(0);
        let error = if rows.len() > 1 { (0..width).map(spread).sum() } else { 0.0 };
        Self { error, axis, mean: sums.iter().map(|s| (s / n) as f32).collect(), rows }
    }
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Cell {}

impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Cell {
    /// The largest error first; equal ones by place, so that the result does not depend on the heap.
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.error.total_cmp(&other.error).then(other.rows.start.cmp(&self.rows.start))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_values_are_kept_exactly() {
        let values = [3.0, -1.0, 3.0, 0.5, -1.0];
        let book = codebook(values.into_iter(), 256);
        for v in values {
            assert_eq!(book[nearest(&book, v)], v, "{book:?}");
        }
        assert_eq!(codebook(std::iter::empty(), 256), [0.0]);
    }

    #[test]
    fn a_codebook_beats_a_uniform_one_on_a_peaked_density() {
        let values: Vec<f32> = (0..20_000).map(|i| ((i as f32 + 0.5) / 10_000.0 - 1.0).powi(5)).collect();
        let error = |book: &[f32]| -> f64 {
            values.iter().map(|&v| f64::from(v - book[nearest(book, v)]).powi(2)).sum()
        };
        let uniform: Vec<f32> = (0..256).map(|i| i as f32 / 127.5 - 1.0).collect();
        let (found, uniform) = (error(&codebook(values.iter().copied(), 256)), error(&uniform));
        assert!(found < 0.6 * uniform, "{found} {uniform}");
    }

    #[test]
    fn separate_clusters_get_a_cell_each() {
        let vectors: Vec<Vec<f32>> =
            (0..90).map(|i| vec![(i % 3) as f32 * 10.0, (i % 3) as f32, (i / 3) as f32 * 1e-3]).collect();
        let palette = palette(&vectors, 3);
        assert_eq!(palette.centroids.len(), 3);
        for (i, v) in vectors.iter().enumerate() {
            assert!((palette.centroids[palette.labels[i]][0] - v[0]).abs() < 1e-3);
        }
        assert_eq!(super::palette(&[], 8).labels.len(), 0);
    }
}
