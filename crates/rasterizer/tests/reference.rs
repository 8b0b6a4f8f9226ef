//! Images and gradients against gsplat's pure-torch reference in float64 (fixtures/reference/rasterize).

use ffgs_arrays::NpzFile;
use ffgs_core::{Camera, Gaussians, ImageSize, Intrinsics, PixelFilter, PlanarImage};
use ffgs_rasterizer::{
    Background, CpuRasterizer, Gradients, PixelGradients, RenderOptions, RenderTape, View,
};
use ffgs_testkit::{largest, largest_difference, relative_difference};
use glam::DMat4;
use std::path::{Path, PathBuf};

/// f32 against f64 over some hundred blended splats; the cases' own tolerance.
const IMAGE_TOLERANCE: f64 = 2e-5;
/// Relative to the largest entry of each gradient.
const GRADIENT_TOLERANCE: f64 = 1e-3;

struct Case {
    file: NpzFile,
    gaussians: Gaussians,
    camera: Camera,
    background: [f32; 3],
    options: RenderOptions,
}

impl Case {
    fn load(path: &Path) -> Self {
        let file = NpzFile::open(path).unwrap();
        let f32s = |name: &str| file.f32(name).unwrap();
        let scalar = |name: &str| file.i64(name).unwrap().data[0];
        let means = f32s("in_means").rows::<3>().unwrap().to_vec();
        let sh = f32s("in_sh");
        let degree = (sh.shape[1] as f64).sqrt() as usize - 1;
        let mut gaussians = Gaussians::zeros(means.len(), degree);
        gaussians.means = means;
        gaussians.quats = f32s("in_quats").rows::<4>().unwrap().to_vec();
        gaussians.log_scales = f32s("in_log_scales").rows::<3>().unwrap().to_vec();
        gaussians.opacity_logits = f32s("in_opacity_logits").data;
        gaussians.sh = sh.data.as_chunks::<3>().0.to_vec();
        gaussians.validate().unwrap();
        if scalar("antialiased") == 0 {
            gaussians.filter = PixelFilter::Plain;
        }
        let k = file.f64("in_K").unwrap().data;
        let intrinsics = Intrinsics { fx: k[0], fy: k[4], cx: k[2], cy: k[5] };
        let size = ImageSize { width: scalar("width") as usize, height: scalar("height") as usize };
        let pose = DMat4::from_cols_slice(&file.f64("in_viewmat").unwrap().data).transpose();
        let background = f32s("in_background").data;
        let options =
            RenderOptions { sh_degree: Some(scalar("sh_degree") as usize), ..RenderOptions::default() };
        let camera = Camera::new(intrinsics, pose, size).unwrap();
        Self { gaussians, camera, background: [background[0], background[1], background[2]], options, file }
    }

    fn view(&self) -> View<'_> {
        View { camera: &self.camera, background: Background::Colour(self.background), tiles: None }
    }

    fn render(&self) -> RenderTape {
        let mut tape = RenderTape::default();
        CpuRasterizer::new(self.options).render(&self.gaussians, &self.view(), &mut tape);
        tape
    }

    fn gradients(&self, tape: &mut RenderTape) -> Gradients {
        let size = self.camera.size();
        let w_rgb = self.file.f32("w_rgb").unwrap().data;
        let mut image = PlanarImage::zeros(size);
        for (pixel, rgb) in w_rgb.as_chunks::<3>().0.iter().enumerate() {
            image.set_pixel(pixel, *rgb);
        }
        let minus_alpha: Vec<f32> = self.file.f32("w_alpha").unwrap().data.iter().map(|w| -w).collect();
        let upstream = PixelGradients { image: &image, transmittance: Some(&minus_alpha) };
        let mut out = Gradients::default();
        out.reset(self.gaussians.len(), self.gaussians.sh_degree());
        CpuRasterizer::new(self.options).backward(&self.gaussians, &self.view(), tape, &upstream, &mut out);
        out.fill_untouched();
        out
    }
}

