//! Images and gradients against gsplat's pure-torch reference in float64, with the CPU rasterizer's tolerances.

use ffgs_arrays::NpzFile;
use ffgs_core::{Camera, Gaussians, ImageSize, Intrinsics, PixelFilter, PlanarImage};
use ffgs_gpu::Gpu;
use ffgs_rasterizer::{Background, Gradients, PixelGradients, RenderOptions, View};
use ffgs_rasterizer_gpu::{GpuRasterizer, Rendered};
use ffgs_testkit::{largest_difference, relative_difference};
use glam::DMat4;
use std::path::{Path, PathBuf};

const IMAGE_TOLERANCE: f64 = 2e-5;
/// Relative to the largest entry of each gradient.
const GRADIENT_TOLERANCE: f64 = 1e-3;

fn cases() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/reference/rasterize");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() >= 8, "the reference cases are missing");
    paths
}

fn gaussians(file: &NpzFile) -> Gaussians {
    let f32s = |name: &str| file.f32(name).unwrap();
    let sh = f32s("in_sh");
    let degree = (sh.shape[1] as f64).sqrt() as usize - 1;
    let mut out = Gaussians::zeros(f32s("in_means").shape[0], degree);
    out.means = f32s("in_means").rows::<3>().unwrap().to_vec();
    out.quats = f32s("in_quats").rows::<4>().unwrap().to_vec();
    out.log_scales = f32s("in_log_scales").rows::<3>().unwrap().to_vec();
    out.opacity_logits = f32s("in_opacity_logits").data;
    out.sh = sh.data.as_chunks::<3>().0.to_vec();
    out.validate().unwrap();
    if file.i64("antialiased").unwrap().data[0] == 0 {
        out.filter = PixelFilter::Plain;
    }
    out
}

fn camera(file: &NpzFile) -> Camera {
    let scalar = |name: &str| file.i64(name).unwrap().data[0] as usize;
    let k = file.f64("in_K").unwrap().data;
    let intrinsics = Intrinsics { fx: k[0], fy: k[4], cx: k[2], cy: k[5] };
    let pose = DMat4::from_cols_slice(&file.f64("in_viewmat").unwrap().data).transpose();
    Camera::new(intrinsics, pose, ImageSize { width: scalar("width"), height: scalar("height") }).unwrap()
}

fn run(gpu: &Gpu, file: &NpzFile) -> (Rendered, Gradients) {
    let scalar = |name: &str| file.i64(name).unwrap().data[0];
    let options = RenderOptions { sh_degree: Some(scalar("sh_degree") as usize), ..RenderOptions::default() };
    let (camera, background) = (camera(file), file.f32("in_background").unwrap().data);
    let background = Background::Colour([background[0], background[1], background[2]]);
    let view = View { camera: &camera, background, tiles: None };
    let mut image = PlanarImage::zeros(camera.size());
    for (pixel, rgb) in file.f32("w_rgb").unwrap().data.as_chunks::<3>().0.iter().enumerate() {
        image.set_pixel(pixel, *rgb);
    }
    let minus_alpha: Vec<f32> = file.f32("w_alpha").unwrap().data.iter().map(|w| -w).collect();
    let upstream = PixelGradients { image: &image, transmittance: Some(&minus_alpha) };
    let mut out = Gradients::default();
    let mut rasterizer = GpuRasterizer::new(gpu, options).unwrap();
    let rendered = rasterizer.render_and_differentiate(&gaussians(file), &view, &upstream, &mut out).unwrap();
    (rendered, out)
}

fn image_error(rendered: &Rendered, file: &NpzFile) -> f64 {
    let (image, alpha) = (file.f64("image").unwrap().data, file.f64("alpha").unwrap().data);
    let fragile = file.u8("pixel_fragile").unwrap().data;
    let sound = || (0..alpha.len()).filter(|&pixel| fragile[pixel] == 0);
    let ours: Vec<f32> = sound().flat_map(|p| rendered.image.pixel(p)).collect();
    let expected: Vec<f64> = sound().flat_map(|p| [0, 1, 2].map(|c| image[3 * p + c])).collect();
    let colour = largest_difference(&ours, &expected);
    let ours: Vec<f32> = sound().map(|p| 1.0 - rendered.transmittance[p]).collect();
    let expected: Vec<f64> = sound().map(|p| alpha[p]).collect();
    colour.max(largest_difference(&ours, &expected))
}

fn gradient_errors(g: &Gradients, file: &NpzFile) -> Vec<(&'static str, f64)> {
    let flat = |v: &[f32]| v.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
    let rows = g.camera_rotation.transpose();
    let pose = (0..3).flat_map(|r| [rows.col(r).x, rows.col(r).y, rows.col(r).z, g.camera_translation[r]]);
    let ours = [
        ("means", flat(g.gaussians.means.as_flattened())),
        ("quats", flat(g.gaussians.quats.as_flattened())),
        ("log_scales", flat(g.gaussians.log_scales.as_flattened())),
        ("opacity_logits", flat(&g.gaussians.opacity_logits)),
        ("sh", flat(g.gaussians.sh.as_flattened())),
        ("viewmat", pose.collect()),
        ("background", g.background.to_vec()),
    ];
    let relative = |(name, ours): (&'static str, Vec<f64>)| {
        let expected = file.f64(&format!("grad_{name}")).unwrap().data;
        (name, relative_difference(&ours, &expected[..ours.len()]))
    };
    ours.into_iter().map(relative).collect()
}

#[test]
#[ignore = "needs a GPU"]
fn images_and_gradients_agree_outside_fragile_pixels() {
    let gpu = Gpu::for_test();
    for path in cases() {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let file = NpzFile::open(&path).unwrap();
        let (rendered, gradients) = run(&gpu, &file);
        let error = image_error(&rendered, &file);
        println!("{name}: image {error:.1e}");
        assert!(error <= IMAGE_TOLERANCE, "{name}: image {error:e}");
        for (column, error) in gradient_errors(&gradients, &file) {
            println!("{name}: {column} {error:.1e}");
            assert!(error <= GRADIENT_TOLERANCE, "{name}: {column} {error:e}");
        }
    }
}
