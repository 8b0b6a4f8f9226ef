//! Gaussians from a point cloud, as 3D Gaussian Splatting starts.

use ffgs_core::{Gaussians, logit};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Neighbours whose mean squared distance sets the scale (3DGS `distCUDA2`).
const NEIGHBOURS: usize = 3;
/// Opacity of a new Gaussian (3DGS).
pub const INITIAL_OPACITY: f32 = 0.1;
/// Zeroth spherical harmonic, `1 / (2 sqrt(pi))`.
const SH0: f32 = 0.282_094_79;
/// Scales outside these quantiles are clamped to them: duplicates would give needles, outliers would cover the view.
const QUANTILES: [f64; 2] = [0.001, 0.99];
/// Standard deviation (m) where points give no distance: a single point, or all at one place.
const LONE_SCALE: f32 = 0.01;

/// One isotropic Gaussian a point: standard deviation = root mean squared distance of the 3 nearest other points,
/// identity rotation, the given opacity (0..1, see [`INITIAL_OPACITY`]), SH of degree 0 from the colour, rest zero.
///
/// `positions` (N, 3) in metres, finite; `colours` (N, 3) in 0..=1.
///
/// # Panics
/// When the lengths differ, a position is not finite, or `sh_degree` exceeds 3.
pub fn from_points(
    positions: &[[f32; 3]],
    colours: &[[f32; 3]],
    sh_degree: usize,
    opacity: f32,
) -> Gaussians {
    assert_eq!(positions.len(), colours.len(), "a colour for every position");
    assert!(positions.as_flattened().iter().all(|v| v.is_finite()), "positions must be finite");
    let mut out = Gaussians::zeros(positions.len(), sh_degree);
    let stride = out.sh_stride();
    out.means.copy_from_slice(positions);
    out.quats.fill([1.0, 0.0, 0.0, 0.0]);
    out.opacity_logits.fill(logit(opacity));
    for (scale, s) in out.log_scales.iter_mut().zip(scales(positions)) {
        *scale = [s.ln(); 3];
    }
    for (sh, rgb) in out.sh.chunks_exact_mut(stride).zip(colours) {
        sh[0] = rgb.map(|v| (v - 0.5) / SH0);
    }
    out
}

/// Standard deviations (m), positive and finite.
fn scales(positions: &[[f32; 3]]) -> Vec<f32> {
    let mut scales = neighbour_distances(positions);
    let mut sorted: Vec<f32> = scales.iter().copied().filter(|s| *s > 0.0 && s.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    let quantile = |q: f64| sorted.get(((sorted.len().max(1) - 1) as f64 * q).round() as usize).copied();
    let [low, high] = QUANTILES.map(|q| quantile(q).unwrap_or(LONE_SCALE));
    for s in &mut scales {
        *s = s.clamp(low, high);
    }
    scales
}

/// Root mean squared distance of each point to its nearest other points; 0 when there are none.
fn neighbour_distances(positions: &[[f32; 3]]) -> Vec<f32> {
    if positions.len() < 2 {
        return vec![0.0; positions.len()];
    }
    let tree = build_tree(positions);
    let count = NonZero::new(NEIGHBOURS + 1).expect("positive");
    let distance = |(i, point): (usize, &[f32; 3])| {
        let found = tree.query(point).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        // Among duplicates the point itself may not be listed: then the farthest entry is one too many.
        let others = found.iter().filter(|n| n.item as usize != i).take(NEIGHBOURS);
        let (sum, n) = others.fold((0.0, 0.0), |(sum, n), found| (sum + found.distance, n + 1.0f32));
        (sum / n.max(1.0)).sqrt()
    };
    positions.par_iter().enumerate().map(distance).collect()
}

fn build_tree(positions: &[[f32; 3]]) -> ImmutableKdTree<f32, 3> {
    ImmutableKdTree::new_from_slice(positions).expect("finite positions")
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::sigmoid;

    fn grid(n: usize, spacing: f32) -> Vec<[f32; 3]> {
        let at = |i: usize| [i % n, i / n % n, i / n / n].map(|v| v as f32 * spacing);
        (0..n * n * n).map(at).collect()
    }

    #[test]
    fn a_grid_gives_its_spacing_and_colour() {
        let points = grid(10, 0.3);
        let colours = vec![[0.2, 0.5, 0.9]; points.len()];
        let g = from_points(&points, &colours, 2, INITIAL_OPACITY);
        g.validate().unwrap();
        assert!(g.log_scales.iter().flatten().all(|s| (s.exp() - 0.3).abs() < 1e-5));
        assert!((sigmoid(g.opacity_logits[7]) - 0.1).abs() < 1e-6);
        let back = g.sh_of(3)[0].map(|c| c * SH0 + 0.5);
        assert!(back.iter().zip(colours[3]).all(|(a, b)| (a - b).abs() < 1e-6));
        assert_eq!(g.sh_of(3)[1..], [[0.0; 3]; 8]);
    }

    #[test]
    fn duplicates_and_outliers_are_clamped() {
        let mut points = grid(10, 0.3);
        points.extend([[0.3, 0.3, 0.3]; 500]);
        points.push([1e6, 0.0, 0.0]);
        let colours = vec![[0.5; 3]; points.len()];
        let g = from_points(&points, &colours, 0, INITIAL_OPACITY);
        assert!(g.is_finite());
        assert!(g.log_scales.iter().flatten().all(|s| (0.1..0.5).contains(&s.exp())));
    }

    #[test]
    fn few_points_do_not_fail() {
        for n in 0..4 {
            let points: Vec<_> = (0..n).map(|i| [i as f32, 0.0, 0.0]).collect();
            assert!(from_points(&points, &vec![[0.5; 3]; n], 3, 0.5).is_finite());
        }
        let same = from_points(&[[1.0; 3]; 100], &[[0.5; 3]; 100], 0, 0.5);
        assert!((same.log_scales[50][1].exp() - LONE_SCALE).abs() < 1e-6);
    }
}
