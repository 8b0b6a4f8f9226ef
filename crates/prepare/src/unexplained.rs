//! What the points of a view leave unexplained of its foreground.

use crate::stereo::StereoPoint;
use crate::views::View;
use ffgs_core::Camera;
use glam::{DVec2, DVec3};

/// The foreground of a view that nothing explains.
pub(crate) struct Unexplained {
    camera: Camera,
    /// (H, W), row by row.
    open: Vec<bool>,
    /// Pixels of the mask.
    area: usize,
}

impl Unexplained {
    /// All of the mask; `None` without one.
    pub(crate) fn new(view: &View) -> Option<Self> {
        let mask = view.mask.as_ref()?;
        let open = mask.data().iter().map(|v| *v > 0).collect();
        Some(Self { camera: view.camera, open, area: mask.count() })
    }

    /// Points that were made evenly over the foreground of this view explain it: each a square of its share of it.
    pub(crate) fn explain(&mut self, points: &[StereoPoint]) {
        let radius = 0.5 * (self.area as f64 / points.len().max(1) as f64).sqrt();
        for point in points {
            if let Some(pixel) = self.pixel_of(point.position) {
                self.close(pixel, radius);
            }
        }
    }

    fn pixel_of(&self, point: DVec3) -> Option<DVec2> {
        self.camera.project(point).map(|p| p.pixel).filter(|pixel| self.camera.shows(*pixel))
    }

    fn close(&mut self, pixel: DVec2, radius: f64) {
        let size = self.camera.size();
        let span = |at: f64, n: usize| {
            let [low, high] =
                [at - radius, at + radius].map(|v| v.floor().clamp(0.0, n as f64 - 1.0) as usize);
            low..=high
        };
        for y in span(pixel.y, size.height) {
            self.open[y * size.width..][span(pixel.x, size.width)].fill(false);
        }
    }

    /// Whether most of the views that look at a point have nothing that explains their foreground there.
    pub(crate) fn lacks(views: &[Self], point: DVec3) -> bool {
        let (mut seen, mut lacking) = (0, 0);
        for view in views {
            if let Some(pixel) = view.pixel_of(point) {
                seen += 1;
                lacking +=
                    usize::from(view.open[pixel.y as usize * view.camera.size().width + pixel.x as usize]);
            }
        }
        2 * lacking > seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageRgb8, ImageSize, Intrinsics, Mask};
    use glam::DMat4;

    const SIZE: ImageSize = ImageSize { width: 40, height: 30 };

    /// A camera at the origin that looks along z, turned round the place (0, 0, 5) by an angle.
    fn view(angle: f64) -> View {
        let intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 20.0, cy: 15.0 };
        let there = DMat4::from_translation(DVec3::new(0.0, 0.0, 5.0));
        let pose = there * DMat4::from_rotation_y(angle) * there.inverse();
        View {
            camera: Camera::new(intrinsics, pose, SIZE).unwrap(),
            image: ImageRgb8::new(SIZE, vec![0; 3 * SIZE.pixels()]).unwrap(),
            mask: Some(Mask::filled(SIZE, true)),
        }
    }

    /// Points one metre before the camera, one for every pixel.
    fn wall(view: &View) -> Vec<StereoPoint> {
        let pixel = |i: usize| DVec2::new((i % SIZE.width) as f64 + 0.5, (i / SIZE.width) as f64 + 0.5);
        let at = |p: DVec2| view.camera.center() + view.camera.ray(p);
        (0..SIZE.pixels()).map(|i| StereoPoint { position: at(pixel(i)), colour: [0.0; 3] }).collect()
    }

    #[test]
    fn the_hull_is_needed_where_most_views_explain_nothing() {
        let views = [view(0.0), view(0.1), view(3.1)];
        let mut unexplained: Vec<Unexplained> = views.iter().map(|v| Unexplained::new(v).unwrap()).collect();
        let place = DVec3::new(0.0, 0.0, 5.2);
        assert!(Unexplained::lacks(&unexplained, place), "nothing is explained");
        for k in 0..2 {
            assert!(Unexplained::lacks(&unexplained, place), "{k} of three views explain it");
            let own = wall(&views[k]);
            unexplained[k].explain(&own);
        }
        assert!(!Unexplained::lacks(&unexplained, place), "two of three views explain it");
        assert!(!Unexplained::lacks(&unexplained, DVec3::new(0.0, 50.0, 5.0)), "nobody looks there");
    }
}
