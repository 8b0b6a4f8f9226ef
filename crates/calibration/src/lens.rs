//! Lens distortion: the models of OpenCV and Kannala-Brandt, from a ray to a pixel.

use ffgs_core::{ImageSize, Intrinsics, counted};
use glam::DVec2;

/// How many distortion coefficients OpenCV has.
const COUNTS: [usize; 6] = [0, 4, 5, 8, 12, 14];
/// A lens that moves a pixel by more than this part of the image's width is another lens: ten pixels in full HD, which is more than
/// calibrations of one lens differ by.
const SAME_LENS: f64 = 5e-3;

/// How a lens bends rays, in coordinates of the image plane at depth 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// A pinhole.
    None,
    /// OpenCV's rational Brown-Conrady model with thin prism: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4.
    Brown([f64; 12]),
    /// Kannala-Brandt with four coefficients, OpenCV's `fisheye`: k1 k2 k3 k4.
    Fisheye([f64; 4]),
}

impl Distortion {
    /// OpenCV's `distCoeffs`: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty, in the lengths that OpenCV has (0, 4, 5, 8, 12, 14). In
    /// another length it is not known which number is which.
    ///
    /// # Errors
    /// For another number of values, for values that are not finite, and for a tilted sensor, which no calibration in the
    /// field has.
    pub fn opencv(coefficients: &[f64]) -> Result<Self, String> {
        if !COUNTS.contains(&coefficients.len()) {
            let found = counted(coefficients.len(), "distortion coefficient");
            return Err(format!(
                "{found}; OpenCV has 0, 4, 5, 8, 12 or 14 (k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty): fill up with zeros to one of these"
            ));
        }
        if coefficients.iter().any(|v| !v.is_finite()) {
            return Err(format!("distortion {coefficients:?} is not finite"));
        }
        if coefficients.iter().skip(12).any(|v| *v != 0.0) {
            return Err(format!("distortion {coefficients:?} has a tilted sensor"));
        }
        if coefficients.iter().all(|v| *v == 0.0) {
            return Ok(Self::None);
        }
        Ok(Self::Brown(filled_up(coefficients)))
    }

    /// A lens with radial distortion of low order only: k1, and k2 where there is one.
    ///
    /// # Errors
    /// For values that are not finite.
    pub(crate) fn simple_radial(k1: f64, k2: f64) -> Result<Self, String> {
        Self::opencv(&[k1, k2, 0.0, 0.0])
    }

    /// Kannala-Brandt coefficients, four or none (an equidistant lens).
    ///
    /// # Errors
    /// For another number of values, and for values that are not finite.
    pub(crate) fn fisheye(coefficients: &[f64]) -> Result<Self, String> {
        if ![0, 4].contains(&coefficients.len()) || coefficients.iter().any(|v| !v.is_finite()) {
            return Err(format!(
                "fisheye distortion {coefficients:?} must be four finite numbers (k1 k2 k3 k4), or none"
            ));
        }
        Ok(Self::Fisheye(filled_up(coefficients)))
    }

    /// Where a ray through `p` (at depth 1) meets the image plane after the lens.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        match self {
            Self::None => p,
            Self::Brown(k) => brown(k, p),
            Self::Fisheye(k) => fisheye(k, p),
        }
    }

    /// The largest distance from the axis (at depth 1) up to which the radial part grows. Polynomials fold back beyond
    /// the part of the image that they were fitted to, and would fetch the picture's middle a second time.
    pub(crate) fn valid_radius(&self) -> f64 {
        const STEP: f64 = 1e-3;
        // tan(84 degrees); a wider pinhole image has no use.
        const WIDEST: f64 = 9.5;
        let radius = |r: f64| self.radial(r);
        let steps = (WIDEST / STEP) as usize;
        let folds = |i: &usize| !(radius((*i + 1) as f64 * STEP) > radius(*i as f64 * STEP));
        (0..steps).find(folds).map_or(WIDEST, |i| i as f64 * STEP)
    }

    fn radial(&self, r: f64) -> f64 {
        match self {
            Self::None => r,
            Self::Brown(k) => r * rational(k, r * r),
            Self::Fisheye(_) => self.distort(DVec2::new(r, 0.0)).x,
        }
    }
}

/// The coefficients, then zeros.
fn filled_up<const N: usize>(coefficients: &[f64]) -> [f64; N] {
    let mut all = [0.0; N];
    all.iter_mut().zip(coefficients).for_each(|(a, c)| *a = *c);
    all
}

