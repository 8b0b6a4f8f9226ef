//! Points in mid-air, found by the views that look through them.
//!
//! A view that shows a wall at some place denies all that would stand between: a point of a surface is shown by the views that see it at its own
//! depth, or is hidden behind something nearer. So a point that more views deny than show is wrong (visibility-based fusion of depth
//! maps, Merrell et al. 2007). A wrong depth that is too small never speaks against a right point.

use crate::ground::Ground;
use crate::stereo::StereoPoint;
use crate::surfaces::Surfaces;
use crate::views::View;
use crate::windows::{grid, pixel};
use glam::DVec3;
use rayon::prelude::*;

/// Places at which depths are known, over all views, and in a view at least.
const PLACES: usize = 30_000;
const LEAST_PLACES: usize = 1_000;
/// Colours that differ by more are of different things (0 to 1, RMS over the channels); exposures of cameras differ by less.
const OTHER_COLOUR: f32 = 0.15;
/// Depths within this factor are the same.
const SAME: f64 = 1.05;
/// Rounds in which points are removed and depths found again without them.
const ROUNDS: usize = 8;

/// The depths that the views know.
pub(crate) struct FreeSpace<'a> {
    views: Vec<Depths<'a>>,
}

/// The depths of a grid of pixels of a view.
struct Depths<'a> {
    view: &'a View,
    /// Pixels from place to place.
    stride: f64,
    columns: usize,
    rows: usize,
    /// Inverse depth (1/m) per place, row by row; NaN where nothing is known.
    inverse: Vec<f64>,
}

/// What a view says of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Verdict {
    /// It shows a surface there.
    Shown,
    /// It shows something farther behind the point, or something of another colour.
    Denied,
    /// The point is outside the image or hidden, or nothing is known.
    Silent,
}

/// The `fixed` points and those of the `found` ones that no majority of views denies, and the depths that follow from them.
pub(crate) fn consistent<'a>(
    views: &'a [View],
    fixed: &[StereoPoint],
    mut found: Vec<StereoPoint>,
    ground: Option<&Ground>,
) -> (Vec<StereoPoint>, FreeSpace<'a>) {
    let mut points = [fixed, &found].concat();
    let mut space = FreeSpace::new(views, &points, ground);
    for _ in 0..ROUNDS {
        let count = found.len();
        found = space.keep(found);
        if found.len() == count {
            break;
        }
        points = [fixed, &found].concat();
        space = FreeSpace::new(views, &points, ground);
    }
    (points, space)
}

impl<'a> FreeSpace<'a> {
    fn new(views: &'a [View], matched: &[StereoPoint], ground: Option<&Ground>) -> Self {
        let pixels: usize = views.iter().map(|view| view.camera.size().pixels()).sum();
        let depths = |view: &'a View| {
            let own = view.camera.size().pixels();
            let places = (PLACES * own / pixels.max(1)).max(LEAST_PLACES);
            Depths::new(view, matched, ground, (own as f64 / places as f64).sqrt().max(1.0))
        };
        Self { views: views.par_iter().map(depths).collect() }
    }

    /// The points that more views show than deny, and those of which no view knows anything.
    fn keep(&self, points: Vec<StereoPoint>) -> Vec<StereoPoint> {
        let is_kept = |point: &StereoPoint| self.is_surface(|view| view.verdict(point.position));
        points.into_par_iter().filter(is_kept).collect()
    }

    /// The points that it [`allows`](Self::allows).
    pub(crate) fn keep_alike(&self, points: Vec<StereoPoint>) -> Vec<StereoPoint> {
        points.into_par_iter().filter(|point| self.allows(point)).collect()
    }

    /// The same for a point that was not found by comparing views: one that has another colour there denies it, too.
    pub(crate) fn allows(&self, point: &StereoPoint) -> bool {
        self.is_surface(|view| view.verdict_by_colour(point))
    }

    fn is_surface(&self, verdict: impl Fn(&Depths) -> Verdict) -> bool {
        let (mut shown, mut denied) = (0, 0);
        for view in &self.views {
            match verdict(view) {
                Verdict::Shown => shown += 1,
                Verdict::Denied => denied += 1,
                Verdict::Silent => {}
            }
        }
        shown > denied || shown + denied == 0
    }
}

