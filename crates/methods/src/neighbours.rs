//! The nearest neighbours of each Gaussian, as edges.

use crate::nearest::nearest;
use anyhow::Result;

/// Nearest neighbours, with weights.
pub(crate) struct Neighbours {
    /// Neighbours of each.
    pub per_gaussian: usize,
    /// Edge `i * per_gaussian + k` leads from Gaussian i to its k-th neighbour.
    pub ends: Vec<u32>,
    /// Per edge.
    pub weights: Vec<f32>,
    /// d (m), per edge.
    pub lengths: Vec<f32>,
    /// Edges that end in each Gaussian, ascending.
    arriving: Vec<Vec<u32>>,
}

impl Neighbours {
    /// The `count` nearest of each of `means`; `weigh` gives the weights of the edges of one Gaussian by their lengths (m).
    ///
    /// # Errors
    /// When a position is not finite.
    pub(crate) fn new(means: &[[f32; 3]], count: usize, weigh: impl Fn(&[f32]) -> Vec<f32>) -> Result<Self> {
        let per_gaussian = count.min(means.len().saturating_sub(1));
        let edges = edges(means, per_gaussian)?;
        let ends: Vec<u32> = edges.iter().map(|edge| edge.1).collect();
        let mut arriving = vec![Vec::new(); means.len()];
        ends.iter().enumerate().for_each(|(edge, &end)| arriving[end as usize].push(edge as u32));
        let lengths: Vec<f32> = edges.iter().map(|edge| edge.0.sqrt() as f32).collect();
        let weights = lengths.chunks(per_gaussian.max(1)).flat_map(weigh).collect();
        Ok(Self { per_gaussian, ends, weights, lengths, arriving })
    }

    /// Edges that leave Gaussian `i`.
    pub(crate) fn leaving(&self, i: usize) -> std::ops::Range<usize> {
        i * self.per_gaussian..(i + 1) * self.per_gaussian
    }

    /// Edges that end in Gaussian `i`.
    pub(crate) fn arriving(&self, i: usize) -> impl Iterator<Item = usize> {
        self.arriving[i].iter().map(|&edge| edge as usize)
    }
}

/// Squared length and end of every edge.
fn edges(means: &[[f32; 3]], per_gaussian: usize) -> Result<Vec<(f64, u32)>> {
    let found = nearest(means, means, per_gaussian + 1)?.into_iter().enumerate();
    let others = found
        .flat_map(|(i, near)| near.into_iter().filter(move |edge| edge.1 != i as u32).take(per_gaussian));
    Ok(others.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_are_found_and_known_from_both_ends() {
        let halves = |lengths: &[f32]| lengths.iter().map(|length| length / 2.0).collect();
        let means = [0.0, 1.0, 3.0, 3.5].map(|x| [x, 0.0, 0.0]);
        let neighbours = Neighbours::new(&means, 2, halves).unwrap();
        assert_eq!(neighbours.ends, [1, 2, 0, 2, 3, 1, 2, 1]);
        assert_eq!(neighbours.lengths, [1.0, 3.0, 1.0, 2.0, 0.5, 2.0, 0.5, 2.5]);
        assert_eq!(neighbours.weights[3], 1.0);
        assert_eq!(neighbours.arriving(2).collect::<Vec<_>>(), [1, 3, 6]);
        assert_eq!(neighbours.leaving(3), 6..8);
        for few in [0, 1] {
            assert!(Neighbours::new(&means[..few], 2, halves).unwrap().ends.is_empty());
        }
    }
}
