//! The sky where no view sees it: what the photographs show in the same direction stands there
//! (docs/adr/0085-behind-holes-is-what-photographs-show.md).

use crate::constants::MIN_THROUGH;
use crate::sky::{SkyView, sky_colour, texel_direction};
use crate::sky_lane::render_alone;
use crate::texel_gradients::TexelGradients;
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use ffgs_rasterizer::RenderTape;
use glam::Vec3;
use rayon::prelude::*;

/// Squared transmittance, averaged over the pixels of a texel in the view that sees most of it, with which it is half what was trained.
const HALF_SEEN: f32 = 0.25;
/// Texels along the edge of a face on which photographs are averaged: one is some degrees wide.
const COARSE: usize = 16;
/// Directions that differ by less count alike (1 - cosine of the angle: 2.6 degrees); others by the fourth power of what they differ by.
const ALIKE: f32 = 1e-3;

/// Gives the texels of a `sky` that no view sees past `layer` the colour that the photographs show in their directions.
pub(crate) fn fill_hidden(sky: &mut SkyCube, layer: &Gaussians, views: &[TrainingView]) {
    let Some(shown) = colours_by_direction(sky.face_size(), views) else { return };
    let seen = seen(layer, views, sky.face_size());
    for ((texel, shown), seen) in sky.texels.iter_mut().zip(&shown.texels).zip(seen) {
        let trained = seen.powi(2) / (seen.powi(2) + HALF_SEEN.powi(2));
        *texel = Vec3::from(*shown).lerp(Vec3::from(*texel), trained).to_array();
    }
}

/// How much of each texel the view sees that sees most of it: mean squared transmittance of its pixels there, (6 * `face_size`^2).
fn seen(layer: &Gaussians, views: &[TrainingView], face_size: usize) -> Vec<f32> {
    let texels = 6 * face_size * face_size;
    let [mut open, mut all] = [(); 2].map(|()| TexelGradients::new(texels));
    let mut tape = RenderTape::default();
    let mut most = vec![0.0_f32; texels];
    for view in views {
        render_alone(layer, view, &mut tape);
        let through = |pixel: usize| tape.transmittance()[pixel];
        let share = |pixel: usize| if through(pixel) < MIN_THROUGH { 0.0 } else { through(pixel).powi(2) };
        let seen = SkyView::new(&view.camera, face_size);
        seen.backward(|pixel| Vec3::splat(share(pixel)), &mut open);
        seen.backward(|_| Vec3::ONE, &mut all);
        for (most, (open, all)) in most.iter_mut().zip(open.sums.iter().zip(&all.sums)) {
            *most = most.max(open[0] / all[0].max(f32::MIN_POSITIVE));
        }
        open.clear();
        all.clear();
    }
    most
}

/// What photographs show in a direction.
struct Shown {
    direction: Vec3,
    /// Sum over the pixels that look there.
    colours: Vec3,
    pixels: f32,
}

/// Mean colour of what photographs show in every direction, near or far, without what moves; in directions that none looks at, that of those
/// around them. `None` when they show nothing else.
fn colours_by_direction(face_size: usize, views: &[TrainingView]) -> Option<SkyCube> {
    let coarse = COARSE.min(face_size);
    let shown = shown_by_direction(coarse, views);
    if shown.is_empty() {
        return None;
    }
    let mean = |i: usize| mean_around(&shown, texel_direction(coarse, i));
    let coarse = painted(coarse, mean);
    Some(painted(face_size, |i| sky_colour(&coarse, texel_direction(face_size, i))))
}

fn shown_by_direction(face_size: usize, views: &[TrainingView]) -> Vec<Shown> {
    let texels = 6 * face_size * face_size;
    let [mut colours, mut pixels] = [(); 2].map(|()| TexelGradients::new(texels));
    for view in views {
        let seen = SkyView::new(&view.camera, face_size);
        let still = |pixel: usize| f32::from(u8::from(view.mask.data()[pixel] == 0));
        seen.backward(|pixel| still(pixel) * Vec3::from(view.image.pixel(pixel)), &mut colours);
        seen.backward(|pixel| Vec3::splat(still(pixel)), &mut pixels);
    }
    let shown = |i: usize| Shown {
        direction: texel_direction(face_size, i),
        colours: Vec3::from(colours.sums[i]),
        pixels: pixels.sums[i][0],
    };
    (0..texels).map(shown).filter(|shown| shown.pixels > 0.0).collect()
}