impl<'a> Depths<'a> {
    fn new(view: &'a View, matched: &[StereoPoint], ground: Option<&Ground>, stride: f64) -> Self {
        let [columns, rows] = grid(view.camera.size(), stride);
        let still = Surfaces::still(view, matched, ground);
        let moving = Surfaces::moving(view, matched);
        let inverse = |place: usize| {
            let pixel = pixel(place, columns, stride);
            let surfaces = if view.is_foreground(pixel) { &moving } else { &still };
            surfaces.as_ref().map_or(f64::NAN, |s| s.inverse_depth(pixel, view.colour(pixel)))
        };
        let inverse = (0..columns * rows).into_par_iter().map(inverse).collect();
        Self { view, stride, columns, rows, inverse }
    }

    /// Judged by the nine places about the point, so that outlines need not lie at the pixel: one that shows it is enough, and all have to deny it.
    fn verdict(&self, point: DVec3) -> Verdict {
        let camera = &self.view.camera;
        let Some(seen) = camera.project(point).filter(|p| camera.shows(p.pixel)) else {
            return Verdict::Silent;
        };
        let [x, y] = seen.pixel.to_array().map(|v| (v / self.stride) as usize);
        let mut denied = true;
        for (column, row) in around([x, y], [self.columns, self.rows]) {
            // Of the point's depth over that of the place.
            let ratio = seen.depth * self.inverse[row * self.columns + column];
            if ratio > 1.0 / SAME && ratio < SAME {
                return Verdict::Shown;
            }
            denied &= ratio <= 1.0 / SAME;
        }
        if denied { Verdict::Denied } else { Verdict::Silent }
    }

    fn verdict_by_colour(&self, point: &StereoPoint) -> Verdict {
        match self.verdict(point.position) {
            Verdict::Shown if self.has_other_colour(point) => Verdict::Denied,
            verdict => verdict,
        }
    }

    /// Whether a point and all pixels about it differ in colour.
    fn has_other_colour(&self, point: &StereoPoint) -> bool {
        let View { camera, image, .. } = self.view;
        let size = image.size();
        let differs = |(x, y): (usize, usize)| {
            let there = image.pixel(y * size.width + x);
            let square = there.iter().zip(point.colour).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / 3.0;
            square > OTHER_COLOUR * OTHER_COLOUR
        };
        let pixel = camera.pixel_of(point.position);
        pixel.is_some_and(|(x, y)| around([x, y], [size.width, size.height]).all(differs))
    }
}

