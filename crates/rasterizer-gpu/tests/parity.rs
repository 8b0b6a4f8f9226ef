//! The GPU rasterizer against its CPU twin: random scenes, masks, image backgrounds, poison and thresholds.

use ffgs_core::{Camera, Gaussians, ImageSize, Intrinsics, Mask, PixelFilter, PlanarImage};
use ffgs_gpu::Gpu;
use ffgs_rasterizer::{
    Background, CpuRasterizer, Dropout, Gradients, PixelGradients, RenderOptions, RenderTape, TileMask, View,
};
use ffgs_rasterizer_gpu::{GpuRasterizer, GpuScene, Rendered};
use glam::{DMat4, EulerRot};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// f32 against f32 over some hundred splats, in another order of operations.
const IMAGE_TOLERANCE: f32 = 3e-5;
/// A splat that one of the two skips at alpha = 1/255 or at the last step of transmittance changes a pixel by less.
const FLIP_TOLERANCE: f32 = 8e-3;
/// Share of the pixels on which a decision may fall the other way.
const FLIP_SHARE: f64 = 2e-3;
/// Relative to the largest entry of a column.
const GRADIENT_TOLERANCE: f32 = 1e-3;

const SIZE: ImageSize = ImageSize { width: 75, height: 53 };

fn camera() -> Camera {
    let intrinsics = Intrinsics { fx: 60.0, fy: 66.0, cx: 36.2, cy: 27.9 };
    // A centre far from the origin, as in a city.
    let pose = DMat4::from_euler(EulerRot::XYZ, 0.2, -0.3, 0.1) * DMat4::from_translation(-far());
    Camera::new(intrinsics, pose, SIZE).unwrap()
}

fn far() -> glam::DVec3 {
    glam::DVec3::new(812.3, -431.7, 96.1)
}

/// Gaussians in front of the camera, some beside and behind it, from specks to needles and walls.
fn scene(n: usize, sh_degree: usize, seed: u64) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Gaussians::zeros(n, sh_degree);
    let camera = camera();
    for i in 0..n {
        let depth = rng.random_range(-1.0..12.0_f64);
        let spread = depth.abs() + 0.2;
        let in_camera = glam::DVec3::new(
            rng.random_range(-1.0..1.0) * spread,
            rng.random_range(-0.8..0.8) * spread,
            depth,
        );
        let world = camera.center() + camera.rotation().transpose() * in_camera;
        out.means[i] = world.as_vec3().to_array();
        out.quats[i] = [0; 4].map(|_| rng.random_range(-2.0..2.0));
        out.log_scales[i] = [0; 3].map(|_| rng.random_range(-6.0..-0.5));
        out.opacity_logits[i] = rng.random_range(-6.0..6.0);
    }
    out.sh.as_flattened_mut().iter_mut().for_each(|v| *v = rng.random_range(-0.8..0.8));
    out
}

/// So faint that hundreds show in a pixel: lists of many parts, all of which count.
fn faint(n: usize, seed: u64) -> Gaussians {
    let mut out = scene(n, 1, seed);
    out.opacity_logits.iter_mut().for_each(|logit| *logit = -4.0 + 0.1 * *logit);
    out
}

/// Long Gaussians whose centres lie outside the image, near the camera, and that run along the view.
fn beside(n: usize, seed: u64) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = scene(n, 1, seed);
    let camera = camera();
    let back = camera.rotation().transpose();
    for i in 0..n {
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let centre = glam::DVec3::new(angle.cos(), angle.sin(), rng.random_range(0.2..0.7));
        out.means[i] = (camera.center() + back * centre).as_vec3().to_array();
        let lean = glam::DVec3::new(rng.random_range(-0.3..0.3), rng.random_range(-0.3..0.3), 1.0);
        let q = glam::DQuat::from_rotation_arc(glam::DVec3::Z, (back * lean).normalize()).as_quat();
        out.quats[i] = [q.w, q.x, q.y, q.z];
        out.log_scales[i] =
            [rng.random_range(-4.0..-1.5), rng.random_range(-4.0..-1.5), rng.random_range(-0.5..0.5)];
        out.opacity_logits[i] = rng.random_range(-2.0..3.0);
    }
    out
}

fn picture(seed: u64) -> PlanarImage {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = PlanarImage::zeros(SIZE);
    out.data_mut().iter_mut().for_each(|v| *v = rng.random_range(-1.0..1.0));
    out
}

