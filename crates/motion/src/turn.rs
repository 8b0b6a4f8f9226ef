//! Turns splats, and the directions of their colour, with the body that they sit on.

use crate::Rotate;
use ffgs_core::Gaussians;
use glam::{DQuat, DVec3};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::LazyLock;

/// Turns every Gaussian by its rotation, as far as `rotate` says.
pub(crate) fn turn(gaussians: &mut Gaussians, rotations: &[DQuat], rotate: Rotate) {
    if rotate == Rotate::Nothing {
        return;
    }
    gaussians.quats.par_iter_mut().zip(rotations).for_each(|(q, &r)| *q = turned(r, *q));
    if rotate == Rotate::SplatAndColour && gaussians.sh_degree() > 0 {
        let (degree, stride) = (gaussians.sh_degree(), gaussians.sh_stride());
        let sh = gaussians.sh.par_chunks_mut(stride * CHUNK).zip(rotations.par_chunks(CHUNK));
        sh.for_each(|(sh, rotations)| turn_colours(sh, rotations, degree));
    }
}

/// A quaternion (w, x, y, z) turned.
pub fn turned(rotation: DQuat, [w, x, y, z]: [f32; 4]) -> [f32; 4] {
    let q = rotation.as_quat() * glam::Quat::from_xyzw(x, y, z, w);
    [q.w, q.x, q.y, q.z]
}

/// Gaussians handled at a time, by one thread.
const CHUNK: usize = 1024;
/// Matrices kept in a chunk: those of the groups that its Gaussians belong to in turn.
const KEPT: usize = 8;
/// Most basis functions: degree 3.
const BASIS: usize = 16;
type Bands = SMatrix<f64, BASIS, BASIS>;
/// Coefficients of each degree; a turn does not mix them.
const BANDS: [Range<usize>; 4] = [0..1, 1..4, 4..9, 9..16];

fn turn_colours(sh: &mut [[f32; 3]], rotations: &[DQuat], degree: usize) {
    let stride = (degree + 1) * (degree + 1);
    let mut kept: VecDeque<(DQuat, Bands)> = VecDeque::with_capacity(KEPT);
    for (coefficients, &rotation) in sh.chunks_exact_mut(stride).zip(rotations) {
        let at = kept.iter().position(|k| k.0 == rotation).unwrap_or_else(|| {
            kept.truncate(KEPT - 1);
            kept.push_front((rotation, band_matrix(rotation)));
            0
        });
        for band in &BANDS[..=degree] {
            turn_band(&mut coefficients[band.clone()], &kept[at].1, band.start);
        }
    }
}

/// Turns the coefficients of one degree, which begin at `start`.
fn turn_band(coefficients: &mut [[f32; 3]], matrix: &Bands, start: usize) {
    let mut before = [[0.0; 3]; BASIS];
    before.iter_mut().zip(&*coefficients).for_each(|(b, c)| *b = c.map(f64::from));
    let count = coefficients.len();
    for (row, out) in coefficients.iter_mut().enumerate() {
        let mut sum = [0.0; 3];
        for (column, value) in before[..count].iter().enumerate() {
            let m = matrix[(start + row, start + column)];
            (0..3).for_each(|channel| sum[channel] += m * value[channel]);
        }
        *out = sum.map(|v| v as f32);
    }
}

/// The matrix that takes the coefficients of a colour c(d) to those of c(R^-1 d).
///
/// Both are compared at directions that fix all coefficients; bands do not mix, so lower degrees are its corner.
fn band_matrix(rotation: DQuat) -> Bands {
    let back = rotation.inverse();
    DIRECTIONS.iter().fold(Bands::zeros(), |sum, (d, dual)| sum + dual * basis(back * *d).transpose())
}

/// Directions, each with the coefficients that a value there adds to a least-squares fit of all.
static DIRECTIONS: LazyLock<Vec<(DVec3, SVector<f64, BASIS>)>> = LazyLock::new(|| {
    let gram = directions().map(basis).fold(Bands::zeros(), |sum, b| sum + b * b.transpose());
    // The directions are constant and spread over the sphere: the Gram matrix is well conditioned.
    let inverse = gram.cholesky().map_or_else(Bands::identity, |g| g.inverse());
    directions().map(|d| (d, inverse * basis(d))).collect()
});

