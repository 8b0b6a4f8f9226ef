//! A hierarchy of compact cells over a cloud of points.

use glam::DVec3;
use std::ops::Range;

/// Points ordered so that every node of a balanced tree of spatial halves is a contiguous range.
#[derive(Clone, Debug, Default)]
pub struct Cells {
    /// Point indices in tree order.
    pub order: Vec<usize>,
    /// Leaves, as ranges of `order`, in order.
    pub leaves: Vec<Range<usize>>,
    /// All nodes of the tree, parents before children; leaves included.
    pub nodes: Vec<Range<usize>>,
}

impl Cells {
    /// Halves the cloud along its longest extent, at a gap if there is one, until no leaf holds more than `size` points.
    pub fn new(points: &[DVec3], size: usize) -> Self {
        let mut cells = Self { order: (0..points.len()).collect(), leaves: Vec::new(), nodes: Vec::new() };
        if !points.is_empty() {
            cells.nodes = split(points, &mut cells.order, 0, size.max(1));
            cells.leaves = cells.nodes.iter().filter(|n| n.len() <= size.max(1)).cloned().collect();
        }
        cells
    }

    /// Members of a range.
    pub fn members(&self, range: &Range<usize>) -> &[usize] {
        &self.order[range.clone()]
    }
}

/// From this many points on, halves are worth two threads.
const PARALLEL: usize = 4096;

/// Orders `members`, at least one, which begin at `start`, and lists their nodes.
fn split(points: &[DVec3], members: &mut [usize], start: usize, size: usize) -> Vec<Range<usize>> {
    let mut nodes: Vec<Range<usize>> = std::iter::once(start..start + members.len()).collect();
    if members.len() <= size {
        return nodes;
    }
    let half = halve(points, members);
    let (low, high) = members.split_at_mut(half);
    let parallel = low.len() + high.len() >= PARALLEL;
    let mut low = || split(points, low, start, size);
    let mut high = || split(points, high, start + half, size);
    let (low, high) = if parallel { rayon::join(low, high) } else { (low(), high()) };
    nodes.extend(low);
    nodes.extend(high);
    nodes
}

/// Orders two points or more by the half they are in; the number in the lower one.
fn halve(points: &[DVec3], members: &mut [usize]) -> usize {
    let (low, high) = bounds(members.iter().map(|&i| points[i]));
    let extent = high - low;
    let axis =
        if extent.x >= extent.y && extent.x >= extent.z { 0 } else { usize::from(extent.z > extent.y) + 1 };
    let by_axis = |a: &usize, b: &usize| points[*a][axis].total_cmp(&points[*b][axis]).then(a.cmp(b));
    let below = |limit: f64| members.iter().filter(|&&i| points[i][axis] < limit).count();
    let half = gap(members.iter().map(|&i| points[i][axis]), low[axis], high[axis]).map(below);
    let half = half.filter(|h| (1..members.len()).contains(h)).unwrap_or(members.len() / 2);
    members.select_nth_unstable_by(half, by_axis);
    half
}

/// Bins that an extent is cut into to look for a gap.
const BINS: usize = 64;
/// A gap is at least this many bins wide.
const GAP_BINS: usize = 5;
/// A bin with less than this share of the mean count is empty: a few strays do not bridge a gap.
const EMPTY: f64 = 0.05;

/// The middle of the widest gap between `low` and `high`, if there is one: separate objects go to separate nodes.
fn gap(values: impl Iterator<Item = f64>, low: f64, high: f64) -> Option<f64> {
    let width = (high - low) / BINS as f64;
    let mut counts = [0_usize; BINS];
    values.for_each(|v| counts[(((v - low) / width) as usize).min(BINS - 1)] += 1);
    let few = EMPTY * counts.iter().sum::<usize>() as f64 / BINS as f64;
    let (mut best, mut start) = (0..0, 0);
    for bin in 0..BINS {
        if counts[bin] as f64 > few {
            start = bin + 1;
        } else if bin + 1 - start > best.len() {
            best = start..bin + 1;
        }
    }
    let inner = best.len() >= GAP_BINS && best.start > 0 && best.end < BINS;
    inner.then(|| low + width * 0.5 * (best.start + best.end) as f64)
}

/// Smallest and largest coordinates.
pub(crate) fn bounds(points: impl Iterator<Item = DVec3>) -> (DVec3, DVec3) {
    points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_partition_the_points_and_are_compact() {
        let points: Vec<DVec3> =
            (0..1000).map(|i| DVec3::new(f64::from(i * 7919 % 1000), f64::from(i % 10), 0.0)).collect();
        let cells = Cells::new(&points, 64);
        let mut all = cells.order.clone();
        all.sort_unstable();
        assert!(all.iter().copied().eq(0..1000));
        assert_eq!(cells.leaves.iter().map(ExactSizeIterator::len).sum::<usize>(), 1000);
        for leaf in &cells.leaves {
            let (low, high) = bounds(cells.members(leaf).iter().map(|&i| points[i]));
            assert!(leaf.len() <= 64 && high.x - low.x < 65.0);
        }
        assert!(Cells::new(&[], 8).nodes.is_empty());
    }
}