struct Case<'a> {
    name: &'a str,
    gaussians: Gaussians,
    background: Background<'a>,
    tiles: Option<TileMask>,
    options: RenderOptions,
}

fn cpu(case: &Case, view: &View, upstream: &PixelGradients) -> (Rendered, Gradients) {
    let rasterizer = CpuRasterizer::new(case.options);
    let mut tape = RenderTape::default();
    rasterizer.render(&case.gaussians, view, &mut tape);
    let rendered = Rendered { image: tape.image().clone(), transmittance: tape.transmittance().to_vec() };
    let mut out = Gradients::default();
    out.reset(case.gaussians.len(), case.gaussians.sh_degree());
    rasterizer.backward(&case.gaussians, view, &mut tape, upstream, &mut out);
    out.fill_untouched();
    (rendered, out)
}

fn compare(gpu: &Gpu, case: &Case) {
    let camera = camera();
    let view = View { camera: &camera, background: case.background, tiles: case.tiles.as_ref() };
    let image = picture(7);
    let transmittance: Vec<f32> = picture(8).plane(0).to_vec();
    let upstream = PixelGradients { image: &image, transmittance: Some(&transmittance) };
    let (expected, expected_gradients) = cpu(case, &view, &upstream);
    let mut rasterizer = GpuRasterizer::new(gpu, case.options).unwrap();
    let mut gradients = Gradients::default();
    let found =
        rasterizer.render_and_differentiate(&case.gaussians, &view, &upstream, &mut gradients).unwrap();
    compare_pixels(case.name, found.image.data(), expected.image.data());
    compare_pixels(case.name, &found.transmittance, &expected.transmittance);
    gradients.fill_untouched();
    // Whether a splat reaches a tile at the very rim of its ellipse is a rounding decision; then it has no gradient.
    for i in (0..gradients.touched.len()).filter(|&i| gradients.touched[i] != expected_gradients.touched[i]) {
        let touched = if gradients.touched[i] { &gradients } else { &expected_gradients };
        assert_eq!(touched.gaussians.opacity_logits[i], 0.0, "{}: Gaussian {i} touched", case.name);
    }
    let (a, b) = (&gradients.gaussians, &expected_gradients.gaussians);
    compare_column(case.name, "means", a.means.as_flattened(), b.means.as_flattened());
    compare_column(case.name, "quats", a.quats.as_flattened(), b.quats.as_flattened());
    compare_column(case.name, "scales", a.log_scales.as_flattened(), b.log_scales.as_flattened());
    compare_column(case.name, "opacities", &a.opacity_logits, &b.opacity_logits);
    compare_column(case.name, "sh", a.sh.as_flattened(), b.sh.as_flattened());
    let pose = |g: &Gradients| {
        let columns = [
            g.camera_rotation.x_axis,
            g.camera_rotation.y_axis,
            g.camera_rotation.z_axis,
            g.camera_translation,
        ];
        // The rotation's entries are multiplied with coordinates, which are large far from the origin.
        let scale = [far().length(), far().length(), far().length(), 1.0];
        columns.iter().zip(scale).flat_map(|(c, s)| (*c / s).as_vec3().to_array()).collect::<Vec<f32>>()
    };
    compare_column(case.name, "pose", &pose(&gradients), &pose(&expected_gradients));
    compare_column(case.name, "mean2d", &gradients.mean2d_norm, &expected_gradients.mean2d_norm);
}

fn compare_pixels(name: &str, found: &[f32], expected: &[f32]) {
    assert_eq!(found.len(), expected.len(), "{name}");
    let mut flips = 0;
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        let error = (a - b).abs();
        assert!(error <= FLIP_TOLERANCE, "{name}: value {i} is {a}, not {b}");
        flips += usize::from(error > IMAGE_TOLERANCE);
    }
    assert!(flips as f64 <= FLIP_SHARE * found.len() as f64, "{name}: {flips} of {} differ", found.len());
}

fn compare_column(name: &str, column: &str, found: &[f32], expected: &[f32]) {
    let largest = expected.iter().fold(1e-12_f32, |m, v| m.max(v.abs()));
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        let error = (a - b).abs() / largest;
        assert!(error <= GRADIENT_TOLERANCE, "{name}, {column} {i}: {a}, not {b}");
    }
}

