//! Gaussians whose centres lie outside the image and that reach into it, against rays through the Gaussians themselves and
//! against finite differences.

use ffgs_core::{Camera, Gaussians, ImageSize, Intrinsics, PlanarImage, logit};
use ffgs_rasterizer::{
    Background, CpuRasterizer, Gradients, PixelGradients, RenderOptions, RenderTape, View,
};
use glam::{DMat3, DMat4, DQuat, DVec3};

const SIZE: ImageSize = ImageSize { width: 96, height: 64 };
const FOCAL: f64 = 80.0;
const OPACITY: f32 = 0.8;

/// Turned and moved, so that camera and world axes differ.
fn camera() -> Camera {
    let intrinsics = Intrinsics { fx: FOCAL, fy: FOCAL, cx: 48.0, cy: 32.0 };
    let pose = DMat4::from_rotation_y(0.3) * DMat4::from_rotation_x(-0.2);
    Camera::new(intrinsics, pose * DMat4::from_translation(DVec3::new(3.0, -1.0, 7.0)), SIZE).unwrap()
}

/// A Gaussian in the camera's axes.
struct Beside {
    centre: DVec3,
    turn: DQuat,
    deviations: DVec3,
}

impl Beside {
    /// With its longest axis along `direction`.
    fn along(direction: DVec3, centre: DVec3, deviations: DVec3) -> Self {
        Self { centre, turn: DQuat::from_rotation_arc(DVec3::Z, direction.normalize()), deviations }
    }

    /// Largest value on the part of a pixel's ray before the camera, over the Gaussian's largest.
    fn along_ray(&self, pixel: [f64; 2]) -> f64 {
        let ray = DVec3::new((pixel[0] - 48.0) / FOCAL, (pixel[1] - 32.0) / FOCAL, 1.0);
        let scaled = DMat3::from_diagonal(self.deviations.recip()) * DMat3::from_quat(self.turn).transpose();
        let (d, t) = (scaled * ray, scaled * self.centre);
        let s = (d.dot(t) / d.length_squared()).max(0.0);
        (-0.5 * (d * s - t).length_squared()).exp()
    }

    /// The same by a projection that is linear around the centre, its slopes held within 1.3 times the image's (3DGS).
    fn linear_at_centre(&self, pixel: [f64; 2]) -> f64 {
        let t = self.centre;
        let [x, y] =
            [(t.x / t.z, 48.0), (t.y / t.z, 32.0)].map(|(s, c)| s.clamp(-1.3 * c / FOCAL, 1.3 * c / FOCAL));
        let f = FOCAL / t.z;
        let rotation = DMat3::from_quat(self.turn) * DMat3::from_diagonal(self.deviations);
        let rows = [DVec3::new(f, 0.0, -f * x), DVec3::new(0.0, f, -f * y)].map(|r| rotation.transpose() * r);
        let [a, b, c] = [rows[0].dot(rows[0]) + 0.3, rows[0].dot(rows[1]), rows[1].dot(rows[1]) + 0.3];
        let d = [pixel[0] - 48.0 - f * t.x, pixel[1] - 32.0 - f * t.y];
        let squared = (c * d[0] * d[0] - 2.0 * b * d[0] * d[1] + a * d[1] * d[1]) / (a * c - b * b);
        (-0.5 * squared).exp()
    }
}

/// Kerbs and rails that begin beside the camera and run into the image, with these standard deviations across them (m).
fn kerbs([narrow, wide]: [f64; 2]) -> Vec<Beside> {
    vec![
        Beside::along(DVec3::Z, DVec3::new(0.9, 0.3, 0.4), DVec3::new(narrow, wide, 1.5)),
        Beside::along(DVec3::new(0.3, 0.1, 1.0), DVec3::new(-1.0, -0.2, 0.5), DVec3::new(narrow, wide, 1.5)),
        Beside::along(DVec3::new(0.1, -0.2, 1.0), DVec3::new(0.2, 0.8, 0.4), DVec3::new(wide, narrow, 1.2)),
        Beside::along(DVec3::new(0.0, 0.2, 1.0), DVec3::new(-0.3, -0.8, 0.3), DVec3::new(wide, narrow, 1.8)),
    ]
}

fn gaussians(shapes: &[Beside]) -> Gaussians {
    let camera = camera();
    let to_world = camera.rotation().transpose();
    let mut out = Gaussians::zeros(shapes.len(), 0);
    for (i, shape) in shapes.iter().enumerate() {
        out.means[i] = (camera.center() + to_world * shape.centre).as_vec3().to_array();
        let q = (DQuat::from_mat3(&to_world) * shape.turn).as_quat();
        out.quats[i] = [q.w, q.x, q.y, q.z];
        out.log_scales[i] = shape.deviations.as_vec3().to_array().map(f32::ln);
        out.opacity_logits[i] = logit(OPACITY);
        out.sh[i] = [0.4 * i as f32, 0.7, -0.3];
    }
    out
}

fn render(g: &Gaussians) -> RenderTape {
    render_from(&camera(), g)
}

fn render_from(camera: &Camera, g: &Gaussians) -> RenderTape {
    let mut tape = RenderTape::default();
    CpuRasterizer::default().render(g, &view(camera), &mut tape);
    tape
}

fn view(camera: &Camera) -> View<'_> {
    View { camera, background: Background::Colour([0.2, 0.9, 0.5]), tiles: None }
}

fn pixels() -> impl Iterator<Item = [f64; 2]> {
    (0..SIZE.pixels()).map(|p| [(p % SIZE.width) as f64 + 0.5, (p / SIZE.width) as f64 + 0.5])
}

