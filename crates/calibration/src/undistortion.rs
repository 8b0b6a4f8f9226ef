//! From a photograph with lens distortion to a pinhole image, as the rasterizer assumes it, in one resampling.

use crate::Lens;
use ffgs_core::{ImageRgb8, ImageSize, Intrinsics, Mask};
use glam::DVec2;

/// How finely the border of the new image is tested.
const BORDER_SAMPLES: usize = 64;
/// The new focal length, in parts of the old one, is searched between these. Below the lower bound the image's middle
/// would lose more than two pixels in three.
const ZOOM: (f64, f64) = (0.6, 8.0);

/// The way from a distorted photograph to a pinhole image of a wanted size. Each new pixel is the mean of as many
/// samples as it covers old pixels, so that undistorting and reducing is one step without aliases.
#[derive(Clone, Debug)]
pub struct Undistortion {
    lens: Lens,
    pinhole: Intrinsics,
    size: ImageSize,
    /// Samples along each side of a new pixel.
    samples: usize,
    valid_radius: f64,
}

impl Undistortion {
    /// The widest pinhole view whose every pixel the photograph shows; the principal point and the ratio of the focal
    /// lengths stay. A lens without distortion only changes its size.
    ///
    /// # Errors
    /// When even the narrowest view shows places that the photograph does not: the coefficients are those of no lens.
    pub fn new(lens: Lens, size: ImageSize) -> Result<Self, String> {
        let reduced = lens.resized(size).intrinsics;
        let samples = (lens.size.width as f64 / size.width as f64).round().max(1.0) as usize;
        let valid_radius = lens.distortion.valid_radius();
        let mut map = Self { lens, pinhole: reduced, size, samples, valid_radius };
        if lens.distortion != crate::Distortion::None {
            map.zoom_until_filled(reduced)?;
        }
        Ok(map)
    }

    /// Intrinsics of the new image.
    pub fn intrinsics(&self) -> Intrinsics {
        self.pinhole
    }

    /// Size of the new image.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Size of the photographs.
    pub fn source_size(&self) -> ImageSize {
        self.lens.size
    }

    /// Where a position of the new image lies in the photograph; `None` where the photograph shows nothing.
    pub fn source(&self, pixel: DVec2) -> Option<DVec2> {
        let Intrinsics { fx, fy, cx, cy } = self.pinhole;
        let ray = DVec2::new((pixel.x - cx) / fx, (pixel.y - cy) / fy);
        if !(ray.length() <= self.valid_radius) {
            return None;
        }
        let source = self.lens.pixel(ray);
        let (width, height) = (self.lens.size.width as f64, self.lens.size.height as f64);
        (source.x >= 0.0 && source.y >= 0.0 && source.x <= width && source.y <= height).then_some(source)
    }

    /// The new image, and where it has content. `photograph` must be of the lens's size.
    pub fn apply(&self, photograph: &ImageRgb8) -> (ImageRgb8, Mask) {
        let mut data = Vec::with_capacity(self.size.pixels() * 3);
        let mut valid = Vec::with_capacity(self.size.pixels());
        for row in 0..self.size.height {
            for column in 0..self.size.width {
                let mean = self.mean(column, row, |p| bilinear(photograph, p));
                data.extend(mean.unwrap_or([0.0; 3]).map(|v| v.round() as u8));
                valid.push(u8::from(mean.is_some()));
            }
        }
        let image = ImageRgb8::new(self.size, data).expect("three values were pushed per pixel");
        (image, Mask::new(self.size, valid).expect("one value was pushed per pixel"))
    }

    /// A mask in the new image: foreground where at least half of the pixel is.
    pub fn apply_to_mask(&self, mask: &Mask) -> Mask {
        let nearest = |p: DVec2| {
            let x = (p.x as usize).min(self.lens.size.width - 1);
            let y = (p.y as usize).min(self.lens.size.height - 1);
            [f32::from(u8::from(mask.contains(x, y))), 0.0, 0.0]
        };
        let pixels = (0..self.size.pixels()).map(|i| (i % self.size.width, i / self.size.width));
        let covered = |(x, y)| u8::from(self.mean(x, y, nearest).is_some_and(|m| m[0] >= 0.5));
        Mask::new(self.size, pixels.map(covered).collect()).expect("one value per pixel")
    }

