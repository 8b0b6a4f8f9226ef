//! Motion fields by natural-neighbour interpolation on the Delaunay triangulation of the tracks.

use crate::normalised::{Normalisation, NormalisedTracks, RowBand, bands, check_sigma, prepare};
use crate::{IntegerCentredTracks, MotionError, MotionInterpolator};
use ffgs_core::{DenseMotion, ImageSize, Mask};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, HasPosition, NaturalNeighbor, Point2, Triangulation};

/// Natural-neighbour (Sibson) interpolation on the Delaunay triangulation of the tracks; outside the convex hull the
/// nearest track. An alternative to Algorithm 2 that does not smooth beyond the neighbouring tracks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NaturalNeighbour {
    /// Scale of the distance confidence in normalised image coordinates, as in [`crate::GaussianKnn`].
    pub sigma: f64,
}

impl Default for NaturalNeighbour {
    fn default() -> Self {
        Self { sigma: 0.05 }
    }
}

/// A distinct source position with the index of its track.
struct Site {
    position: Point2<f64>,
    track: usize,
}

impl HasPosition for Site {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.position
    }
}

type Delaunay = DelaunayTriangulation<Site>;

impl MotionInterpolator for NaturalNeighbour {
    fn densify_integer_centred(
        &self,
        tracks: &IntegerCentredTracks,
        size: ImageSize,
        region: Option<&Mask>,
    ) -> Result<DenseMotion, MotionError> {
        let mut out = prepare(size, region)?;
        check_sigma(self.sigma)?;
        let tracks = distinct(&NormalisedTracks::new(tracks, size)?);
        if tracks.points.is_empty() {
            return Ok(out);
        }
        let sites = tracks.points.iter().enumerate();
        let sites = sites.map(|(track, p)| Site { position: Point2::new(p[0], p[1]), track }).collect();
        let field = Field {
            triangulation: Delaunay::bulk_load(sites).map_err(|e| MotionError::Index(e.to_string()))?,
            tree: tracks.tree()?,
            tracks,
            half_precision: 0.5 / (self.sigma * self.sigma),
            normalisation: Normalisation::new(size),
            region,
        };
        bands(&mut out, ROWS).into_par_iter().for_each(|mut band| field.fill_band(&mut band));
        Ok(out)
    }
}

/// Rows one task fills.
const ROWS: usize = 8;

/// Replaces tracks with equal sources by their mean, in order of position; tiny coordinates become 0 (spade refuses
/// them, and they are far below f32 resolution).
fn distinct(tracks: &NormalisedTracks) -> NormalisedTracks {
    let flush = |p: [f64; 2]| p.map(|v| if v.abs() < 1e-30 { 0.0 } else { v });
    let mut order: Vec<_> = tracks.points.iter().map(|&p| flush(p)).zip(&tracks.values).collect();
    order.sort_by(|(a, _), (b, _)| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut out = NormalisedTracks { points: Vec::new(), values: Vec::new() };
    for group in order.chunk_by(|(a, _), (b, _)| a == b) {
        let mut sum = [0.0; 3];
        for (_, value) in group {
            sum.iter_mut().zip(**value).for_each(|(s, v)| *s += v);
        }
        out.points.push(group[0].0);
        out.values.push(sum.map(|s| s / group.len() as f64));
    }
    out
}

struct Field<'a> {
    tracks: NormalisedTracks,
    triangulation: Delaunay,
    tree: ImmutableKdTree<f64, 2>,
    half_precision: f64,
    normalisation: Normalisation,
    region: Option<&'a Mask>,
}

impl Field<'_> {
    fn fill_band(&self, band: &mut RowBand) {
        // One point or collinear points enclose nothing, and spade's query needs an edge to exist.
        let has_hull = self.triangulation.num_inner_faces() > 0;
        let interpolation = has_hull.then(|| self.triangulation.natural_neighbor());
        let mut weights = Vec::new();
        for row in 0..band.rows() {
            for column in 0..band.width {
                let absolute = band.first_row + row;
                if self.region.is_none_or(|mask| mask.contains(column, absolute)) {
                    let pixel = self.normalisation.apply([column as f64, absolute as f64]);
                    let nearest = self.tree.query(&pixel).nearest_one::<SquaredEuclidean<f64>>().execute();
                    let value = (interpolation.as_ref())
                        .and_then(|i| self.interpolate(i, pixel, &mut weights))
                        .unwrap_or(self.tracks.values[nearest.item as usize]);
                    band.set(column, row, value, (-nearest.distance * self.half_precision).exp());
                }
            }
        }
    }

    /// `None` outside the convex hull, or where rounding spoilt the weights.
    fn interpolate(
        &self,
        interpolation: &NaturalNeighbor<'_, Delaunay>,
        pixel: [f64; 2],
        weights: &mut Vec<(FixedVertexHandle, f64)>,
    ) -> Option<[f64; 3]> {
        interpolation.get_weights(Point2::new(pixel[0], pixel[1]), weights);
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for &(vertex, weight) in weights.iter() {
            let weight = weight.max(0.0);
            total += weight;
            let track = self.triangulation.vertex(vertex).data().track;
            sum.iter_mut().zip(self.tracks.values[track]).for_each(|(s, v)| *s += weight * v);
        }
        // Sibson weights add up to 1; NaN fails this test too.
        let sound = (total - 1.0).abs() < 1e-3;
        sound.then(|| sum.map(|s| s / total))
    }
}