fn foreground() -> TileMask {
    let marked = |i: usize| u8::from((20..41).contains(&(i % SIZE.width)) && i / SIZE.width > 30);
    TileMask::covering(&Mask::new(SIZE, (0..SIZE.pixels()).map(marked).collect()).unwrap())
}

#[test]
#[ignore = "needs a GPU"]
fn random_scenes_agree() {
    let gpu = Gpu::for_test();
    let behind = picture(9);
    let all = RenderOptions::default();
    let low = RenderOptions { sh_degree: Some(1), ..RenderOptions::default() };
    let plain = |gaussians: Gaussians| gaussians.with_filter(PixelFilter::Plain);
    let cases = [
        Case {
            name: "plain",
            gaussians: plain(scene(300, 3, 1)),
            background: Background::Colour([0.3, 0.1, 0.7]),
            tiles: None,
            options: all,
        },
        Case {
            name: "masked, compensated, over an image",
            gaussians: scene(300, 2, 2),
            background: Background::Image(&behind),
            tiles: Some(foreground()),
            options: low,
        },
        // More than one block of the scans and sorts, and more pairs than the first guess has room for.
        Case {
            name: "many",
            gaussians: plain(scene(3000, 0, 3)),
            background: Background::Colour([0.0; 3]),
            tiles: None,
            options: all,
        },
        Case {
            name: "faint",
            gaussians: faint(3000, 8),
            background: Background::Image(&behind),
            tiles: Some(foreground()),
            options: low,
        },
        Case {
            name: "dropout",
            gaussians: scene(300, 1, 5),
            background: Background::Colour([0.3, 0.1, 0.7]),
            tiles: None,
            options: RenderOptions { dropout: Some(Dropout { share: 0.4, draw: 9 }), ..low },
        },
        Case {
            name: "long ones beside the camera",
            gaussians: beside(60, 6),
            background: Background::Colour([0.3, 0.1, 0.7]),
            tiles: None,
            options: low,
        },
        Case {
            name: "the same, linear at the centres",
            gaussians: beside(60, 6),
            background: Background::Colour([0.3, 0.1, 0.7]),
            tiles: None,
            options: RenderOptions { at_centres: true, ..low },
        },
        Case {
            name: "nothing",
            gaussians: Gaussians::empty(1),
            background: Background::Colour([0.2; 3]),
            tiles: None,
            options: all,
        },
        Case {
            name: "no tile",
            gaussians: scene(50, 0, 4),
            background: Background::Image(&behind),
            tiles: Some(TileMask::covering(&Mask::filled(SIZE, false))),
            options: all,
        },
    ];
    cases.iter().for_each(|case| compare(&gpu, case));
    let without = gpu.without_subgroups();
    cases.iter().for_each(|case| compare(&without, case));
}

#[test]
#[ignore = "needs a GPU"]
fn footprints_and_top_contributors_agree() {
    sums_and_contributors_agree(&scene(200, 0, 11));
    sums_and_contributors_agree(&faint(2000, 12));
}

fn sums_and_contributors_agree(gaussians: &Gaussians) {
    let gpu = Gpu::for_test();
    let (camera, tiles) = (camera(), foreground());
    let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
    // More channels than one pass sums; the first one has zeros.
    let pictures: Vec<PlanarImage> = (20..24).map(picture).collect();
    let mut planes: Vec<Vec<f32>> =
        pictures.iter().flat_map(|p| [0, 1, 2].map(|c| p.plane(c).to_vec())).collect();
    planes[0].iter_mut().step_by(3).for_each(|v| *v = 0.0);
    let channels: Vec<&[f32]> = planes.iter().map(Vec::as_slice).collect();
    let cpu = CpuRasterizer::new(RenderOptions::default());
    let (mut tape, mut expected) = (RenderTape::default(), ffgs_rasterizer::FootprintSums::default());
    cpu.accumulate(gaussians, &view, &channels, &mut tape, &mut expected);
    let top = cpu.top_contributors(gaussians, &view, 5, &mut tape);
    for gpu in [gpu, Gpu::for_test().without_subgroups()] {
        let mut rasterizer = GpuRasterizer::new(&gpu, RenderOptions::default()).unwrap();
        let found = rasterizer.accumulate(gaussians, &view, &channels).unwrap();
        for i in 0..gaussians.len() {
            assert!(found.hits(i).abs_diff(expected.hits(i)) <= 2, "hits of {i}");
            for (a, b) in found.of(i).iter().zip(expected.of(i)) {
                assert!((a - b).abs() <= 1e-2 + 1e-4 * b.abs(), "sums of {i}: {a}, not {b}");
            }
        }
        let found = rasterizer.top_contributors(gaussians, &view, 5).unwrap();
        compare_pixels("top weights", &found.weights, &top.weights);
        let same = found.indices.iter().zip(&top.indices).filter(|(a, b)| a == b).count();
        assert!(same as f64 >= 0.998 * top.indices.len() as f64, "{same} of {}", top.indices.len());
    }
}