    fn mean(&self, column: usize, row: usize, value: impl Fn(DVec2) -> [f32; 3]) -> Option<[f32; 3]> {
        let step = 1.0 / self.samples as f64;
        let mut sum = [0.0; 3];
        for i in 0..self.samples * self.samples {
            let (x, y) = ((i % self.samples) as f64, (i / self.samples) as f64);
            let at = DVec2::new(column as f64 + (x + 0.5) * step, row as f64 + (y + 0.5) * step);
            let found = value(self.source(at)?);
            sum.iter_mut().zip(found).for_each(|(s, v)| *s += v);
        }
        Some(sum.map(|s| s / (self.samples * self.samples) as f32))
    }

    /// # Errors
    /// When even the narrowest view is not filled.
    fn zoom_until_filled(&mut self, reduced: Intrinsics) -> Result<(), String> {
        let (mut low, mut high) = ZOOM;
        self.pinhole = zoomed(reduced, high);
        if !self.is_filled() {
            return Err(format!(
                "{:?} is the distortion of no lens: undistorted, even the middle of the picture, {high} times enlarged, would have a black border",
                self.lens.distortion
            ));
        }
        for _ in 0..40 {
            let middle = f64::midpoint(low, high);
            self.pinhole = zoomed(reduced, middle);
            if self.is_filled() { high = middle } else { low = middle }
        }
        self.pinhole = zoomed(reduced, high);
        Ok(())
    }

    fn is_filled(&self) -> bool {
        let (w, h) = (self.size.width as f64, self.size.height as f64);
        let along = |i: usize| i as f64 / BORDER_SAMPLES as f64;
        (0..=BORDER_SAMPLES).map(along).all(|t| {
            let edges = [(t * w, 0.0), (t * w, h), (0.0, t * h), (w, t * h)];
            edges.into_iter().all(|(x, y)| self.source(DVec2::new(x, y)).is_some())
        })
    }
}

fn zoomed(Intrinsics { fx, fy, cx, cy }: Intrinsics, zoom: f64) -> Intrinsics {
    Intrinsics { fx: fx * zoom, fy: fy * zoom, cx, cy }
}