/// The place of a grid of some size and the eight about it, as far as they are in the grid.
fn around([x, y]: [usize; 2], [columns, rows]: [usize; 2]) -> impl Iterator<Item = (usize, usize)> {
    let near = |at: usize, count: usize| at.min(count - 1).saturating_sub(1)..(at + 2).min(count);
    near(y, rows).flat_map(move |row| near(x, columns).map(move |column| (column, row)))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};
    use glam::DMat4;

    const SIZE: ImageSize = ImageSize { width: 60, height: 40 };
    const GREY: [f32; 3] = [0.5; 3];
    /// Depth of a wall (m) before cameras side by side.
    pub(crate) const WALL: f64 = 6.0;

    fn view(x: f64) -> View {
        let intrinsics = Intrinsics { fx: 60.0, fy: 60.0, cx: 30.0, cy: 20.0 };
        let pose = DMat4::from_translation(DVec3::new(-x, 0.0, 0.0));
        View {
            camera: Camera::new(intrinsics, pose, SIZE).unwrap(),
            image: ImageRgb8::new(SIZE, vec![128; 3 * SIZE.pixels()]).unwrap(),
            mask: Some(Mask::filled(SIZE, false)),
        }
    }

    pub(crate) fn views() -> Vec<View> {
        (0..5).map(|i| view(0.3 * f64::from(i) - 0.6)).collect()
    }

    pub(crate) fn point(x: f64, y: f64, z: f64) -> StereoPoint {
        StereoPoint { position: DVec3::new(x, y, z), colour: GREY }
    }

    pub(crate) fn wall() -> Vec<StereoPoint> {
        (0..1600).map(|i| point(f64::from(i % 40) / 4.0 - 5.0, f64::from(i / 40) / 8.0 - 2.5, WALL)).collect()
    }

    #[test]
    fn points_in_mid_air_go_and_the_wall_stays() {
        // Scattered over the room, as the false matches of single pairs are.
        let scattered = |i: usize| {
            let [u, v, w] = [2, 3, 5].map(|base| crate::spread::halton(i, base));
            let depth = 1.5 + 3.5 * w;
            point((u - 0.5) * depth, (v - 0.5) * 0.6 * depth, depth)
        };
        let wrong: Vec<StereoPoint> = (0..300).map(scattered).collect();
        let (kept, _) = consistent(&views(), &[], [wall(), wrong.clone()].concat(), None);
        let wrong_kept = kept.iter().filter(|p| wrong.contains(p)).count();
        assert_eq!(kept.len() - wrong_kept, wall().len(), "points of the wall are lost");
        assert!(wrong_kept < wrong.len() / 20, "{wrong_kept} of {} stay", wrong.len());
    }

    #[test]
    fn a_thing_before_the_wall_that_most_views_show_stays() {
        let thing: Vec<StereoPoint> = (0..400)
            .map(|i| point(f64::from(i % 20) / 20.0 - 0.5, f64::from(i / 20) / 20.0 - 0.5, 3.0))
            .collect();
        let hidden = |p: &StereoPoint| p.position.x.abs() < 1.8 && p.position.y.abs() < 1.2;
        let wall: Vec<StereoPoint> = wall().into_iter().filter(|p| !hidden(p)).collect();
        let all = [wall, thing].concat();
        let views = views();
        let (kept, space) = consistent(&views, &[], all.clone(), None);
        assert_eq!(kept.len(), all.len());
        assert_eq!(space.keep(vec![point(0.0, 0.0, 2.0)]), vec![], "before the thing");
        assert_eq!(space.keep(vec![point(0.0, 0.0, 3.02)]).len(), 1, "on the thing");
    }

    #[test]
    fn fixed_points_and_what_no_view_knows_stay() {
        let wrong = vec![point(0.0, 0.0, 2.0)];
        assert_eq!(consistent(&views(), &wrong, wall(), None).0.len(), wall().len() + 1);
        assert_eq!(
            consistent(&views(), &[], wrong.clone(), None).0,
            wrong,
            "too few points to know anything"
        );
        assert_eq!(consistent(&views()[..1], &[], wrong.clone(), None).0, wrong);
        assert_eq!(consistent(&[], &[], Vec::new(), None).0, vec![]);
    }

    #[test]
    fn a_hidden_point_is_not_denied() {
        let views = views();
        let (_, space) = consistent(&views, &[], wall(), None);
        let said = |z: f64| space.views[2].verdict(DVec3::new(0.0, 0.0, z));
        assert_eq!([said(9.0), said(3.0)], [Verdict::Silent, Verdict::Denied]);
        assert_eq!([said(1.01 * WALL), said(-1.0)], [Verdict::Shown, Verdict::Silent]);
        let red = StereoPoint { colour: [0.9, 0.2, 0.2], ..point(0.0, 0.0, WALL) };
        assert_eq!(space.keep(vec![red]), [red]);
        assert_eq!(
            space.keep_alike(vec![red, point(0.0, 0.0, WALL)]),
            [point(0.0, 0.0, WALL)],
            "the wall is grey"
        );
    }
}
