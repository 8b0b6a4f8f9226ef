//! Nearest neighbours in space.

use anyhow::{Result, anyhow};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// The `count` nearest of `among` to each of `places` (fewer where there are not so many): squared distance (m^2) and index, in
/// this order.
///
/// # Errors
/// When a position is not finite.
pub(crate) fn nearest(places: &[[f32; 3]], among: &[[f32; 3]], count: usize) -> Result<Vec<Vec<(f64, u32)>>> {
    let Some(count) = NonZero::new(count.min(among.len())) else { return Ok(vec![Vec::new(); places.len()]) };
    let wide = |place: &[f32; 3]| place.map(f64::from);
    let points: Vec<[f64; 3]> = among.iter().map(wide).collect();
    let tree: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(&points)
        .map_err(|error| anyhow!("a position is no number: {error:?}"))?;
    let of = |place: &[f32; 3]| {
        let found = tree.query(&wide(place)).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let mut found: Vec<(f64, u32)> = found.iter().map(|n| (n.distance, n.item)).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found
    };
    Ok(places.par_iter().map(of).collect())
}