/// Parameters that no optimiser should produce, and those on a threshold: what one twin shows, the other shows, and
/// nothing is NaN.
#[test]
#[ignore = "needs a GPU"]
fn poison_and_thresholds_agree() {
    let gpu = Gpu::for_test();
    let mut gaussians = scene(60, 1, 5);
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    gaussians.means[0][1] = nan;
    gaussians.means[1][2] = inf;
    gaussians.quats[3] = [0.0; 4];
    gaussians.quats[4][3] = inf;
    gaussians.quats[15] = [nan; 4];
    gaussians.quats[16][2] = nan;
    gaussians.quats[17] = [1e30; 4];
    gaussians.quats[18] = [1e-30; 4];
    gaussians.log_scales[5] = [nan; 3];
    gaussians.log_scales[6][0] = inf;
    gaussians.log_scales[7] = [-inf; 3];
    gaussians.log_scales[8] = [60.0; 3];
    gaussians.opacity_logits[9] = nan;
    gaussians.opacity_logits[10] = inf;
    gaussians.opacity_logits[11] = -inf;
    // Opacity about 1/255: never seen by either, or at the limit of what both see. Mean at the near plane, at the camera.
    gaussians.opacity_logits[2] = (0.999_f32 / 254.0).ln();
    gaussians.opacity_logits[12] = (1.001_f32 / 254.0).ln();
    let camera = camera();
    let forward = camera.rotation().transpose() * glam::DVec3::Z;
    gaussians.means[13] = (camera.center() + forward * 0.01).as_vec3().to_array();
    gaussians.means[14] = camera.center().as_vec3().to_array();
    let case = Case {
        name: "poison",
        gaussians,
        background: Background::Colour([0.5; 3]),
        tiles: None,
        options: RenderOptions::default(),
    };
    compare(&gpu, &case);
}

/// Two runs on one adapter give the same bits.
#[test]
#[ignore = "needs a GPU"]
fn equal_inputs_give_equal_bits() {
    let gpu = Gpu::for_test();
    let (camera, gaussians, image) = (camera(), scene(500, 1, 6), picture(7));
    let view = View { camera: &camera, background: Background::Colour([0.1; 3]), tiles: None };
    let upstream = PixelGradients { image: &image, transmittance: None };
    let run = || {
        let mut gradients = Gradients::default();
        let mut rasterizer = GpuRasterizer::new(&gpu, RenderOptions::default()).unwrap();
        let rendered =
            rasterizer.render_and_differentiate(&gaussians, &view, &upstream, &mut gradients).unwrap();
        (rendered, gradients.gaussians)
    };
    let first = run();
    assert!((0..3).all(|_| run() == first));
}

/// Also when the first views need less room than a later one, and with more views than a submission holds.
#[test]
#[ignore = "needs a GPU"]
fn several_views_in_a_submission_are_the_same_bits_as_one_by_one() {
    let gpu = Gpu::for_test();
    let (camera, gaussians, behind, tiles) = (camera(), scene(3000, 1, 6), picture(7), foreground());
    let all = View { camera: &camera, background: Background::Image(&behind), tiles: None };
    let part = View { camera: &camera, background: Background::Colour([0.1; 3]), tiles: Some(&tiles) };
    let views = [part, all, part, all, all, part, part, part, all, part];
    let rasterizer = || GpuRasterizer::new(&gpu, RenderOptions::default()).unwrap();
    let scene = GpuScene::upload(&gpu, &gaussians).unwrap();
    let one_by_one: Vec<Rendered> =
        views.iter().map(|view| rasterizer().render(&gaussians, view).unwrap()).collect();
    assert!(rasterizer().render_views(&scene, &views).unwrap() == one_by_one);
    assert!(rasterizer().render_views(&scene, &[]).unwrap().is_empty());
}
