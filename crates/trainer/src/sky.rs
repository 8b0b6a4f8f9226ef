//! What a camera sees of the sky cube, bilinear, and the gradient by its texels.
//!
//! Bilinear weights are clamped at the edge of a face: colour is constant over the outer half texel, and no texel is
//! shared by two faces.

use crate::constants::MIN_THROUGH;
use crate::texel_gradients::TexelGradients;
use ffgs_core::kernel::{Kernel, dispatch};
use ffgs_core::{Camera, ImageSize, PlanarImage, SkyCube};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Pixels of one parallel task.
const CHUNK: usize = 4096;
/// How many open pixels it takes to move a texel at half its rate, each weighted by the square of its transmittance. Adam
/// divides a derivative by its own size: without this a texel behind an opaque wall would move as fast as one in the open.
pub const SKY_DOUBT: f32 = 0.1;
/// Likewise in the sky lane, whose loss is half the squared error: an expected error of 0.05 at each of these pixels.
pub const SKY_LANE_DOUBT: f32 = SKY_DOUBT * 0.05;

/// How much the error of a pixel is the sky's: the transmittance once more, and nothing where little shows through.
pub(crate) fn sky_share(transmittance: f32) -> f32 {
    if transmittance < MIN_THROUGH { 0.0 } else { transmittance }
}

/// Where a pixel's ray meets the cube: the first of four neighbouring texels, and how far the ray lies beyond its centre.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sample {
    first: u32,
    right: f32,
    below: f32,
}

impl Sample {
    fn colour(&self, cube: &SkyCube) -> [f32; 3] {
        let mut sum = Vec3::ZERO;
        for (texel, weight) in self.shares(cube.face_size()) {
            sum += weight * Vec3::from(cube.texels[texel]);
        }
        sum.to_array()
    }

    /// The four texels and their weights, which sum to 1.
    #[inline(always)]
    fn shares(&self, face_size: usize) -> [(usize, f32); 4] {
        let Self { right, below, .. } = *self;
        let first = self.first as usize;
        let (column, row) = if face_size > 1 { (1, face_size) } else { (0, 0) };
        [
            (first, (1.0 - below) * (1.0 - right)),
            (first + column, (1.0 - below) * right),
            (first + row, below * (1.0 - right)),
            (first + row + column, below * right),
        ]
    }
}

/// What a camera sees of a sky: sRGB, 0..=1.
pub fn sky_picture(sky: &SkyCube, camera: &Camera) -> PlanarImage {
    let mut picture = PlanarImage::zeros(camera.size());
    SkyView::new(camera, sky.face_size()).render(sky, &mut picture);
    picture
}

/// Which texels every pixel of a camera sees: 12 bytes per pixel. Depends on the camera's rotation only, and is made anew
/// for each view in a fraction of a render: keep one and aim it.
#[derive(Clone, Debug, PartialEq)]
pub struct SkyView {
    size: ImageSize,
    face_size: usize,
    samples: Vec<Sample>,
}

impl SkyView {
    /// Traces the ray through every pixel centre.
    pub fn new(camera: &Camera, face_size: usize) -> Self {
        let mut out = Self { size: camera.size(), face_size, samples: Vec::new() };
        out.aim(camera);
        out
    }

    /// Replaces the camera; allocates only for a larger image.
    pub(crate) fn aim(&mut self, camera: &Camera) {
        self.size = camera.size();
        self.samples.resize(self.size.pixels(), Sample::default());
        let (rays, face_size) = (Rays::new(camera), self.face_size);
        let rows = self.samples.par_chunks_mut(self.size.width.max(1)).enumerate();
        rows.for_each(|(y, samples)| dispatch(AimRow { rays: &rays, face_size, y, samples }));
    }

    /// Image size.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Draws what the camera sees of `cube`.
    ///
    /// # Panics
    /// When this was made for another face size.
    pub fn render(&self, cube: &SkyCube, out: &mut PlanarImage) {
        assert_eq!(self.face_size, cube.face_size(), "face size");
        if out.size() != self.size {
            out.reset(self.size);
        }
        let (red, rest) = out.data_mut().split_at_mut(self.size.pixels());
        let (green, blue) = rest.split_at_mut(self.size.pixels());
        red.par_chunks_mut(CHUNK)
            .zip(green.par_chunks_mut(CHUNK))
            .zip(blue.par_chunks_mut(CHUNK))
            .zip(self.samples.par_chunks(CHUNK))
            .for_each(|(((red, green), blue), samples)| {
                for (i, sample) in samples.iter().enumerate() {
                    [red[i], green[i], blue[i]] = sample.colour(cube);
                }
            });
    }

