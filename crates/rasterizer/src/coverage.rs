//! Exact coverage of tiles by splats.

use crate::constants::TILE;
use crate::projection::{Extent, Splat};
use crate::tiles::{Span, TileGrid, TileMask, tile_range};

/// Appends the tiles that a splat's ellipse `sigma <= reach` touches; `false` when none is active.
#[inline(always)]
pub(crate) fn cover(
    splat: &mut Splat,
    extent: &Extent,
    grid: TileGrid,
    mask: Option<&TileMask>,
    spans: &mut Vec<Span>,
) -> bool {
    let start = spans.len();
    let Splat { mean, half_height, .. } = *splat;
    let (first_row, last_row) = tile_range(mean[1] - half_height, mean[1] + half_height, grid.rows);
    let ellipse = Ellipse::new(splat, extent);
    for row in first_row..=last_row {
        let (low, high) = if first_row == last_row {
            // All of its height lies in this row of tiles.
            (mean[0] - extent.half_width, mean[0] + extent.half_width)
        } else {
            ellipse.columns((row as f32 * TILE as f32 + 0.5) - mean[1])
        };
        let (first, last) = tile_range(low, high, grid.columns);
        if first <= last {
            let span = Span { row: row as u32, first: first as u32, end: last as u32 + 1 };
            if mask.is_none_or(|m| m.any(span)) {
                spans.push(span);
            }
        }
    }
    splat.spans = (start as u32, (spans.len() - start) as u32);
    spans.len() > start
}

/// The outline `sigma = reach`, relative to the splat's centre.
struct Ellipse {
    half_height: f32,
    /// Vertical offset of the rightmost point.
    tip: f32,
    slope: f32,
    reach_over_a: f32,
    shrink: f32,
    centre: f32,
}

impl Ellipse {
    #[inline(always)]
    fn new(splat: &Splat, extent: &Extent) -> Self {
        let ([a, b, _], [xx, xy]) = (splat.conic, extent.covariance);
        let reach = splat.squared_reach();
        Self {
            half_height: splat.half_height,
            tip: (reach / xx).sqrt() * xy,
            slope: -b / a,
            reach_over_a: reach / a,
            shrink: splat.shrink,
            centre: splat.mean[0],
        }
    }

    /// Horizontal extent (px) over the pixel centres of the row of tiles that begins at the vertical offset `top`.
    #[inline(always)]
    fn columns(&self, top: f32) -> (f32, f32) {
        let bottom = (top + (TILE - 1) as f32).min(self.half_height);
        let top = top.max(-self.half_height);
        let bottom = bottom.max(top);
        let (right, left) = (self.tip.max(top).min(bottom), (-self.tip).max(top).min(bottom));
        let half = |dy: f32| (self.reach_over_a - dy * dy * self.shrink).max(0.0).sqrt() + 0.01;
        (self.centre + self.slope * left - half(left), self.centre + self.slope * right + half(right))
    }
}
