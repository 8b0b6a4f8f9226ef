//! Which parts of the image the loss visits: 16 x 16 tiles that hold a counted pixel, joined to spans.

use super::{BAND, LossRegion, MAX_TILES, window::LANES};
use ffgs_core::ImageSize;

/// Up to [`MAX_TILES`] adjacent tiles of one band of rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Span {
    /// First column, a multiple of [`LANES`].
    pub x0: usize,
    /// Number of columns, a multiple of [`LANES`]; may reach beyond the image.
    pub columns: usize,
}

/// Spans of every band; `of(band)` lists one band's.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub(super) struct Spans {
    all: Vec<Span>,
    starts: Vec<usize>,
}

impl Spans {
    /// Spans of band `band`, left to right.
    pub(crate) fn of(&self, band: usize) -> &[Span] {
        &self.all[self.starts[band]..self.starts[band + 1]]
    }

    /// Fills the list for a region of an image.
    pub(crate) fn collect(&mut self, size: ImageSize, region: LossRegion) {
        self.all.clear();
        self.starts.clear();
        self.starts.push(0);
        for first_row in (0..size.height).step_by(BAND) {
            self.collect_band(size, region, first_row);
            self.starts.push(self.all.len());
        }
    }

    fn collect_band(&mut self, size: ImageSize, region: LossRegion, first_row: usize) {
        let mut open: Option<Span> = None;
        for x0 in (0..size.width).step_by(LANES) {
            if !tile_counts(size, region, first_row, x0) {
                self.all.extend(open.take());
                continue;
            }
            let span = open.get_or_insert(Span { x0, columns: 0 });
            span.columns += LANES;
            if span.columns == MAX_TILES * LANES {
                self.all.extend(open.take());
            }
        }
        self.all.extend(open);
    }
}

fn tile_counts(size: ImageSize, region: LossRegion, first_row: usize, x0: usize) -> bool {
    let LossRegion::Mask(mask) = region else { return true };
    let (x1, last) = ((x0 + LANES).min(size.width), (first_row + BAND).min(size.height));
    (first_row..last).any(|y| mask.data()[y * size.width + x0..y * size.width + x1].iter().any(|&v| v != 0))
}
