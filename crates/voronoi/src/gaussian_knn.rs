//! Motion fields as the Gaussian-weighted mean of the nearest tracks (Algorithm 2).

use crate::kernel_mean::{KernelMean, Mean, Values};
use crate::nearest::{Candidate, Keys, KthNearest, LANES};
use crate::normalised::{Normalisation, NormalisedTracks, RowBand, any, bands, check_sigma, prepare};
use crate::{IntegerCentredTracks, MotionError, MotionInterpolator};
use ffgs_core::{DenseMotion, ImageSize, Mask, instructions};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;
use std::ops::Range;

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

/// Side of the pixel tiles that share their candidates (px): neighbouring pixels have nearly the same neighbours.
const TILE: usize = 8;
/// Tiles side by side that share their queries of the tree.
const BLOCK: usize = LANES;

impl MotionInterpolator for GaussianKnn {
    fn densify_integer_centred(
        &self,
        tracks: &IntegerCentredTracks,
        size: ImageSize,
        region: Option<&Mask>,
    ) -> Result<DenseMotion, MotionError> {
        let mut out = prepare(size, region)?;
        check_sigma(self.sigma)?;
        if self.k == 0 {
            return Err(MotionError::NoNeighbours);
        }
        let tracks = NormalisedTracks::new(tracks, size)?;
        if tracks.points.is_empty() {
            return Ok(out);
        }
        let field = Field {
            tree: tracks.tree()?,
            k: NonZero::new(self.k.min(tracks.points.len())).unwrap_or(NonZero::<usize>::MIN),
            keys: Keys::new(tracks.points.len()),
            values: tracks.values.iter().map(|&[x, y, visibility]| [x, y, visibility, 1.0]).collect(),
            points: tracks.points,
            half_precision: 0.5 / (self.sigma * self.sigma),
            normalisation: Normalisation::new(size),
            region,
        };
        bands(&mut out, TILE).into_par_iter().for_each(|mut band| field.fill_band(&mut band));
        Ok(out)
    }
}

struct Field<'a> {
    points: Vec<[f64; 2]>,
    values: Vec<Values>,
    tree: ImmutableKdTree<f64, 2>,
    keys: Keys,
    k: NonZero<usize>,
    half_precision: f64,
    normalisation: Normalisation,
    region: Option<&'a Mask>,
}

/// Columns of a band with the circle around its pixels (normalised).
struct Tile {
    columns: Range<usize>,
    centre: [f64; 2],
    radius: f64,
}

impl Tile {
    /// Everything whose distance from the centre is at most this can be among the K nearest of a place in the tile, where
    /// `kth2` is the squared distance of the K-th nearest of the centre: those of any place lie within `d_K + 2 r`.
    fn reach(&self, kth2: f64) -> f64 {
        // The tiny terms cover rounding and what keys leave out of distances.
        (kth2.sqrt() + 2.0 * self.radius) * (1.0 + 1e-6) + 1e-12
    }
}