/// Bilinear value at a continuous position (centres at + 0.5); the border repeats.
fn bilinear(image: &ImageRgb8, p: DVec2) -> [f32; 3] {
    let ImageSize { width, height } = image.size();
    let (x, y) = ((p.x - 0.5).clamp(0.0, (width - 1) as f64), (p.y - 0.5).clamp(0.0, (height - 1) as f64));
    let (left, top) = (x as usize, y as usize);
    let (right, bottom) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
    let (u, v) = ((x - left as f64) as f32, (y - top as f64) as f32);
    let data = image.data();
    let at = |x: usize, y: usize, c: usize| f32::from(data[(y * width + x) * 3 + c]);
    std::array::from_fn(|c| {
        let above = at(left, top, c) * (1.0 - u) + at(right, top, c) * u;
        let below = at(left, bottom, c) * (1.0 - u) + at(right, bottom, c) * u;
        above * (1.0 - v) + below * v
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Distortion;

    const SIZE: ImageSize = ImageSize { width: 96, height: 64 };

    fn lens(distortion: Distortion) -> Lens {
        let intrinsics = Intrinsics { fx: 80.0, fy: 82.0, cx: 50.0, cy: 30.0 };
        Lens { intrinsics, distortion, size: SIZE }
    }

    /// A picture whose value follows the ray: the photograph of a distorted lens, rendered analytically.
    fn photograph(lens: &Lens, distortion_of: impl Fn(DVec2) -> DVec2) -> ImageRgb8 {
        let Intrinsics { fx, fy, cx, cy } = lens.intrinsics;
        let mut data = Vec::new();
        for i in 0..SIZE.pixels() {
            let at = DVec2::new((i % SIZE.width) as f64 + 0.5, (i / SIZE.width) as f64 + 0.5);
            let ray = distortion_of(DVec2::new((at.x - cx) / fx, (at.y - cy) / fy));
            data.extend(
                [128.0 + 150.0 * ray.x, 128.0 + 150.0 * ray.y, 90.0].map(|v| v.clamp(0.0, 255.0) as u8),
            );
        }
        ImageRgb8::new(SIZE, data).unwrap()
    }

    /// Inverts a distortion by fixed point.
    fn undistorted(distortion: Distortion, wanted: DVec2) -> DVec2 {
        (0..200).fold(wanted, |p, _| p + (wanted - distortion.distort(p)) * 0.8)
    }

    #[test]
    fn the_new_image_is_that_of_the_pinhole_it_claims() {
        for distortion in [
            Distortion::opencv(&[-0.2, 0.03, 0.002, -0.001]).unwrap(),
            Distortion::opencv(&[0.1, -0.05, 0.0, 0.003, 0.01]).unwrap(),
            Distortion::fisheye(&[0.02, -0.01, 0.0, 0.0]).unwrap(),
        ] {
            let lens = lens(distortion);
            let map = Undistortion::new(lens, SIZE).unwrap();
            let (image, valid) = map.apply(&photograph(&lens, |p| undistorted(distortion, p)));
            assert_eq!(valid.count(), SIZE.pixels(), "{distortion:?}");
            let Intrinsics { fx, fy, cx, cy } = map.intrinsics();
            for (x, y) in [(5, 7), (48, 32), (90, 60), (10, 50)] {
                let ray = DVec2::new((x as f64 + 0.5 - cx) / fx, (y as f64 + 0.5 - cy) / fy);
                let [r, g, _] = image.pixel(y * SIZE.width + x).map(|v| f64::from(v) * 255.0);
                // One grey level is 0.5 px here; the photograph was rounded down.
                assert!((r - 128.0 - 150.0 * ray.x).abs() < 1.6, "{distortion:?} {x} {y} {r}");
                assert!((g - 128.0 - 150.0 * ray.y).abs() < 1.6, "{distortion:?} {x} {y} {g}");
            }
        }
    }

    #[test]
    fn no_wider_view_would_be_filled() {
        let map = Undistortion::new(lens(Distortion::opencv(&[0.2, 0.0, 0.0, 0.0]).unwrap()), SIZE).unwrap();
        let mut wider = map.clone();
        wider.pinhole = zoomed(map.pinhole, 0.99);
        assert!(map.is_filled() && !wider.is_filled());
    }

    /// The pictures of the former have content everywhere; of the latter not even their middle would.
    #[test]
    fn a_lens_whose_pictures_would_have_a_black_border_is_refused() {
        for k1 in [-0.3, -1.0] {
            let map = Undistortion::new(lens(Distortion::simple_radial(k1, 0.0).unwrap()), SIZE).unwrap();
            let picture = ImageRgb8::new(SIZE, vec![200; SIZE.pixels() * 3]).unwrap();
            let (image, valid) = map.apply(&picture);
            assert_eq!((valid.count(), image), (SIZE.pixels(), picture), "{k1}");
        }
        for distortion in
            [Distortion::simple_radial(-80.0, 0.0), Distortion::fisheye(&[-60.0, 0.0, 0.0, 0.0])]
        {
            let error = Undistortion::new(lens(distortion.unwrap()), SIZE).unwrap_err();
            assert!(error.contains("black border"), "{error}");
        }
    }

    #[test]
    fn a_pinhole_stays_as_it_is() {
        let lens = lens(Distortion::None);
        let picture = photograph(&lens, |p| p);
        let map = Undistortion::new(lens, SIZE).unwrap();
        assert_eq!(map.intrinsics(), lens.intrinsics);
        assert_eq!(map.apply(&picture).0, picture);
    }

    #[test]
    fn half_the_size_is_the_mean_of_four() {
        let size = ImageSize { width: 4, height: 2 };
        let intrinsics = Intrinsics { fx: 5.0, fy: 5.0, cx: 2.0, cy: 1.0 };
        let lens = Lens { intrinsics, distortion: Distortion::None, size };
        let grey = [0_u8, 40, 100, 100, 20, 60, 200, 40].iter().flat_map(|v| [*v; 3]).collect();
        let picture = ImageRgb8::new(size, grey).unwrap();
        let (half, _) = Undistortion::new(lens, ImageSize { width: 2, height: 1 }).unwrap().apply(&picture);
        assert_eq!(half.data(), [30, 30, 30, 110, 110, 110]);
        let mask = Mask::new(size, vec![1, 0, 0, 0, 1, 0, 1, 0]).unwrap();
        let halved = Undistortion::new(lens, ImageSize { width: 2, height: 1 }).unwrap().apply_to_mask(&mask);
        assert_eq!(halved.data(), [1, 0]);
    }
}