/// Points spread evenly over the sphere (Fibonacci lattice).
fn directions() -> impl Iterator<Item = DVec3> {
    const COUNT: usize = 48;
    const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
    (0..COUNT).map(|i| {
        let z = 1.0 - (2 * i + 1) as f64 / COUNT as f64;
        let (sin, cos) = (i as f64 * GOLDEN_ANGLE).sin_cos();
        DVec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
    })
}

/// Basis of 3D Gaussian Splatting up to degree 3, up to positive factors: a factor per band does not change the matrix,
/// factors within a band are kept.
fn basis(d: DVec3) -> SVector<f64, BASIS> {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (r3, r6, r10, r15) = (3_f64.sqrt(), 6_f64.sqrt(), 10_f64.sqrt(), 15_f64.sqrt());
    SVector::from([
        1.0,
        -y,
        z,
        -x,
        r3 * x * y,
        -r3 * y * z,
        0.5 * (2.0 * zz - xx - yy),
        -r3 * x * z,
        0.5 * r3 * (xx - yy),
        -0.25 * r10 * y * (3.0 * xx - yy),
        r15 * x * y * z,
        -0.25 * r6 * y * (4.0 * zz - xx - yy),
        0.5 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.25 * r6 * x * (4.0 * zz - xx - yy),
        0.5 * r15 * z * (xx - yy),
        -0.25 * r10 * x * (xx - 3.0 * yy),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageSize, Intrinsics};
    use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
    use glam::{DMat3, DMat4};

    /// A camera that turns with the scene sees the same picture.
    #[test]
    fn turning_scene_and_camera_together_changes_nothing() {
        let mut scene = Gaussians::zeros(3, 3);
        for i in 0..3 {
            scene.means[i] = [0.3 * i as f32 - 0.3, 0.1 * i as f32, 0.2 + 0.1 * i as f32];
            scene.quats[i] = [1.0, 0.2 * i as f32, -0.3, 0.1];
            scene.log_scales[i] = [-2.0, -2.5, -1.5];
            scene.opacity_logits[i] = 1.0;
        }
        for (k, value) in scene.sh.as_flattened_mut().iter_mut().enumerate() {
            *value = 0.3 * (k as f32 * 1.7).sin();
        }
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.7, -1.1, 0.4);
        let mut moved = scene.clone();
        for mean in &mut moved.means {
            *mean = (rotation.as_quat() * glam::Vec3::from(*mean)).to_array();
        }
        turn(&mut moved, &[rotation; 3], Rotate::SplatAndColour);
        let pose = DMat4::from_translation(DVec3::new(0.0, 0.0, 3.0));
        let follow = pose * DMat4::from_mat3(DMat3::from_quat(rotation.inverse()));
        let (before, after) = (picture(&scene, pose), picture(&moved, follow));
        let largest = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(largest < 1e-4, "{largest}");
        assert!(before.iter().any(|v| *v > 0.2), "something is seen");
        let mut still = scene.clone();
        still.means.clone_from(&moved.means);
        turn(&mut still, &[rotation; 3], Rotate::Splat);
        let unturned = picture(&still, follow);
        assert!(before.iter().zip(&unturned).any(|(a, b)| (a - b).abs() > 0.02), "the colours matter");
    }

    fn picture(scene: &Gaussians, pose: DMat4) -> Vec<f32> {
        let size = ImageSize { width: 48, height: 32 };
        let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 24.0, cy: 16.0 };
        let camera = Camera::new(intrinsics, pose, size).unwrap();
        let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
        let mut tape = RenderTape::default();
        CpuRasterizer::default().render(scene, &view, &mut tape);
        (0..3).flat_map(|c| tape.image().plane(c).to_vec()).collect()
    }
}