fn rational(k: &[f64; 12], r2: f64) -> f64 {
    let [k1, k2, _, _, k3, k4, k5, k6, ..] = *k;
    (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
}

/// OpenCV, "Camera Calibration and 3D Reconstruction", the model of `projectPoints` without tilt.
fn brown(k: &[f64; 12], p: DVec2) -> DVec2 {
    let [_, _, p1, p2, _, _, _, _, s1, s2, s3, s4] = *k;
    let r2 = p.length_squared();
    let xy = 2.0 * p.x * p.y;
    let tangential = DVec2::new(
        p1 * xy + p2 * (r2 + 2.0 * p.x * p.x) + r2 * (s1 + r2 * s2),
        p2 * xy + p1 * (r2 + 2.0 * p.y * p.y) + r2 * (s3 + r2 * s4),
    );
    p * rational(k, r2) + tangential
}

/// Kannala and Brandt, TPAMI 2006, equation 6 with odd powers up to 9, as OpenCV's `fisheye`.
fn fisheye(k: &[f64; 4], p: DVec2) -> DVec2 {
    let r = p.length();
    if r < 1e-12 {
        return p;
    }
    let theta = r.atan();
    let t2 = theta * theta;
    let bent = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    p * (bent / r)
}

/// A calibrated lens. The principal point follows the + 0.5 pixel-centre convention.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Focal lengths and principal point (px).
    pub intrinsics: Intrinsics,
    /// Its distortion.
    pub distortion: Distortion,
    /// The size of the images that it was calibrated for.
    pub size: ImageSize,
}

impl Lens {
    /// A lens from a calibration that counts pixels from the centre of the first one (OpenCV's own).
    pub(crate) fn with_integer_centers(
        intrinsics: Intrinsics,
        distortion: Distortion,
        size: ImageSize,
    ) -> Self {
        let Intrinsics { fx, fy, cx, cy } = intrinsics;
        Self { intrinsics: Intrinsics { fx, fy, cx: cx + 0.5, cy: cy + 0.5 }, distortion, size }
    }

    /// Pixel of a ray through `p` (at depth 1).
    pub fn pixel(&self, p: DVec2) -> DVec2 {
        let d = self.distortion.distort(p);
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        DVec2::new(fx * d.x + cx, fy * d.y + cy)
    }

    /// Refuses another lens, such as the same one zoomed: a camera of a [`Footage`](crate::Footage) has one lens for all its pictures.
    ///
    /// # Errors
    /// When `other`, the lens of `picture`, moves a pixel by more than [`SAME_LENS`].
    pub(crate) fn refuse_other(&self, other: &Self, picture: &str) -> Result<(), String> {
        // One that is NaN is refused as a camera, which tells more.
        let is_lens = self.pixel(DVec2::ZERO).is_finite();
        if !is_lens || self == other || (self.size == other.size && self.is_near(other)) {
            return Ok(());
        }
        Err(format!(
            "{picture} has another lens than the first picture: {}, then {}. Footage that is zoomed or refocused cannot be used: take the camera, \
             or the pictures from there on, out of the calibration",
            self.in_words(),
            other.in_words()
        ))
    }

    /// Whether rays to the corners, the edges and the middle meet nearly the same pixels.
    fn is_near(&self, other: &Self) -> bool {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let (w, h) = (self.size.width as f64, self.size.height as f64);
        let places = (0..9).map(|i| DVec2::new(f64::from(i % 3) * w / 2.0, f64::from(i / 3) * h / 2.0));
        let mut rays = places.map(|at| DVec2::new((at.x - cx) / fx, (at.y - cy) / fy));
        rays.all(|ray| self.pixel(ray).distance(other.pixel(ray)) <= SAME_LENS * w)
    }

    fn in_words(&self) -> String {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let ImageSize { width, height } = self.size;
        let bent = match self.distortion {
            Distortion::None => String::new(),
            Distortion::Brown(k) => format!(", distortion {k:?}"),
            Distortion::Fisheye(k) => format!(", fisheye {k:?}"),
        };
        format!("{width} x {height}, focal lengths {fx:.2} {fy:.2} px, principal point {cx:.2} {cy:.2}{bent}")
    }

