//! Pinhole cameras: image size, intrinsics, pose, projection and rays (conventions of docs/CONVENTIONS.md).

use glam::{DMat3, DMat4, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Width and height in pixels, both at least 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageSize {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl ImageSize {
    /// Most pixels of an image: the largest sensors that are sold have 1.5e8.
    pub const MAX_PIXELS: usize = 1 << 28;

    /// Number of pixels.
    pub fn pixels(self) -> usize {
        self.width * self.height
    }

    /// How many times as large the image is as one whose longer side has 320 pixels, and no less than once. Lengths in pixels that stand for a share
    /// of the image are multiplied by it.
    pub fn enlargement(self) -> f64 {
        const LONGER_SIDE: f64 = 320.0;
        (self.width.max(self.height) as f64 / LONGER_SIDE).max(1.0)
    }

    /// Number of whole blocks of `factor` pixels along each side; the size itself where a side has none.
    #[must_use]
    pub fn reduced(self, factor: usize) -> Self {
        if factor == 0 || self.width.min(self.height) < factor {
            return self;
        }
        Self { width: self.width / factor, height: self.height / factor }
    }
}

/// Pinhole intrinsics in pixels; the principal point follows the + 0.5 pixel-centre convention.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Horizontal focal length.
    pub fx: f64,
    /// Vertical focal length.
    pub fy: f64,
    /// Principal point, column.
    pub cx: f64,
    /// Principal point, row.
    pub cy: f64,
}

impl Intrinsics {
    /// Geometric mean of the two focal lengths.
    pub fn focal(self) -> f64 {
        (self.fx * self.fy).sqrt()
    }
}

/// Why a camera was refused.
#[derive(Debug, Error, PartialEq)]
pub enum CameraError {
    /// An entry is NaN or infinite.
    #[error("camera holds a value that is not finite")]
    NotFinite,
    /// A focal length is not positive.
    #[error("focal lengths must be positive, found fx = {fx}, fy = {fy}")]
    Focal {
        /// Horizontal focal length.
        fx: f64,
        /// Vertical focal length.
        fy: f64,
    },
    /// The 3x3 block is not a rotation.
    #[error("camera_from_world is not a rigid transform: |R R^T - I| = {error:.2e}, det = {determinant:.3}")]
    NotRigid {
        /// Largest entry of `|R R^T - I|`.
        error: f64,
        /// Determinant of the 3x3 block.
        determinant: f64,
    },
    /// The 3x3 block is a rotation and a mirror image.
    #[error(
        "camera_from_world mirrors the world (its determinant is -1): its axes are left-handed; negate the same column of the rotations \
         of all cameras, and that axis of all points"
    )]
    Mirrored,
    /// A value that no lens and no scene has.
    #[error("{what} of {value:e} is not plausible")]
    Implausible {
        /// What it is of.
        what: &'static str,
        /// The value.
        value: f64,
    },
    /// The image has no pixels, or more than any image.
    #[error("image size {width} x {height} is not of 1 to {} pixels", ImageSize::MAX_PIXELS)]
    ImageSize {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
}

/// A point seen by a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// Continuous pixel coordinates.
    pub pixel: DVec2,
    /// Depth along the camera's z axis (m), positive.
    pub depth: f64,
}

/// A calibrated pinhole camera of one frame. Invariant: finite, positive focal lengths, rigid pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    intrinsics: Intrinsics,
    rotation: DMat3,
    translation: DVec3,
    size: ImageSize,
    /// Pixels of the photograph along a side of a pixel.
    reduction: usize,
}

impl Camera {
    /// Files hold poses as f32 or rounded text; beyond this error the matrix is not a rotation.
    const RIGID_TOLERANCE: f64 = 1e-3;

