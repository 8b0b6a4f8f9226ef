//! Photographs no larger than what is compared with them can show (docs/adr/0054-resolution-follows-the-splats.md).

use ffgs_core::TrainingView;
use std::borrow::Cow;

/// Photographs whose pixels are blocks of `factor` times `factor` pixels.
pub(crate) struct Reduced<'v> {
    /// Side of the blocks.
    pub factor: usize,
    /// With them for pixels.
    pub views: Cow<'v, [TrainingView]>,
}

impl<'v> Reduced<'v> {
    /// `views` themselves with a factor of 1.
    pub(crate) fn new(views: &'v [TrainingView], factor: usize) -> Self {
        Self { factor, views: TrainingView::all_reduced(views, factor) }
    }
}