/// Mean difference of two images of opacities.
fn difference(a: impl Iterator<Item = f64>, b: impl Iterator<Item = f64>) -> f64 {
    let sum: f64 = a.zip(b).map(|(a, b)| (a - b).abs()).sum();
    assert!(sum.is_finite());
    sum / SIZE.pixels() as f64
}

#[test]
fn what_lies_beside_the_camera_is_as_wide_as_where_it_is_seen() {
    for (i, shape) in kerbs([0.1, 0.15]).iter().enumerate() {
        let tape = render(&gaussians(std::slice::from_ref(shape)));
        let truth = || pixels().map(|p| f64::from(OPACITY) * shape.along_ray(p));
        let error = difference(tape.transmittance().iter().map(|t| 1.0 - f64::from(*t)), truth());
        let at_centre = difference(pixels().map(|p| f64::from(OPACITY) * shape.linear_at_centre(p)), truth());
        let shown = truth().sum::<f64>() / SIZE.pixels() as f64;
        println!("{i}: shown {shown:.4}, error {error:.4}, linear at the centre {at_centre:.4}");
        assert!(shown > 0.01, "{i}: the case shows nothing");
        assert!(at_centre > 2.0 * error, "{i}: no better than at the centre: {error}, {at_centre}");
    }
}

/// Weights of a loss that is linear in the pixels.
fn weights() -> PlanarImage {
    let mut out = PlanarImage::zeros(SIZE);
    for (i, [x, y]) in pixels().enumerate() {
        let wave = (0.11 * x).sin() + (0.17 * y).cos();
        out.set_pixel(i, [wave as f32, 1.0, 0.5 - wave as f32]);
    }
    out
}

fn loss(camera: &Camera, g: &Gaussians) -> f64 {
    let weights = weights();
    let tape = render_from(camera, g);
    weights.data().iter().zip(tape.image().data()).map(|(w, v)| f64::from(*w) * f64::from(*v)).sum()
}

#[test]
fn derivatives_match_finite_differences() {
    // Wide ones: where an image is cut off at 1/255, differences see the rim and derivatives do not.
    let g = gaussians(&kerbs([0.4, 0.6]));
    let camera = camera();
    let image = weights();
    let mut out = Gradients::default();
    out.reset(g.len(), 0);
    let upstream = PixelGradients { image: &image, transmittance: None };
    let rasterizer = CpuRasterizer::new(RenderOptions::default());
    rasterizer.backward(&g, &view(&camera), &mut render(&g), &upstream, &mut out);
    let difference = |change: &dyn Fn(&mut Gaussians, f32), step: f32| {
        let at = |side: f32| {
            let mut moved = g.clone();
            change(&mut moved, side * step);
            loss(&camera, &moved)
        };
        (at(1.0) - at(-1.0)) / (2.0 * f64::from(step))
    };
    let check = |name: &str, found: Vec<f32>, expected: Vec<f64>| {
        let largest = expected.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        assert!(largest > 1.0, "{name}: nothing to compare");
        for (k, (a, b)) in found.iter().zip(&expected).enumerate() {
            let error = (f64::from(*a) - b).abs() / largest;
            assert!(error < 0.01, "{name} {k}: {a}, differences {b}");
        }
    };
    for i in 0..g.len() {
        let mean = |k: usize| difference(&|g, h| g.means[i][k] += h, 4e-3);
        check("mean", out.gaussians.means[i].to_vec(), (0..3).map(mean).collect());
        let scale = |k: usize| difference(&|g, h| g.log_scales[i][k] += h, 4e-3);
        check("log scale", out.gaussians.log_scales[i].to_vec(), (0..3).map(scale).collect());
        let turn = |k: usize| difference(&|g, h| g.quats[i][k] += h, 2e-3);
        check("quaternion", out.gaussians.quats[i].to_vec(), (0..4).map(turn).collect());
        let opacity = difference(&|g, h| g.opacity_logits[i] += h, 1e-2);
        check("opacity", vec![out.gaussians.opacity_logits[i]], vec![opacity]);
    }
    // Of the pose: about the camera's own axes, a turn changes `R` by `[w] R` and the translation by `w x t`.
    let pose = DMat4::from_mat3(camera.rotation());
    let translation = -(camera.rotation() * camera.center());
    let by_pose = |change: &dyn Fn(f64) -> DMat4| {
        let at = |side: f64| {
            let moved = change(side * 1e-3) * DMat4::from_translation(translation) * pose;
            loss(&Camera::new(camera.intrinsics(), moved, SIZE).unwrap(), &g)
        };
        (at(1.0) - at(-1.0)) / 2e-3
    };
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let shifts = axes.map(|axis| by_pose(&|h| DMat4::from_translation(axis * h)));
    check("translation", out.camera_translation.as_vec3().to_array().to_vec(), shifts.to_vec());
    let turns = axes.map(|axis| by_pose(&|h| DMat4::from_axis_angle(axis, h)));
    let along = |axis: DVec3| {
        let cross = DMat3::from_cols(axis.cross(DVec3::X), axis.cross(DVec3::Y), axis.cross(DVec3::Z));
        let turned = cross * camera.rotation();
        let rotation: f64 = (0..3).map(|c| out.camera_rotation.col(c).dot(turned.col(c))).sum();
        (rotation + out.camera_translation.dot(axis.cross(translation))) as f32
    };
    check("turn", axes.map(along).to_vec(), turns.to_vec());
}