/// Mean colour over all that is shown, that of near directions above all.
fn mean_around(all: &[Shown], direction: Vec3) -> [f32; 3] {
    let (mut sum, mut total) = (Vec3::ZERO, 0.0);
    for shown in all {
        let weight = (ALIKE + 1.0 - direction.dot(shown.direction)).powi(-4);
        sum += weight * shown.colours;
        total += weight * shown.pixels;
    }
    (sum / total).to_array()
}

/// A cube with the colours of its texels.
fn painted(face_size: usize, colour: impl Fn(usize) -> [f32; 3] + Sync) -> SkyCube {
    let mut cube = SkyCube::filled(face_size, [0.0; 3]);
    cube.texels.par_iter_mut().enumerate().for_each(|(i, texel)| *texel = colour(i));
    cube
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};
    use glam::{DMat4, EulerRot};

    const SIZE: ImageSize = ImageSize { width: 32, height: 24 };
    const ROAD: [u8; 3] = [60, 70, 80];
    const AIR: [u8; 3] = [200, 210, 240];

    /// At the origin, level or turned down about x (rad): road in the lower half of its directions and sky above, as seen level.
    fn view(down: f64) -> TrainingView {
        let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 16.0, cy: 12.0 };
        let pose = DMat4::from_euler(EulerRot::XYZ, down, 0.0, 0.0);
        let camera = Camera::new(intrinsics, pose, SIZE).unwrap();
        let pixel = |i: usize| {
            let at = glam::DVec2::new((i % SIZE.width) as f64 + 0.5, (i / SIZE.width) as f64 + 0.5);
            if camera.ray(at).y > 0.0 { ROAD } else { AIR }
        };
        let image = ImageRgb8::new(SIZE, (0..SIZE.pixels()).flat_map(pixel).collect()).unwrap();
        TrainingView { camera, image, mask: Mask::filled(SIZE, false) }
    }

    /// Opaque discs before the lower half of a level view (the camera's y points down).
    fn road() -> Gaussians {
        let place = |i: usize| [(i % 80) as f32 * 0.1 - 4.0, (i / 80) as f32 * 0.1 + 0.05, 2.0];
        let places: Vec<[f32; 3]> = (0..80 * 40).map(place).collect();
        crate::from_points(&places, &vec![[0.2; 3]; places.len()], 0, 0.98)
    }

    fn assert_near(sky: &SkyCube, direction: Vec3, wanted: [u8; 3]) {
        let found = sky_colour(sky, direction.normalize());
        let wanted = wanted.map(|c| f32::from(c) / 255.0);
        let error = (Vec3::from(found) - Vec3::from(wanted)).abs().max_element();
        assert!(error < 0.1, "{direction}: {found:?} instead of {wanted:?}");
    }

    #[test]
    fn behind_the_road_is_its_colour_and_the_sky_stays() {
        let trained = [0.3, 0.9, 0.3];
        let mut sky = SkyCube::filled(32, trained);
        fill_hidden(&mut sky, &road(), &[view(0.0), view(0.1)]);
        assert_near(&sky, Vec3::new(0.0, 0.4, 1.0), ROAD);
        assert_near(&sky, Vec3::new(0.1, 1.0, 0.1), ROAD);
        assert_near(&sky, Vec3::new(0.0, -0.3, 1.0), trained.map(|c| (c * 255.0) as u8));
        assert_near(&sky, Vec3::new(0.0, -1.0, 0.1), AIR);
    }

    #[test]
    fn what_moves_is_not_behind() {
        let mut view = view(0.0);
        let size = view.mask.size();
        let left = (0..size.pixels()).map(|i| u8::from(i % size.width < 16)).collect();
        view.mask = Mask::new(size, left).unwrap();
        let red = |i: usize| if i % 32 < 16 { [255, 0, 0] } else { ROAD };
        view.image = ImageRgb8::new(size, (0..size.pixels()).flat_map(red).collect()).unwrap();
        let mut sky = SkyCube::filled(32, [0.0; 3]);
        fill_hidden(&mut sky, &road(), &[view.clone()]);
        assert_near(&sky, Vec3::new(-0.4, 0.4, 1.0), ROAD);
        view.mask = Mask::filled(size, true);
        let before = sky.clone();
        fill_hidden(&mut sky, &road(), &[view]);
        assert_eq!(sky, before, "the views show nothing that stands still");
        fill_hidden(&mut sky, &road(), &[]);
        assert_eq!(sky, before, "no views");
    }
}