    /// `camera_from_world` is a 4x4 rigid transform with OpenCV axes (metres).
    ///
    /// # Errors
    /// When a number is not finite, a focal length is not positive, the matrix is no rotation, or the image is empty or too
    /// large.
    pub fn new(
        intrinsics: Intrinsics,
        camera_from_world: DMat4,
        size: ImageSize,
    ) -> Result<Self, CameraError> {
        let Intrinsics { fx, fy, cx, cy } = intrinsics;
        let finite = [fx, fy, cx, cy].iter().all(|v| v.is_finite()) && camera_from_world.is_finite();
        if !finite {
            return Err(CameraError::NotFinite);
        }
        if !(fx > 0.0 && fy > 0.0) {
            return Err(CameraError::Focal { fx, fy });
        }
        let ImageSize { width, height } = size;
        if !width.checked_mul(height).is_some_and(|pixels| (1..=ImageSize::MAX_PIXELS).contains(&pixels)) {
            return Err(CameraError::ImageSize { width, height });
        }
        let rotation = DMat3::from_mat4(camera_from_world);
        let gram = rotation * rotation.transpose() - DMat3::IDENTITY;
        let error = gram.to_cols_array().iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let determinant = rotation.determinant();
        if error <= Self::RIGID_TOLERANCE && determinant < 0.0 {
            return Err(CameraError::Mirrored);
        }
        if !(error <= Self::RIGID_TOLERANCE && determinant > 0.0) {
            return Err(CameraError::NotRigid { error, determinant });
        }
        Ok(Self {
            intrinsics,
            rotation,
            translation: camera_from_world.w_axis.truncate(),
            size,
            reduction: 1,
        })
    }

    /// What is wrong where the principal point lies outside of the image.
    pub fn stray_principal_point(&self) -> Option<String> {
        let (Intrinsics { cx, cy, .. }, ImageSize { width, height }) = (self.intrinsics, self.size);
        // Rounding may put a point on the edge to either side of it.
        let inside = |c: f64, length: usize| (1e-6..1.0 - 1e-6).contains(&(c / length as f64));
        if inside(cx, width) && inside(cy, height) {
            return None;
        }
        let exchanged =
            if inside(cy, width) && inside(cx, height) { "; are cx and cy exchanged?" } else { "" };
        Some(format!(
            "the principal point ({cx:.0}, {cy:.0}) of its {width} x {height} image lies outside or on its edge{exchanged}"
        ))
    }

    /// Pixels of the photograph along a side of a pixel: 1 unless the view was [reduced](Self::reduced).
    pub fn reduction(&self) -> usize {
        self.reduction
    }

