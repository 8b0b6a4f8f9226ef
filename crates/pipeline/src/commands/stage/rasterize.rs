//! `ffgs stage rasterize`.

use super::input::{ANY, Input, camera, narrow};
use crate::job::device::Device;
use anyhow::{Context, Result, ensure};
use ffgs_arrays::NpzWriter;
use ffgs_core::{Camera, Gaussians, ImageSize, PixelFilter, PlanarImage};
use ffgs_rasterizer::{
    Background, CpuRasterizer, Gradients, PixelGradients, RenderOptions, RenderTape, View,
};
use ffgs_rasterizer_gpu::{GpuRasterizer, Rendered};

pub(super) fn run(input: &Input, device: &Device) -> Result<NpzWriter> {
    let mut gaussians = gaussians(input)?;
    if input.count("antialiased")? == 0 {
        gaussians.filter = PixelFilter::Plain;
    }
    let camera = read_camera(input)?;
    let background = input.finite::<f32>("in_background", &[Some(3)])?.data;
    let background = Background::Colour([background[0], background[1], background[2]]);
    let upstream = Upstream::read(input, camera.size())?;
    let options = options(input, gaussians.sh_degree())?;
    let view = View { camera: &camera, background, tiles: None };
    let mut gradients = Gradients::default();
    let rendered = match device.open()?.first() {
        Some(device) => GpuRasterizer::new(&device.gpu, options)?.render_and_differentiate(
            &gaussians,
            &view,
            &upstream.gradients(),
            &mut gradients,
        )?,
        None => on_cpu(&gaussians, &view, options, &upstream.gradients(), &mut gradients),
    };
    gradients.fill_untouched();
    let mut results = NpzWriter::new();
    add_image(&mut results, &rendered);
    add_gradients(&mut results, &gradients);
    Ok(results)
}

fn on_cpu(
    gaussians: &Gaussians,
    view: &View,
    options: RenderOptions,
    upstream: &PixelGradients,
    gradients: &mut Gradients,
) -> Rendered {
    let rasterizer = CpuRasterizer::new(options);
    let mut tape = RenderTape::default();
    rasterizer.render(gaussians, view, &mut tape);
    gradients.reset(gaussians.len(), gaussians.sh_degree());
    rasterizer.backward(gaussians, view, &mut tape, upstream, gradients);
    Rendered { image: tape.image().clone(), transmittance: tape.transmittance().to_vec() }
}

pub(super) fn gaussians(input: &Input) -> Result<Gaussians> {
    let means = input.finite::<f32>("in_means", &[ANY, Some(3)])?;
    let n = means.shape[0];
    let sh = input.finite::<f32>("in_sh", &[Some(n), ANY, Some(3)])?;
    let degree = (0..=3).find(|d| (d + 1) * (d + 1) == sh.shape[1]);
    let degree =
        degree.ok_or_else(|| input.fault("in_sh", format!("{} coefficients; 1, 4, 9 or 16", sh.shape[1])))?;
    let mut out = Gaussians::zeros(n, degree);
    out.means = means.data.as_chunks().0.to_vec();
    out.quats = input.finite::<f32>("in_quats", &[Some(n), Some(4)])?.data.as_chunks().0.to_vec();
    out.log_scales = input.finite::<f32>("in_log_scales", &[Some(n), Some(3)])?.data.as_chunks().0.to_vec();
    out.opacity_logits = input.finite("in_opacity_logits", &[Some(n)])?.data;
    out.sh = sh.data.as_chunks().0.to_vec();
    out.validate()?;
    Ok(out)
}

pub(super) fn read_camera(input: &Input) -> Result<Camera> {
    let width = i64::try_from(input.count("width")?)?;
    let size = input.image_size("height", i64::try_from(input.count("height")?)?, width)?;
    let k = input.finite::<f64>("in_K", &[Some(3), Some(3)])?.data;
    let pose = input.finite::<f64>("in_viewmat", &[Some(4), Some(4)])?.data;
    let pose = pose.first_chunk().ok_or_else(|| input.fault("in_viewmat", "not 4 x 4"))?;
    camera([k[0], k[4], k[2], k[5]], pose, size)
        .with_context(|| input.fault("in_viewmat", "with in_K, not a camera"))
}

fn options(input: &Input, available: usize) -> Result<RenderOptions> {
    let degree = input.count("sh_degree")?;
    let what = format!("{degree}, but in_sh holds degree {available}");
    ensure!(degree <= available, input.fault("sh_degree", what));
    Ok(RenderOptions { sh_degree: Some(degree), ..RenderOptions::default() })
}

/// Derivatives of the loss with respect to image and transmittance.
struct Upstream {
    image: PlanarImage,
    transmittance: Vec<f32>,
}

impl Upstream {
    fn read(input: &Input, size: ImageSize) -> Result<Self> {
        let [h, w] = [Some(size.height), Some(size.width)];
        let rgb = input.finite::<f32>("w_rgb", &[h, w, Some(3)])?.data;
        let mut image = PlanarImage::zeros(size);
        for (pixel, rgb) in rgb.as_chunks().0.iter().enumerate() {
            image.set_pixel(pixel, *rgb);
        }
        // alpha = 1 - transmittance.
        let transmittance = input.finite::<f32>("w_alpha", &[h, w])?.data.iter().map(|a| -a).collect();
        Ok(Self { image, transmittance })
    }

    fn gradients(&self) -> PixelGradients<'_> {
        PixelGradients { image: &self.image, transmittance: Some(&self.transmittance) }
    }
}

fn add_image(results: &mut NpzWriter, rendered: &Rendered) {
    let size = rendered.image.size();
    let image: Vec<f32> = (0..size.pixels()).flat_map(|p| rendered.image.pixel(p)).collect();
    let alpha: Vec<f32> = rendered.transmittance.iter().map(|t| 1.0 - t).collect();
    results.f32("image", &[size.height, size.width, 3], &image);
    results.f32("alpha", &[size.height, size.width], &alpha);
}

fn add_gradients(results: &mut NpzWriter, gradients: &Gradients) {
    let g = &gradients.gaussians;
    let n = g.len();
    results.f32("grad_means", &[n, 3], g.means.as_flattened());
    results.f32("grad_quats", &[n, 4], g.quats.as_flattened());
    results.f32("grad_log_scales", &[n, 3], g.log_scales.as_flattened());
    results.f32("grad_opacity_logits", &[n], &g.opacity_logits);
    results.f32("grad_sh", &[n, g.sh_stride(), 3], g.sh.as_flattened());
    results.f32("grad_viewmat", &[4, 4], &narrow(&pose_gradient(gradients)));
    results.f32("grad_background", &[3], &narrow(&gradients.background));
}

/// Row-major; the last row of a rigid transform is constant.
fn pose_gradient(gradients: &Gradients) -> Vec<f64> {
    let mut pose = vec![0.0; 16];
    for row in 0..3 {
        let rotation = gradients.camera_rotation.row(row);
        pose[row * 4..row * 4 + 3].copy_from_slice(&rotation.to_array());
        pose[row * 4 + 3] = gradients.camera_translation[row];
    }
    pose
}
