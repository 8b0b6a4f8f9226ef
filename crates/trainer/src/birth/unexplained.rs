//! Foreground that the moving layer does not show.

use crate::sky::sky_picture;
use ffgs_core::{
    Camera, Gaussians, ImageRgb8, ImageSize, Mask, PlanarImage, SkyCube, TrainingView, upper_median,
};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, TileMask, View};

/// Alpha of the moving layer from which a pixel shows it.
const SHOWN: f32 = 0.5;
/// Difference of a channel from which a pixel shows something else,
const WRONG: f32 = 0.12;
/// and in units of what is usual in the view's foreground: exposures differ, and fog and rain hide detail.
const UNUSUAL: f32 = 2.0;
/// Up to this difference from what stands still, nothing moves.
const STANDS: f32 = 0.06;
/// Parts narrower than twice this share of the image's longer side are errors of motion or mask.
const NARROW: f64 = 0.008;
/// Side of the least area that counts, in such shares.
const LEAST_SIDE: usize = 4;

/// What stands still: the static layer before the sky.
#[derive(Clone, Copy)]
pub struct Standing<'a> {
    /// Static Gaussians.
    pub layer: &'a Gaussians,
    /// The sky behind them.
    pub sky: &'a SkyCube,
}

impl Standing<'_> {
    /// As a camera shows it where a mask is.
    fn shown(&self, camera: &Camera, mask: &Mask) -> PlanarImage {
        let (tiles, sky) = (TileMask::covering(&mask.dilated(1)), sky_picture(self.sky, camera));
        let frame = View { camera, background: Background::Image(&sky), tiles: Some(&tiles) };
        let mut tape = RenderTape::default();
        CpuRasterizer::default().render(self.layer, &frame, &mut tape);
        tape.take_image()
    }
}

/// The foreground of `view` where `layer`, which moves, shows something else than the photograph, or is transparent and the photograph is not that of
/// what stands still: masks hold some of that, too.
pub fn unexplained(layer: &Gaussians, standing: Standing, view: &TrainingView) -> Mask {
    if view.mask.count() == 0 {
        return view.mask.clone();
    }
    let (opaque, open) = opaque_and_open(layer, view);
    if open.count() == 0 {
        return open;
    }
    let behind = standing.shown(&view.camera, &open);
    let moves = |p: usize| opaque[p] || difference(&behind, &view.image, p) > STANDS;
    wide(view.camera.size(), |p| open.data()[p] != 0 && moves(p))
}

/// Where `layer` hides what is behind it, and the foreground where it does not, or shows something else than the photograph.
fn opaque_and_open(layer: &Gaussians, view: &TrainingView) -> (Vec<bool>, Mask) {
    let size = view.camera.size();
    // Where the layer is transparent, the photograph differs from nothing.
    let (tiles, photograph) = (TileMask::covering(&view.mask), PlanarImage::from(&view.image));
    let frame =
        View { camera: &view.camera, background: Background::Image(&photograph), tiles: Some(&tiles) };
    let mut tape = RenderTape::default();
    CpuRasterizer::default().render(layer, &frame, &mut tape);
    let foreground = |p: &usize| view.mask.data()[*p] != 0;
    let alpha: Vec<f32> = tape.transmittance().iter().map(|t| 1.0 - t).collect();
    let opaque: Vec<bool> = alpha.iter().map(|&alpha| alpha >= SHOWN).collect();
    let of_layer = |p: usize| difference(tape.image(), &view.image, p) / alpha[p];
    let differences: Vec<f32> =
        (0..size.pixels()).map(|p| if foreground(&p) && opaque[p] { of_layer(p) } else { 0.0 }).collect();
    let of_opaque = (0..size.pixels()).filter(|p| foreground(p) && opaque[*p]);
    let usual = upper_median(of_opaque.map(|p| f64::from(differences[p]))).unwrap_or(0.0);
    let wrong = (UNUSUAL * usual as f32).max(WRONG);
    let open = wide(size, |p| foreground(&p) && (!opaque[p] || differences[p] > wrong));
    (opaque, open)
}

/// The pixels that are open, without narrow parts; none where they are few.
fn wide(size: ImageSize, is_open: impl Fn(usize) -> bool) -> Mask {
    let narrow = (NARROW * size.width.max(size.height) as f64).round().max(1.0) as usize;
    let open = (0..size.pixels()).map(|p| u8::from(is_open(p))).collect();
    let open = Mask::new(size, open).expect("one value per pixel").opened(narrow);
    if open.count() < (LEAST_SIDE * narrow).pow(2) { Mask::filled(size, false) } else { open }
}