    /// The same view with square blocks of `factor` pixels as its pixels; what no whole block holds at the right and at
    /// the bottom is left out. An image with a side of less than `factor` pixels stays as it is.
    #[must_use]
    pub fn reduced(&self, factor: usize) -> Self {
        let size = self.size.reduced(factor);
        if size == self.size {
            return *self;
        }
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|v| v / factor as f64);
        let reduction = self.reduction * factor;
        Self { intrinsics: Intrinsics { fx, fy, cx, cy }, size, reduction, ..*self }
    }

    /// Focal lengths of a lens, in widths (or heights, the larger one) of its image: fields of view from 20 arc seconds
    /// to 179.9 degrees.
    const PLAUSIBLE_FOCAL: std::ops::RangeInclusive<f64> = 1e-3..=1e4;
    /// Principal points, likewise; an image may be a small part of another one.
    const PLAUSIBLE_CENTRE: f64 = 1e4;
    /// Coordinates whose squares, and products of these, are far from the end of `f32`'s range in every unit of length.
    const PLAUSIBLE_COORDINATE: f64 = 1e9;

    /// Refuses what is no number of any lens or scene, such as 1e300: a file that is damaged, not a camera.
    ///
    /// # Errors
    /// When the focal lengths, the principal point or the position are outside the plausible range.
    pub fn check_plausible(&self) -> Result<(), CameraError> {
        let side = self.size.width.max(self.size.height) as f64;
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let focal = |v: f64| Self::PLAUSIBLE_FOCAL.contains(&(v / side));
        let centre = |v: f64| (v / side).abs() <= Self::PLAUSIBLE_CENTRE;
        let coordinate = |v: f64| v.abs() <= Self::PLAUSIBLE_COORDINATE;
        let translation = self.translation.to_array();
        let lens = [("a focal length", fx, focal(fx)), ("a focal length", fy, focal(fy))];
        let centres = [("a principal point", cx, centre(cx)), ("a principal point", cy, centre(cy))];
        let pose = translation.map(|t| ("a translation", t, coordinate(t)));
        let mut all = lens.into_iter().chain(centres).chain(pose);
        match all.find(|(_, _, plausible)| !plausible) {
            Some((what, value, _)) => Err(CameraError::Implausible { what, value }),
            None => Ok(()),
        }
    }

    /// Intrinsics in pixels.
    pub fn intrinsics(&self) -> Intrinsics {
        self.intrinsics
    }

    /// Rotation of `camera_from_world`.
    pub fn rotation(&self) -> DMat3 {
        self.rotation
    }

    /// Translation of `camera_from_world` (m).
    pub fn translation(&self) -> DVec3 {
        self.translation
    }

    /// `camera_from_world` as a 4x4 matrix.
    pub fn camera_from_world(&self) -> DMat4 {
        let mut m = DMat4::from_mat3(self.rotation);
        m.w_axis = self.translation.extend(1.0);
        m
    }

    /// Image size in pixels.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Camera centre in world coordinates (m).
    pub fn center(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// The same camera in a world whose origin is at `origin` of this one (m).
    #[must_use]
    pub fn relative_to(&self, origin: DVec3) -> Self {
        Self { translation: self.translation + self.rotation * origin, ..*self }
    }

    /// Projects a world point; `None` when it is not in front of the camera.
    pub fn project(&self, point_in_world: DVec3) -> Option<Projection> {
        let p = self.rotation * point_in_world + self.translation;
        if !(p.z > 0.0) {
            return None;
        }
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        Some(Projection { pixel: DVec2::new(fx * p.x / p.z + cx, fy * p.y / p.z + cy), depth: p.z })
    }

    /// Derivative of the pixel by the world point, a row for each coordinate (px/m); `None` when the point is not in
    /// front of the camera.
    pub fn pixel_derivative(&self, point_in_world: DVec3) -> Option<[DVec3; 2]> {
        let p = self.rotation * point_in_world + self.translation;
        if !(p.z > 0.0) {
            return None;
        }
        let (Intrinsics { fx, fy, .. }, to_world) = (self.intrinsics, self.rotation.transpose());
        let along = |f: DVec3| to_world * f / p.z;
        Some([along(DVec3::new(fx, 0.0, -fx * p.x / p.z)), along(DVec3::new(0.0, fy, -fy * p.y / p.z))])
    }

    /// Column and row of the pixel a world point falls in; `None` behind the camera or outside the image.
    pub fn pixel_of(&self, point_in_world: DVec3) -> Option<(usize, usize)> {
        let Projection { pixel, .. } = self.project(point_in_world)?;
        self.shows(pixel).then_some((pixel.x as usize, pixel.y as usize))
    }

    /// Whether a pixel position lies in the image.
    pub fn shows(&self, pixel: DVec2) -> bool {
        let (width, height) = (self.size.width as f64, self.size.height as f64);
        pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < width && pixel.y < height
    }

    /// Unit viewing ray through a pixel, in world coordinates.
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let in_camera = DVec3::new((pixel.x - cx) / fx, (pixel.y - cy) / fy, 1.0);
        (self.rotation.transpose() * in_camera).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(camera_from_world: DMat4) -> Result<Camera, CameraError> {
        let intrinsics = Intrinsics { fx: 100.0, fy: 120.0, cx: 33.0, cy: 20.5 };
        Camera::new(intrinsics, camera_from_world, ImageSize { width: 64, height: 48 })
    }

    #[test]
    fn the_ray_of_a_projection_points_back_at_the_point() {
        let pose = DMat4::from_euler(glam::EulerRot::XYZ, 0.3, -0.2, 0.1);
        let camera = camera(DMat4::from_translation(DVec3::new(0.1, 0.2, 0.3)) * pose).unwrap();
        let point = camera.center() + camera.rotation().transpose() * DVec3::new(0.4, -0.3, 2.0);
        let projection = camera.project(point).unwrap();
        let back = camera.center() + camera.ray(projection.pixel) * (point - camera.center()).length();
        assert!((back - point).length() < 1e-12);
        assert!((projection.depth - 2.0).abs() < 1e-12);
    }

    #[test]
    fn the_derivative_of_the_pixel_is_that_of_finite_differences() {
        let pose = DMat4::from_euler(glam::EulerRot::XYZ, 0.3, -0.2, 0.1);
        let camera = camera(DMat4::from_translation(DVec3::new(0.1, 0.2, 3.0)) * pose).unwrap();
        let (place, step) = (DVec3::new(0.4, -0.3, 0.6), 1e-6);
        let pixel = |p: DVec3| camera.project(p).unwrap().pixel;
        let rows = camera.pixel_derivative(place).unwrap();
        for axis in DVec3::AXES {
            let change = (pixel(place + axis * step) - pixel(place - axis * step)) / (2.0 * step);
            let told = DVec2::new(rows[0].dot(axis), rows[1].dot(axis));
            assert!((change - told).length() < 1e-7 * told.length().max(1.0));
        }
        let behind = camera.center() - camera.rotation().transpose() * DVec3::Z;
        assert!(camera.pixel_derivative(behind).is_none());
    }

    #[test]
    fn numbers_that_no_camera_has_are_implausible() {
        let size = ImageSize { width: 480, height: 240 };
        let check = |fx: f64, cx: f64, x: f64| {
            let pose = DMat4::from_translation(DVec3::new(x, 0.0, 0.0));
            Camera::new(Intrinsics { fx, fy: 8020.0, cx, cy: 120.0 }, pose, size).unwrap().check_plausible()
        };
        assert_eq!(check(8020.0, -900.0, 5e6), Ok(()), "a long lens, cropped, in UTM coordinates");
        for (fx, cx, x) in [(1e300, 0.0, 0.0), (1e-300, 0.0, 0.0), (500.0, -1e300, 0.0), (500.0, 0.0, 1e300)]
        {
            assert!(matches!(check(fx, cx, x), Err(CameraError::Implausible { .. })), "{fx} {cx} {x}");
        }
    }

    #[test]
    fn refuses_sizes_of_no_image() {
        let intrinsics = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 };
        let of = |width, height| Camera::new(intrinsics, DMat4::IDENTITY, ImageSize { width, height });
        assert!(of(1, 1).is_ok() && of(1 << 14, 1 << 14).is_ok());
        for (width, height) in
            [(0, 5), (5, 0), (1 << 14, 1 + (1 << 14)), (32, usize::MAX), (1 << 33, 1 << 33)]
        {
            assert_eq!(of(width, height), Err(CameraError::ImageSize { width, height }));
        }
    }

    #[test]
    fn refuses_what_is_not_a_camera() {
        let mut mirrored = DMat4::IDENTITY;
        mirrored.x_axis.x = -1.0;
        assert_eq!(camera(mirrored), Err(CameraError::Mirrored));
        assert!(matches!(camera(DMat4::from_scale(DVec3::splat(2.0))), Err(CameraError::NotRigid { .. })));
        assert_eq!(camera(DMat4::from_translation(DVec3::NAN)), Err(CameraError::NotFinite));
        assert!(camera(DMat4::IDENTITY).unwrap().project(DVec3::new(0.0, 0.0, -1.0)).is_none());
    }

    #[test]
    fn a_principal_point_outside_is_told_and_whether_it_is_exchanged() {
        let size = ImageSize { width: 384, height: 192 };
        let of = |cx: f64, cy: f64| {
            let intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx, cy };
            Camera::new(intrinsics, DMat4::IDENTITY, size).unwrap().stray_principal_point()
        };
        assert_eq!([of(192.0, 96.0), of(10.0, 180.0)], [None, None]);
        assert!(of(96.0, 192.0).unwrap().ends_with("are cx and cy exchanged?"));
        let far = of(800.0, 400.0).unwrap();
        assert!(far.contains("(800, 400) of its 384 x 192 image") && !far.contains("exchanged"), "{far}");
    }
}