fn cases() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/reference/rasterize");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() >= 8, "the reference cases are missing");
    paths
}

#[test]
fn images_agree_outside_fragile_pixels() {
    for path in cases() {
        let case = Case::load(&path);
        let tape = case.render();
        let image = case.file.f64("image").unwrap().data;
        let alpha = case.file.f64("alpha").unwrap().data;
        let fragile = case.file.u8("pixel_fragile").unwrap().data;
        let sound = || (0..alpha.len()).filter(|&pixel| fragile[pixel] == 0);
        let ours: Vec<f32> = sound().flat_map(|p| tape.image().pixel(p)).collect();
        let expected: Vec<f64> = sound().flat_map(|p| [0, 1, 2].map(|c| image[3 * p + c])).collect();
        let colour = largest_difference(&ours, &expected);
        let ours: Vec<f32> = sound().map(|p| 1.0 - tape.transmittance()[p]).collect();
        let expected: Vec<f64> = sound().map(|p| alpha[p]).collect();
        let worst = colour.max(largest_difference(&ours, &expected));
        println!("{}: image error {worst:.1e}", path.display());
        assert!(largest(tape.image().data().iter().copied()).is_finite(), "{}: not finite", path.display());
        assert!(worst <= IMAGE_TOLERANCE, "{}: {worst:e}", path.display());
    }
}

#[test]
fn gradients_agree() {
    let flat = |v: &[f32]| v.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
    for path in cases() {
        let case = Case::load(&path);
        let g = case.gradients(&mut case.render());
        let pose = g.camera_rotation.transpose();
        let pose: Vec<f64> = (0..3)
            .flat_map(|r| [pose.col(r).x, pose.col(r).y, pose.col(r).z, g.camera_translation[r]])
            .collect();
        let ours = [
            ("means", flat(g.gaussians.means.as_flattened())),
            ("quats", flat(g.gaussians.quats.as_flattened())),
            ("log_scales", flat(g.gaussians.log_scales.as_flattened())),
            ("opacity_logits", flat(&g.gaussians.opacity_logits)),
            ("sh", flat(g.gaussians.sh.as_flattened())),
            ("viewmat", pose),
            ("background", g.background.to_vec()),
        ];
        for (name, ours) in ours {
            let expected = case.file.f64(&format!("grad_{name}")).unwrap().data;
            let error = relative_difference(&ours, &expected[..ours.len()]);
            println!("{} {name}: {error:.1e}", path.display());
            assert!(error <= GRADIENT_TOLERANCE, "{} {name}: {error:e}", path.display());
        }
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let path = cases().into_iter().find(|p| p.to_string_lossy().contains("c08")).unwrap();
    let case = Case::load(&path);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut tape = case.render();
            (case.gradients(&mut tape).gaussians, tape.image().clone())
        })
    };
    assert!(run(1) == run(3));
}

#[test]
fn a_scene_in_other_units_looks_the_same() {
    // Powers of two leave the digits of positions as they are. In the smallest the scene is nearer than a millimetre.
    for (path, unit) in cases().into_iter().flat_map(|p| [(p.clone(), 1.0 / 4096.0), (p, 4096.0)]) {
        let mut case = Case::load(&path);
        let here = case.render();
        case.gaussians.means.as_flattened_mut().iter_mut().for_each(|v| *v *= unit);
        case.gaussians.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v += unit.ln());
        let mut pose = case.camera.camera_from_world();
        pose.w_axis = (pose.w_axis.truncate() * f64::from(unit)).extend(1.0);
        case.camera = Camera::new(case.camera.intrinsics(), pose, case.camera.size()).unwrap();
        let there = case.render();
        let expected: Vec<f64> = here.image().data().iter().map(|&v| f64::from(v)).collect();
        let worst = largest_difference(there.image().data(), &expected);
        assert!(worst < 1e-3, "{} times {unit}: {worst:e}", path.display());
    }
}