    /// Adds the gradient by the texels to `out` (of 6 * `face_size`^2 texels), given that by each pixel of [`SkyView::render`]
    /// (that by the composite times the transmittance).
    ///
    /// # Panics
    /// When the number of texels does not match.
    pub fn backward(&self, gradient: impl Fn(usize) -> Vec3 + Sync, out: &mut TexelGradients) {
        assert_eq!(out.sums.len(), 6 * self.face_size * self.face_size, "texels");
        let shares = |pixel: usize| self.samples[pixel].shares(self.face_size);
        out.add(self.samples.len(), gradient, shares);
    }
}

/// Viewing rays of a camera in world axes, linear in the pixel; not of unit length.
struct Rays {
    first: Vec3,
    right: Vec3,
    down: Vec3,
}

impl Rays {
    fn new(camera: &Camera) -> Self {
        let (k, back) = (camera.intrinsics(), camera.rotation().transpose());
        let first = back * DVec3::new((0.5 - k.cx) / k.fx, (0.5 - k.cy) / k.fy, 1.0);
        Self {
            first: first.as_vec3(),
            right: (back.x_axis / k.fx).as_vec3(),
            down: (back.y_axis / k.fy).as_vec3(),
        }
    }

    /// Through the centre of a pixel.
    #[inline(always)]
    fn through(&self, column: usize, row: usize) -> Vec3 {
        self.first + column as f32 * self.right + row as f32 * self.down
    }
}

/// One row of [`SkyView::aim`].
struct AimRow<'a> {
    rays: &'a Rays,
    face_size: usize,
    y: usize,
    samples: &'a mut [Sample],
}

impl Kernel for AimRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FMA: bool>(self) {
        for (x, out) in self.samples.iter_mut().enumerate() {
            *out = sample(self.rays.through(x, self.y), self.face_size);
        }
    }
}

/// Where a ray meets a cube.
#[inline(always)]
fn sample(ray: Vec3, face_size: usize) -> Sample {
    let (face, last) = (face_size as f32, face_size.saturating_sub(2) as f32);
    let (number, s, t) = face_coordinates(ray);
    let (column, right) = between_texels(s, face, last);
    let (row, below) = between_texels(t, face, last);
    // Below 2^24 texels a float counts exactly, and its conversion is one instruction for a whole vector.
    Sample { first: ((number * face + row) * face + column) as i32 as u32, right, below }
}

/// Lower of the two texels that `s` (-1..=1 across a face of `size`) lies between, at most `last`, and how far beyond
/// its centre.
#[inline(always)]
fn between_texels(s: f32, size: f32, last: f32) -> (f32, f32) {
    let position = ((0.5 * s + 0.5) * size - 0.5).max(0.0).min(size - 1.0);
    let low = position.floor().min(last);
    (low, position - low)
}

/// Face, and coordinates on it in -1..=1 (OpenGL 4.6 specification, table 8.19). Selects and no branches, so that the
/// loop over a row is vectorised.
#[allow(
    clippy::needless_bitwise_bool,
    reason = "a lazy operator is a branch, and a branch keeps the loop from being vectorised"
)]
#[inline(always)]
fn face_coordinates(d: Vec3) -> (f32, f32, f32) {
    let size = d.abs();
    let along_x = (size.x >= size.y) & (size.x >= size.z);
    let along_y = size.y >= size.z;
    let pick = |x: f32, y: f32, z: f32| {
        let other = if along_y { y } else { z };
        if along_x { x } else { other }
    };
    let major = pick(d.x, d.y, d.z);
    let sign = if major > 0.0 { 1.0 } else { -1.0 };
    let inverse = 1.0 / major.abs();
    let face = pick(0.0, 2.0, 4.0) + if major > 0.0 { 0.0 } else { 1.0 };
    (face, pick(-d.z * sign, d.x, d.x * sign) * inverse, pick(-d.y, d.z * sign, -d.y) * inverse)
}

