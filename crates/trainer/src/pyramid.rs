//! The photographs of a first frame at several resolutions: while splats are coarse, so are the photographs that they are compared with
//! (docs/adr/0088-first-frames-begin-on-reduced-photographs.md).

use crate::backend::TaskView;
use ffgs_core::TrainingView;
use std::borrow::Cow;
use std::cell::Cell;

/// Photographs, and the same halved once, twice and so on.
pub(crate) struct Pyramid<'v> {
    levels: Vec<Cow<'v, [TrainingView]>>,
    /// The level at hand: times that photographs are halved.
    level: Cell<usize>,
}

impl<'v> Pyramid<'v> {
    /// Down to blocks of `factor` pixels, a power of two; those are at hand.
    pub(crate) fn new(views: &'v [TrainingView], factor: usize) -> Self {
        let coarsest = factor.ilog2() as usize;
        tracing::debug!("the first frame begins on photographs that are reduced by {factor}");
        let levels = (0..=coarsest).map(|level| TrainingView::all_reduced(views, 1 << level)).collect();
        Self { levels, level: Cell::new(coarsest) }
    }

    /// All photographs, level after level.
    pub(crate) fn task_views(&self) -> Vec<TaskView<'_>> {
        let all = self.levels.iter().flat_map(|views| views.iter());
        all.map(|view| TaskView { view, region: None, tiles: None }).collect()
    }

    /// Which of [`task_views`](Self::task_views) shows a view at hand.
    pub(crate) fn shown(&self, view: usize) -> usize {
        self.level.get() * self.levels[0].len() + view
    }

    /// Whether the photographs at hand are reduced.
    pub(crate) fn is_reduced(&self) -> bool {
        self.level.get() > 0
    }

    /// Takes blocks of `factor` pixels, where those at hand are larger.
    pub(crate) fn refine(&self, factor: usize) {
        let level = self.level.get().min(factor.ilog2() as usize);
        if self.level.replace(level) != level {
            tracing::debug!("from now on they are reduced by {}", 1 << level);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};

    fn view(grey: u8) -> TrainingView {
        let size = ImageSize { width: 24, height: 16 };
        let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 12.0, cy: 8.0 };
        let camera = Camera::new(intrinsics, glam::DMat4::IDENTITY, size).unwrap();
        let image = ImageRgb8::new(size, vec![grey; 3 * size.pixels()]).unwrap();
        TrainingView { camera, image, mask: Mask::filled(size, false) }
    }

    #[test]
    fn levels_are_refined_and_never_coarser_again() {
        let views = [view(10), view(200)];
        let pyramid = Pyramid::new(&views, 4);
        let tasks = pyramid.task_views();
        let at_hand = |view: usize| {
            let shown = tasks[pyramid.shown(view)].view;
            (shown.camera.size().width, shown.image.data()[0])
        };
        assert_eq!([at_hand(0), at_hand(1)], [(6, 10), (6, 200)]);
        for (factor, width) in [(8, 6), (2, 12), (4, 12), (1, 24), (2, 24)] {
            pyramid.refine(factor);
            assert_eq!([at_hand(0), at_hand(1)], [(width, 10), (width, 200)], "by {factor}");
            assert_eq!(pyramid.is_reduced(), width < 24);
        }
    }

    #[test]
    fn whole_photographs_are_not_copied() {
        let views = [view(10)];
        let pyramid = Pyramid::new(&views, 1);
        assert!(std::ptr::eq(pyramid.task_views()[0].view, &raw const views[0]) && !pyramid.is_reduced());
    }
}