/// Mean over the channels of the difference of both images around pixel `p`, 3 x 3 pixels: noise is no difference.
fn difference(rendered: &PlanarImage, photograph: &ImageRgb8, p: usize) -> f32 {
    let size = photograph.size();
    let (x, y) = (p % size.width, p / size.width);
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for row in y.saturating_sub(1)..(y + 2).min(size.height) {
        for column in x.saturating_sub(1)..(x + 2).min(size.width) {
            let q = row * size.width + column;
            let (a, b) = (rendered.pixel(q), photograph.pixel(q));
            (0..3).for_each(|c| sum[c] += a[c] - b[c]);
            count += 1.0;
        }
    }
    sum.iter().map(|s| s.abs()).sum::<f32>() / (3.0 * count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::from_points;
    use ffgs_core::Intrinsics;
    use glam::DMat4;

    const SIZE: ImageSize = ImageSize { width: 100, height: 60 };

    /// A grey wall of a layer that fills the left half of the image; the mask holds all of it.
    fn scene() -> (Gaussians, TrainingView) {
        let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 50.0, cy: 30.0 };
        let camera = Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap();
        let points: Vec<[f32; 3]> =
            (0..2000).map(|i| [(i % 40) as f32 * 0.05 - 2.0, (i / 40) as f32 * 0.05 - 1.25, 2.0]).collect();
        let layer = from_points(&points, &vec![[0.5; 3]; points.len()], 0, 0.9);
        let image = ImageRgb8::new(SIZE, vec![128; 3 * SIZE.pixels()]).unwrap();
        (layer, TrainingView { camera, image, mask: Mask::filled(SIZE, true) })
    }

    fn open_before_nothing(layer: &Gaussians, view: &TrainingView) -> Mask {
        let standing = Standing { layer: &Gaussians::zeros(0, 0), sky: &SkyCube::filled(8, [0.0; 3]) };
        unexplained(layer, standing, view)
    }

    fn columns(mask: &Mask) -> Vec<usize> {
        (0..SIZE.width).filter(|&x| mask.contains(x, 30)).collect()
    }

    #[test]
    fn what_the_layer_leaves_open_is_unexplained() {
        let (layer, view) = scene();
        let open = columns(&open_before_nothing(&layer, &view));
        assert!(open[0].abs_diff(50) <= 3 && open.len() == 100 - open[0], "{open:?}");
        let nothing = TrainingView { mask: Mask::filled(SIZE, false), ..view };
        assert_eq!(open_before_nothing(&layer, &nothing).count(), 0);
    }

    #[test]
    fn what_stands_still_in_the_mask_is_explained() {
        let (layer, view) = scene();
        let open_before = |grey: f32| {
            let points: Vec<[f32; 3]> =
                (0..2400).map(|i| [(i % 60) as f32 * 0.1 - 3.0, (i / 60) as f32 * 0.1 - 2.0, 3.0]).collect();
            let wall = from_points(&points, &vec![[grey; 3]; points.len()], 0, 0.9);
            unexplained(&layer, Standing { layer: &wall, sky: &SkyCube::filled(8, [0.9; 3]) }, &view)
        };
        assert_eq!(open_before(0.5).count(), 0, "the wall behind is as grey");
        let open = columns(&open_before(0.7));
        assert!(open[0].abs_diff(50) <= 3 && open.len() == 100 - open[0], "another wall: {open:?}");
    }

    #[test]
    fn what_it_shows_wrongly_is_unexplained_but_a_different_exposure_is_not() {
        let (layer, view) = scene();
        let left: Vec<u8> = (0..SIZE.pixels()).map(|p| u8::from(p % SIZE.width < 45)).collect();
        let view = TrainingView { mask: Mask::new(SIZE, left).unwrap(), ..view };
        assert_eq!(open_before_nothing(&layer, &view).count(), 0);
        // A bright square of 12 pixels in the photograph.
        let bright = |p: usize| (10..22).contains(&(p % SIZE.width)) && (20..32).contains(&(p / SIZE.width));
        let with = |at: &dyn Fn(usize) -> u8| {
            let data = (0..SIZE.pixels()).flat_map(|p| [at(p); 3]).collect();
            TrainingView { image: ImageRgb8::new(SIZE, data).unwrap(), ..view.clone() }
        };
        let open = open_before_nothing(&layer, &with(&|p| if bright(p) { 250 } else { 128 }));
        assert!((130..200).contains(&open.count()) && open.contains(16, 26), "{}", open.count());
        assert_eq!(open_before_nothing(&layer, &with(&|_| 190)).count(), 0, "a different exposure");
    }
}
