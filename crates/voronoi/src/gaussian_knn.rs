use crate::normalised::{Normalisation, NormalisedTracks, RowBand, bands, check_sigma, prepare};
use crate::{IntegerCentredTracks, MotionError, MotionInterpolator};
use ffgs_core::{DenseMotion, ImageSize, Mask};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Gaussian-weighted K nearest neighbours: Algorithm 2 of the FastFlowGS supplement (after DOT).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussianKnn {
    /// Number of neighbours K; with fewer tracks all are used.
    pub k: usize,
    /// Kernel scale in normalised image coordinates.
    pub sigma: f64,
}

impl Default for GaussianKnn {
    /// K = 8, sigma = 0.05, as in all of the paper's experiments.
    fn default() -> Self {
        Self { k: 8, sigma: 0.05 }
    }
}

/// Side of the pixel tiles that share one tree query (px). Neighbouring pixels have nearly the same neighbours, so a
/// tile fetches a superset once: 64 pixels cost two queries and two allocations.
const TILE: usize = 8;

impl MotionInterpolator for GaussianKnn {
    fn densify_integer_centred(
        &self,
        tracks: &IntegerCentredTracks,
        size: ImageSize,
        region: Option<&Mask>,
        out: &mut DenseMotion,
    ) -> Result<(), MotionError> {
        prepare(size, region, out)?;
        check_sigma(self.sigma)?;
        if self.k == 0 {
            return Err(MotionError::NoNeighbours);
        }
        let tracks = NormalisedTracks::new(tracks, size)?;
        if tracks.points.is_empty() {
            return Ok(());
        }
        let field = Field {
            tree: tracks.tree()?,
            k: NonZero::new(self.k.min(tracks.points.len())).unwrap_or(NonZero::<usize>::MIN),
            tracks,
            half_precision: 0.5 / (self.sigma * self.sigma),
            normalisation: Normalisation::new(size),
            region,
        };
        bands(out, TILE).into_par_iter().for_each(|mut band| field.fill_band(&mut band));
        Ok(())
    }
}

struct Field<'a> {
    tracks: NormalisedTracks,
    tree: ImmutableKdTree<f64, 2>,
    k: NonZero<usize>,
    half_precision: f64,
    normalisation: Normalisation,
    region: Option<&'a Mask>,
}

/// The K best candidates of a pixel so far: squared distance and track, ascending.
type Nearest = Vec<(f64, u32)>;

impl Field<'_> {
    fn fill_band(&self, band: &mut RowBand) {
        let mut nearest = Nearest::with_capacity(self.k.get() + 1);
        for first_column in (0..band.width).step_by(TILE) {
            let columns = first_column..(first_column + TILE).min(band.width);
            let wanted = |row: usize, column: usize| self.wanted(column, band.first_row + row);
            let pixels = (0..band.rows()).flat_map(|r| columns.clone().map(move |c| (r, c)));
            if !pixels.clone().any(|(r, c)| wanted(r, c)) {
                continue;
            }
            let corners = [[columns.start, 0], [columns.end - 1, band.rows() - 1]];
            let candidates = self.candidates(corners.map(|[c, r]| self.point(c, band.first_row + r)));
            for (row, column) in pixels {
                if self.wanted(column, band.first_row + row) {
                    self.select(self.point(column, band.first_row + row), &candidates, &mut nearest);
                    let (value, confidence) = self.weigh(&nearest);
                    band.set(column, row, value, confidence);
                }
            }
        }
    }

    fn wanted(&self, column: usize, row: usize) -> bool {
        self.region.is_none_or(|mask| mask.contains(column, row))
    }

    fn point(&self, column: usize, row: usize) -> [f64; 2] {
        self.normalisation.apply([column as f64, row as f64])
    }

    /// Every track that can be among the K nearest of a pixel in the tile, ascending.
    ///
    /// With the tile's centre c and radius r, the K nearest of any of its pixels lie within `d_K(c) + 2 r` of c.
    fn candidates(&self, [low, high]: [[f64; 2]; 2]) -> Vec<u32> {
        let centre = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
        let radius = 0.5 * (high[0] - low[0]).hypot(high[1] - low[1]);
        let nearest = self.tree.query(&centre).nearest_n::<SquaredEuclidean<f64>>(self.k).execute();
        let kth = nearest.iter().map(|n| n.distance).fold(0.0, f64::max).sqrt();
        // The tiny factor covers rounding, so that the bound stays a superset.
        let reach = (kth + 2.0 * radius) * (1.0 + 1e-9) + 1e-12;
        let within =
            self.tree.query(&centre).within::<SquaredEuclidean<f64>>(reach * reach).unsorted().execute();
        let mut candidates: Vec<u32> = within.iter().map(|n| n.item).collect();
        candidates.sort_unstable();
        candidates
    }

    /// The K nearest candidates; of equally distant ones the first tracks.
    fn select(&self, pixel: [f64; 2], candidates: &[u32], nearest: &mut Nearest) {
        nearest.clear();
        for &track in candidates {
            let p = self.tracks.points[track as usize];
            let (dx, dy) = (pixel[0] - p[0], pixel[1] - p[1]);
            let d2 = dx * dx + dy * dy;
            let full = nearest.len() == self.k.get();
            if full && !nearest.last().is_some_and(|worst| d2 < worst.0) {
                continue;
            }
            if full {
                nearest.pop();
            }
            let at = nearest.iter().rposition(|n| n.0 <= d2).map_or(0, |i| i + 1);
            nearest.insert(at, (d2, track));
        }
    }

    /// Weighted means and the confidence. Weights are relative to the nearest, whose own weight is then 1: the sum
    /// can neither underflow nor be 0 / 0 however far the tracks are.
    fn weigh(&self, nearest: &Nearest) -> ([f64; 3], f64) {
        let closest = nearest.first().map_or(f64::INFINITY, |n| n.0);
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for &(d2, track) in nearest {
            let weight = (-(d2 - closest) * self.half_precision).exp();
            total += weight;
            for (s, v) in sum.iter_mut().zip(self.tracks.values[track as usize]) {
                *s += weight * v;
            }
        }
        (sum.map(|s| s / total), (-closest * self.half_precision).exp())
    }
}
