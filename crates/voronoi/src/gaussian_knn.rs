use crate::kernel_mean::{Candidate, KernelMean, LANES};
use crate::normalised::{Normalisation, NormalisedTracks, RowBand, bands, check_sigma, prepare};
use crate::{IntegerCentredTracks, MotionError, MotionInterpolator};
use ffgs_core::{DenseMotion, ImageSize, Mask};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use pulp::Arch;
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
const _: () = assert!(TILE * TILE == LANES);

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

impl Field<'_> {
    fn fill_band(&self, band: &mut RowBand) {
        let arch = Arch::new();
        let mut nearest = vec![[0.0; LANES]; self.k.get()];
        let mut pixels = Vec::with_capacity(LANES);
        for first_column in (0..band.width).step_by(TILE) {
            let columns = first_column..(first_column + TILE).min(band.width);
            let wanted = |&(row, column): &(usize, usize)| self.wanted(column, band.first_row + row);
            pixels.clear();
            pixels.extend((0..band.rows()).flat_map(|r| columns.clone().map(move |c| (r, c))).filter(wanted));
            let (Some(first), Some(last)) = (pixels.first(), pixels.last()) else { continue };
            let corners = [[columns.start, first.0], [columns.end - 1, last.0]];
            let candidates = self.candidates(corners.map(|[c, r]| self.point(c, band.first_row + r)));
            let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
            for (k, &(row, column)) in pixels.iter().enumerate() {
                [x[k], y[k]] = self.point(column, band.first_row + row);
            }
            let means = arch.dispatch(KernelMean {
                x: &x,
                y: &y,
                pixels: pixels.len(),
                candidates: &candidates,
                half_precision: self.half_precision,
                nearest: &mut nearest,
            });
            for (k, &(row, column)) in pixels.iter().enumerate() {
                band.set(column, row, [0, 1, 2].map(|v| means.values[v][k]), means.confidence[k]);
            }
        }
    }

    fn wanted(&self, column: usize, row: usize) -> bool {
        self.region.is_none_or(|mask| mask.contains(column, row))
    }

    fn point(&self, column: usize, row: usize) -> [f64; 2] {
        self.normalisation.apply([column as f64, row as f64])
    }

    /// Every track that can be among the K nearest of a pixel in the tile, in the order of the tracks.
    ///
    /// With the tile's centre c and radius r, the K nearest of any of its pixels lie within `d_K(c) + 2 r` of c.
    fn candidates(&self, [low, high]: [[f64; 2]; 2]) -> Vec<Candidate> {
        let centre = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
        let radius = 0.5 * (high[0] - low[0]).hypot(high[1] - low[1]);
        let nearest = self.tree.query(&centre).nearest_n::<SquaredEuclidean<f64>>(self.k).execute();
        let kth = nearest.iter().map(|n| n.distance).fold(0.0, f64::max).sqrt();
        // The tiny factor covers rounding, so that the bound stays a superset.
        let reach = (kth + 2.0 * radius) * (1.0 + 1e-9) + 1e-12;
        let within =
            self.tree.query(&centre).within::<SquaredEuclidean<f64>>(reach * reach).unsorted().execute();
        let mut tracks: Vec<u32> = within.iter().map(|n| n.item).collect();
        // Of equally distant ones the first tracks count.
        tracks.sort_unstable();
        let candidate = |track: &u32| {
            let track = *track as usize;
            Candidate { point: self.tracks.points[track], values: self.tracks.values[track] }
        };
        tracks.iter().map(candidate).collect()
    }
}
