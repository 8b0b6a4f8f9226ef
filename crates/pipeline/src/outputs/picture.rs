//! Pictures of Gaussians before a sky, on the CPU.

use ffgs_core::{Camera, Gaussians, PlanarImage};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use ffgs_splats::Panorama;
use glam::DVec2;

/// What a camera sees of the sky of a stream: sRGB, 0..=1.
pub fn panorama_picture(sky: &Panorama, camera: &Camera) -> PlanarImage {
    let size = camera.size();
    let mut picture = PlanarImage::zeros(size);
    for pixel in 0..size.pixels() {
        let [x, y] = [pixel % size.width, pixel / size.width].map(|v| v as f64 + 0.5);
        picture.set_pixel(pixel, sky.colour(camera.ray(DVec2::new(x, y)).as_vec3()));
    }
    picture
}

/// Layers of Gaussians in front of a picture, depth-sorted: sRGB, and the transmittance of each pixel (0 = opaque).
pub fn draw(layers: &[&Gaussians], camera: &Camera, behind: &PlanarImage) -> (PlanarImage, Vec<f32>) {
    let view = View { camera, background: Background::Image(behind), tiles: None };
    let mut tape = RenderTape::default();
    CpuRasterizer::default().render_layers(layers, &view, &mut tape);
    (tape.image().clone(), tape.transmittance().to_vec())
}