    /// The same lens behind images of another size.
    #[must_use]
    pub fn resized(&self, size: ImageSize) -> Self {
        let x = size.width as f64 / self.size.width as f64;
        let y = size.height as f64 / self.size.height as f64;
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let intrinsics = Intrinsics { fx: fx * x, fy: fy * y, cx: cx * x, cy: cy * y };
        Self { intrinsics, distortion: self.distortion, size }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distorts_as_written_out_by_hand() {
        let k = [0.1, -0.05, 0.01, -0.02, 0.003, 0.02, 0.01, -0.004, 0.001, 0.002, -0.003, 0.004];
        let (x, y, r2) = (0.4_f64, -0.3_f64, 0.25_f64);
        let radial = (1.0 + 0.1 * r2 - 0.05 * r2.powi(2) + 0.003 * r2.powi(3))
            / (1.0 + 0.02 * r2 + 0.01 * r2.powi(2) - 0.004 * r2.powi(3));
        let wanted = DVec2::new(
            x * radial + 2.0 * 0.01 * x * y - 0.02 * (r2 + 2.0 * x * x) + 0.001 * r2 + 0.002 * r2 * r2,
            y * radial + 0.01 * (r2 + 2.0 * y * y) + 2.0 * -0.02 * x * y - 0.003 * r2 + 0.004 * r2 * r2,
        );
        let found = Distortion::opencv(&k).unwrap().distort(DVec2::new(x, y));
        assert!((found - wanted).length() < 1e-15, "{found} {wanted}");
    }

    #[test]
    fn an_equidistant_fisheye_turns_angles_into_distances() {
        let p = DVec2::new(0.6, 0.8) * 1.3_f64.tan();
        let found = Distortion::fisheye(&[]).unwrap().distort(p);
        assert!((found - DVec2::new(0.6, 0.8) * 1.3).length() < 1e-12);
    }

    #[test]
    fn the_radius_ends_where_the_polynomial_folds() {
        // r (1 - r² / 3) grows up to r = 1.
        let folding = Distortion::simple_radial(-1.0 / 3.0, 0.0).unwrap();
        assert!((folding.valid_radius() - 1.0).abs() < 2e-3);
        assert!(Distortion::None.valid_radius() > 9.0);
    }

    #[test]
    fn what_is_no_distortion_is_refused() {
        assert!(
            Distortion::opencv(&[f64::NAN; 4]).is_err() && Distortion::simple_radial(f64::NAN, 0.0).is_err()
        );
        assert!(Distortion::opencv(&[0.1; 14]).is_err());
        assert!(Distortion::fisheye(&[f64::NAN; 4]).is_err());
        assert_eq!(Distortion::opencv(&[0.0; 5]), Ok(Distortion::None));
    }

    /// k1 k2 k3, as some programs order them, would be read as k1 k2 p1.
    #[test]
    fn only_the_lengths_that_opencv_has_are_read() {
        for count in 0..16 {
            let mut coefficients = vec![0.0; count];
            coefficients.iter_mut().take(12).for_each(|c| *c = 0.01);
            let read = Distortion::opencv(&coefficients);
            assert_eq!(read.is_ok(), COUNTS.contains(&count), "{count}");
            assert_eq!(Distortion::fisheye(&coefficients).is_ok(), [0, 4].contains(&count), "{count}");
        }
        let error = Distortion::opencv(&[0.1; 3]).unwrap_err();
        assert!(error.starts_with("3 distortion coefficients; OpenCV has 0, 4, 5, 8, 12 or 14"), "{error}");
        assert!(Distortion::opencv(&[0.0; 3]).is_err(), "zeros too");
        let radial = [0.1, 0.2, 0.0, 0.0];
        assert_eq!(Distortion::simple_radial(0.1, 0.2), Distortion::opencv(&radial));
        assert_eq!(Distortion::simple_radial(0.0, 0.0), Ok(Distortion::None));
    }

    #[test]
    fn a_zoomed_lens_is_another_one() {
        let size = ImageSize { width: 1920, height: 1080 };
        let of = |focal: f64, k1: f64, cx: f64| Lens {
            intrinsics: Intrinsics { fx: focal, fy: focal, cx, cy: 540.0 },
            distortion: Distortion::simple_radial(k1, 0.0).unwrap(),
            size,
        };
        let first = of(1500.0, -0.1, 960.0);
        let told = |other: &Lens| first.refuse_other(other, "frame 7");
        for same in [first, of(1505.0, -0.1, 960.0), of(1500.0, -0.1, 965.0), of(1500.0, -0.105, 960.0)] {
            assert_eq!(told(&same), Ok(()));
        }
        let nowhere = of(f64::NAN, 0.0, 960.0);
        assert_eq!(
            nowhere.refuse_other(&nowhere, "frame 7"),
            Ok(()),
            "it is no camera, which is told elsewhere"
        );
        let half = first.resized(ImageSize { width: 960, height: 540 });
        for other in
            [of(1530.0, -0.1, 960.0), of(1500.0, -0.1, 975.0), of(1500.0, -0.2, 960.0), nowhere, half]
        {
            let error = told(&other).unwrap_err();
            assert!(
                error.contains("frame 7") && error.contains("focal lengths 1500.00 1500.00 px"),
                "{error}"
            );
        }
        assert!(
            told(&of(1650.0, -0.1, 960.0)).unwrap_err().contains("then 1920 x 1080, focal lengths 1650.00")
        );
    }

    #[test]
    fn half_the_image_is_half_of_everything() {
        let intrinsics = Intrinsics { fx: 100.0, fy: 90.0, cx: 31.5, cy: 23.5 };
        let size = ImageSize { width: 64, height: 48 };
        let lens = Lens::with_integer_centers(intrinsics, Distortion::None, size);
        let half = lens.resized(ImageSize { width: 32, height: 24 });
        assert_eq!(half.intrinsics, Intrinsics { fx: 50.0, fy: 45.0, cx: 16.0, cy: 12.0 });
    }
}