impl Field<'_> {
    fn fill_band(&self, band: &mut RowBand) {
        let mut candidates = Vec::new();
        for start in (0..band.width).step_by(TILE * BLOCK) {
            let end = (start + TILE * BLOCK).min(band.width);
            if !self.is_wanted(band, &(start..end)) {
                continue;
            }
            let starts = (start..end).step_by(TILE);
            let columns = starts.map(|first| first..(first + TILE).min(end));
            let tiles: Vec<Tile> =
                columns.filter(|c| self.is_wanted(band, c)).map(|c| self.tile(band, c)).collect();
            let (Some(first), Some(last)) = (tiles.first(), tiles.last()) else { continue };
            let near = self.near(&self.tile(band, first.columns.start..last.columns.end));
            for (tile, kth2) in tiles.iter().zip(self.kth_nearest(&tiles, &near)) {
                narrow(&near, tile.centre, tile.reach(kth2), &mut candidates);
                self.fill_tile(band, &tile.columns, &candidates);
            }
        }
    }

    /// Whether any pixel of the band in these columns is.
    fn is_wanted(&self, band: &RowBand, columns: &Range<usize>) -> bool {
        (0..band.rows())
            .any(|row| self.region_row(band, row).is_none_or(|wanted| any(&wanted[columns.clone()])))
    }

    /// The region in a row of the band; `None` = all of it.
    fn region_row(&self, band: &RowBand, row: usize) -> Option<&[u8]> {
        self.region.map(|mask| &mask.data()[(band.first_row + row) * band.width..][..band.width])
    }

    fn point(&self, column: usize, row: usize) -> [f64; 2] {
        self.normalisation.apply([column as f64, row as f64])
    }

    fn tile(&self, band: &RowBand, columns: Range<usize>) -> Tile {
        let low = self.point(columns.start, band.first_row);
        let high = self.point(columns.end - 1, band.first_row + band.rows() - 1);
        let centre = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
        Tile { columns, centre, radius: 0.5 * (high[0] - low[0]).hypot(high[1] - low[1]) }
    }

    /// Every track that can be among the K nearest of a place in the tile.
    fn near(&self, tile: &Tile) -> Vec<Candidate> {
        let query = self.tree.query(&tile.centre);
        let nearest = query.nearest_n::<SquaredEuclidean<f64>>(self.k).execute();
        let reach = tile.reach(nearest.iter().map(|n| n.distance).fold(0.0, f64::max));
        let query = self.tree.query(&tile.centre);
        let near = query.within::<SquaredEuclidean<f64>>(reach * reach).unsorted().execute();
        near.iter().map(|n| Candidate { point: self.points[n.item as usize], track: n.item }).collect()
    }

    /// The squared distance of the K-th nearest of each tile's centre.
    fn kth_nearest(&self, tiles: &[Tile], near: &[Candidate]) -> [f64; LANES] {
        let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
        for (k, tile) in tiles.iter().enumerate() {
            [x[k], y[k]] = tile.centre;
        }
        instructions().dispatch(KthNearest {
            x: &x,
            y: &y,
            candidates: near,
            keys: self.keys,
            k: self.k.get(),
        })
    }

    fn fill_tile(&self, band: &mut RowBand, columns: &Range<usize>, candidates: &[Candidate]) {
        let (mut x, mut y, mut at) = ([0.0; TILE * TILE], [0.0; TILE * TILE], [(0, 0); TILE * TILE]);
        let mut pixels = 0;
        for row in 0..band.rows() {
            let wanted = self.region_row(band, row);
            for column in columns.clone().filter(|&c| wanted.is_none_or(|w| w[c] != 0)) {
                [x[pixels], y[pixels]] = self.point(column, band.first_row + row);
                at[pixels] = (column, row);
                pixels += 1;
            }
        }
        let mut means = [Mean::default(); TILE * TILE];
        instructions().dispatch(KernelMean {
            x: &x,
            y: &y,
            candidates,
            values: &self.values,
            keys: self.keys,
            k: self.k.get(),
            half_precision: self.half_precision,
            out: &mut means[..pixels],
        });
        for (&(column, row), mean) in at.iter().zip(&means[..pixels]) {
            band.set(column, row, mean.values, mean.confidence);
        }
    }
}

/// The candidates no farther than `reach` from the centre.
fn narrow(candidates: &[Candidate], centre: [f64; 2], reach: f64, out: &mut Vec<Candidate>) {
    out.clear();
    out.extend_from_slice(candidates);
    let mut count = 0;
    for &candidate in candidates {
        let (dx, dy) = (candidate.point[0] - centre[0], candidate.point[1] - centre[1]);
        // Without a branch, as the comparison cannot be predicted.
        out[count] = candidate;
        count += usize::from(dx * dx + dy * dy <= reach * reach);
    }
    out.truncate(count);
}