/// Unit direction through the centre of a texel; the inverse of [`face_coordinates`].
pub(crate) fn texel_direction(face_size: usize, texel: usize) -> Vec3 {
    let coordinate = |i: usize| (i as f32 + 0.5) / face_size as f32 * 2.0 - 1.0;
    let (s, t) = (coordinate(texel % face_size), coordinate(texel / face_size % face_size));
    let direction = match texel / (face_size * face_size) {
        0 => Vec3::new(1.0, -t, -s),
        1 => Vec3::new(-1.0, -t, s),
        2 => Vec3::new(s, 1.0, t),
        3 => Vec3::new(s, -1.0, -t),
        4 => Vec3::new(s, -t, 1.0),
        _ => Vec3::new(-s, -t, -1.0),
    };
    direction.normalize()
}

/// The colour of a cube in a direction, bilinear.
pub(crate) fn sky_colour(cube: &SkyCube, direction: Vec3) -> [f32; 3] {
    sample(direction, cube.face_size()).colour(cube)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::Intrinsics;
    use glam::{DMat4, DVec2, EulerRot};

    const SIZE: ImageSize = ImageSize { width: 48, height: 32 };

    fn camera(yaw: f64, pitch: f64) -> Camera {
        let intrinsics = Intrinsics { fx: 20.0, fy: 22.0, cx: 23.0, cy: 17.0 };
        Camera::new(intrinsics, DMat4::from_euler(EulerRot::XYZ, pitch, yaw, 0.2), SIZE).unwrap()
    }

    fn cameras() -> Vec<Camera> {
        let angles = [(0.0, 0.0), (1.5, 0.1), (3.1, -0.3), (4.5, 0.0), (0.3, 1.5), (0.9, -1.4)];
        angles.map(|(yaw, pitch)| camera(yaw, pitch)).to_vec()
    }

    /// A smooth colour in 0.2..0.8.
    fn colour(d: Vec3) -> [f32; 3] {
        (0.5 + 0.3 * d).to_array()
    }

    fn painted(face_size: usize) -> SkyCube {
        let mut cube = SkyCube::filled(face_size, [0.5; 3]);
        for (i, texel) in cube.texels.iter_mut().enumerate() {
            *texel = colour(texel_direction(face_size, i));
        }
        cube
    }

    #[test]
    fn renders_a_known_function_in_every_direction() {
        let cube = painted(64);
        let mut image = PlanarImage::zeros(SIZE);
        for camera in cameras() {
            SkyView::new(&camera, 64).render(&cube, &mut image);
            for i in 0..SIZE.pixels() {
                let centre = DVec2::new((i % 48) as f64 + 0.5, (i / 48) as f64 + 0.5);
                let want = colour(camera.ray(centre).as_vec3());
                // Half a texel at an edge: 1/64 of a unit of direction times the slope 0.3.
                let error = (Vec3::from(image.pixel(i)) - Vec3::from(want)).abs().max_element();
                assert!(error < 0.3 / 64.0, "pixel {i}: {error}");
            }
        }
    }

    #[test]
    fn the_gradient_matches_finite_differences() {
        let view = SkyView::new(&camera(0.8, 0.3), 8);
        let mut cube = painted(8);
        let mut weights = PlanarImage::zeros(SIZE);
        weights.data_mut().iter_mut().enumerate().for_each(|(i, w)| *w = (i as f32 * 0.37).sin());
        let mut gradient = TexelGradients::new(cube.texels.len());
        view.backward(|pixel| weights.pixel(pixel).into(), &mut gradient);
        let mut image = PlanarImage::zeros(SIZE);
        let mut objective = |cube: &SkyCube| -> f64 {
            view.render(cube, &mut image);
            image.data().iter().zip(weights.data()).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        for t in (0..cube.texels.len()).step_by(7) {
            let before = objective(&cube);
            cube.texels[t][1] += 1.0;
            let difference = objective(&cube) - before;
            cube.texels[t][1] -= 1.0;
            assert!((difference - f64::from(gradient.sums[t][1])).abs() < 1e-4, "texel {t}");
            assert_eq!(gradient.touched[t], gradient.sums[t] != [0.0; 3], "texel {t}");
        }
    }
}
