//! What cameras saw of what moves, and where it may be: places that most masks hold.

use crate::views::View;
use ffgs_core::{Camera, Mask};
use glam::DVec3;
use rayon::prelude::*;

/// Masks may be too small by this share of the image's width.
const MARGIN: f64 = 0.005;
/// Least share of the views that see a place, and have it in their mask: some masks miss what moves, as in fog.
const LEAST_SHARE: f64 = 0.5;
/// Masks that must hold it at least: of a rig whose cameras overlap in pairs, two see it.
const LEAST_MASKS: usize = 2;

/// A camera with what it saw.
#[derive(Clone, Debug)]
pub(crate) struct Silhouette {
    pub camera: Camera,
    pub mask: Mask,
}

/// How many views see a place, and how many of them have it in their mask.
pub(crate) fn views_of(silhouettes: &[Silhouette], place: DVec3) -> (usize, usize) {
    let seen = silhouettes.iter().filter_map(|s| Some((s, s.camera.pixel_of(place)?)));
    seen.fold((0, 0), |(seen, inside), (s, (x, y))| (seen + 1, inside + usize::from(s.mask.contains(x, y))))
}

/// The masks of all views, with a margin.
pub(crate) struct Silhouettes(Vec<Silhouette>);

impl Silhouettes {
    /// `None` without masks of at least two views, or where all of them are empty.
    pub(crate) fn new(views: &[View]) -> Option<Self> {
        let with_margin = |view: &View| {
            let margin = (MARGIN * view.camera.size().width as f64).ceil() as usize;
            Some(Silhouette { camera: view.camera, mask: view.mask.as_ref()?.dilated(margin) })
        };
        let all: Vec<Silhouette> = views.par_iter().filter_map(with_margin).collect();
        (all.len() > 1 && all.iter().any(|s| s.mask.count() > 0)).then_some(Self(all))
    }

    /// Whether a place may be of what moves.
    pub(crate) fn hold(&self, place: DVec3) -> bool {
        let (seen, inside) = views_of(&self.0, place);
        inside >= LEAST_MASKS && inside as f64 >= LEAST_SHARE * seen as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::painted::{SIZE, painted, view};
    use glam::DMat4;

    /// The left half of what some views show.
    fn left(shown: &[usize]) -> Vec<View> {
        let half =
            Mask::new(SIZE, (0..SIZE.pixels()).map(|i| u8::from(i % SIZE.width < SIZE.width / 2)).collect());
        let mask = |i: usize| {
            Some(if shown.contains(&i) { half.clone().unwrap() } else { Mask::filled(SIZE, false) })
        };
        (0..4).map(|i| View { mask: mask(i), ..view(i, painted) }).collect()
    }

    #[test]
    fn most_masks_tell_where_what_moves_may_be() {
        let held =
            |shown: &[usize], x: f64| Silhouettes::new(&left(shown)).unwrap().hold(DVec3::new(x, 0.0, 8.0));
        assert!(held(&[0, 1, 2, 3], -1.0) && !held(&[0, 1, 2, 3], 3.0), "all masks show it");
        assert!(held(&[0, 3], -1.0) && !held(&[0, 3], 3.0), "half of them miss it");
        assert!(!held(&[2], -1.0), "one view's mask is a mistake");
        assert!(!held(&[0, 1, 2, 3], 1e6), "nobody looks there");
    }

    #[test]
    fn where_two_views_look_both_masks_must_hold() {
        let mut views = left(&[0, 1, 2, 3]);
        // Two of the cameras turn round.
        for view in &mut views[2..] {
            let pose = DMat4::from_rotation_y(std::f64::consts::PI);
            view.camera = Camera::new(view.camera.intrinsics(), pose, SIZE).unwrap();
        }
        let place = DVec3::new(-1.0, 0.0, 8.0);
        assert!(Silhouettes::new(&views).unwrap().hold(place));
        views[1].mask = Some(Mask::filled(SIZE, false));
        assert!(!Silhouettes::new(&views).unwrap().hold(place), "one mask of two");
    }

    #[test]
    fn without_masks_nothing_is_held() {
        assert!(Silhouettes::new(&left(&[])).is_none());
        assert!(Silhouettes::new(&left(&[0, 1])[..1]).is_none());
    }
}
