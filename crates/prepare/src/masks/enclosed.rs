//! What something covers in every frame. Of a person who stands and sways, the outline differs from the background that was learnt, but
//! the trunk between the outlines is that background: it is enclosed by what moves, and what texture it has does not lie still
//! (docs/adr/0102-what-is-enclosed-and-does-not-lie-still-moves.md).

use super::background::{Background, colour, middle, stride};
use super::difference::is_shadow;
use super::regions;
use ffgs_core::{ImageRgb8, ImageSize, Mask};
use rayon::prelude::*;

/// Pixels from one to the next of which the colour changes by so many grey levels tell whether they lie still: their colours spread
/// over time by this step times the distance by which they sway.
const TEXTURE: f32 = 4.0;
/// They do not lie still if they sway by more than this (px), and by so many times as much as the camera's other pixels do, which sway
/// with the camera.
const SWAY_PX: f32 = 0.25;
const OF_CAMERA: f32 = 3.0;

/// The regions between `masks`, those of the first ones of the images, of whose textured pixels more than half do not lie still. What
/// reaches the border of the image is not enclosed: a road with mirror images, between what moves on it and the border, is no thing.
pub(super) fn enclosed(background: &Background, images: &[ImageRgb8], masks: &[Mask]) -> Mask {
    let size = background.size;
    let Some(together) = union(masks) else { return Mask::filled(size, false) };
    let sway = sway(background, &images[..masks.len()]);
    let near = regions::surroundings(&together);
    let others = (0..size.pixels())
        .step_by(stride(size.pixels()))
        .filter(|&i| near.data()[i] == 0)
        .filter_map(|i| sway[i]);
    let least = SWAY_PX.max(OF_CAMERA * middle(others));
    let filled = regions::filled_where(&together, |pixels| {
        let (mut textured, mut moving, mut inside) = (0, 0, true);
        for i in pixels {
            inside &= !is_at_border(i, size);
            textured += usize::from(sway[i].is_some());
            moving += usize::from(sway[i].is_some_and(|sway| sway > least));
        }
        inside && 2 * moving > textured
    });
    let data = filled.data().iter().zip(together.data()).map(|(f, t)| f - t);
    Mask::new(size, data.collect()).expect("one value per pixel")
}

fn is_at_border(i: usize, ImageSize { width, height }: ImageSize) -> bool {
    let (x, y) = (i % width, i / width);
    x == 0 || y == 0 || x + 1 == width || y + 1 == height
}

/// What any of the masks covers, and gaps between that are narrower than masks err.
fn union(masks: &[Mask]) -> Option<Mask> {
    let size = masks.first()?.size();
    let free = (0..size.pixels()).map(|i| u8::from(masks.iter().all(|m| m.data()[i] == 0)));
    let free = Mask::new(size, free.collect()).expect("one value per pixel").opened(regions::radius(size));
    Mask::new(size, free.data().iter().map(|v| 1 - v).collect())
}

/// By how much (px) each pixel with texture sways, as far as noise does not explain it.
fn sway(background: &Background, images: &[ImageRgb8]) -> Vec<Option<f32>> {
    let gains: Vec<[f32; 3]> = images.iter().map(|image| background.gain(image)).collect();
    // A shadow that passes changes colours as well, but only to darker ones.
    let moments = |i: usize| {
        let colours = images.iter().zip(&gains).map(|(image, gain)| colour(image, *gain, i));
        let (mean, spread) = moments(colours.clone());
        let lit = moments(colours.filter(|colour| !is_shadow(*colour, background.colour[i])));
        (mean, spread.min(lit.1))
    };
    let (mean, spread): (Vec<[f32; 3]>, Vec<f32>) =
        (0..background.size.pixels()).into_par_iter().map(moments).unzip();
    let noise = middle(spread.iter().step_by(stride(spread.len())).copied());
    let sway = |i: usize| {
        let step = step(&mean, background.size, i);
        (step > TEXTURE).then(|| (spread[i] * spread[i] - noise * noise).max(0.0).sqrt() / step)
    };
    (0..spread.len()).into_par_iter().map(sway).collect()
}

/// The mean colour and the largest standard deviation of a channel; 0 of none.
fn moments(colours: impl Iterator<Item = [f32; 3]>) -> ([f32; 3], f32) {
    let (count, sum, squares) = colours.fold((0.0, [0.0; 3], [0.0; 3]), |(count, sum, squares), colour| {
        let add = |to: [f32; 3], of: fn(f32) -> f32| std::array::from_fn(|c| to[c] + of(colour[c]));
        (count + 1.0, add(sum, |v| v), add(squares, |v| v * v))
    });
    let count = f32::max(count, 1.0);
    let mean: [f32; 3] = sum.map(|v| v / count);
    let variance = (0..3).map(|c| squares[c] / count - mean[c] * mean[c]).fold(0.0, f32::max);
    (mean, variance.sqrt())
}

/// The largest change of a channel from a pixel to the next (Sobel's kernel).
fn step(colours: &[[f32; 3]], ImageSize { width, height }: ImageSize, i: usize) -> f32 {
    let (x, y) = (i % width, i / width);
    let columns = [x.saturating_sub(1), x, (x + 1).min(width - 1)];
    let rows = [y.saturating_sub(1), y, (y + 1).min(height - 1)];
    let at = |c: usize, row: usize, column: usize| colours[rows[row] * width + columns[column]][c];
    let weighted = |of: &dyn Fn(usize) -> f32| (of(0) + 2.0 * of(1) + of(2)) / 8.0;
    let change = |c: usize| {
        let right = weighted(&|row| at(c, row, 2) - at(c, row, 0));
        let down = weighted(&|column| at(c, 2, column) - at(c, 0, column));
        right.hypot(down)
    };
    (0..3).map(change).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize { width: 96, height: 64 };

    fn in_disc(i: usize, shift: f32, radius: f32) -> bool {
        ((i % SIZE.width) as f32 - 48.0 - shift).hypot((i / SIZE.width) as f32 - 32.0) < radius
    }

    /// Stripes, 8 px wide, of a wall or of a shirt.
    fn stripes(i: usize, shift: f32, dark: f32) -> f32 {
        dark + 30.0 * (((i % SIZE.width) as f32 - shift) * std::f32::consts::TAU / 8.0).sin()
    }

    /// Pictures of a thing, a disc with a hole in it, before a wall, and the masks that tell what differs from the middle one; the thing
    /// and the camera sway by so many px.
    fn seen(thing: f32, camera: f32) -> (Background, Vec<ImageRgb8>, Vec<Mask>) {
        let shifts = [-1.0, -0.5, 0.0, 0.5, 1.0, 0.0];
        let grey = |i: usize, shift: f32| {
            let on = in_disc(i, thing * shift, 24.0) && !in_disc(i, 0.0, 8.0);
            let noise = (i * 7919 % 5) as f32 - 2.0;
            noise + if on { stripes(i, thing * shift, 160.0) } else { stripes(i, camera * shift, 80.0) }
        };
        let picture = |shift: f32| {
            let data = (0..SIZE.pixels()).flat_map(|i| [grey(i, shift) as u8; 3]);
            ImageRgb8::new(SIZE, data.collect()).unwrap()
        };
        // The outline of the disc and of its hole.
        let mask = |_: &f32| {
            let ring = |i, radius: f32| in_disc(i, 0.0, radius + 2.0) && !in_disc(i, 0.0, radius - 2.0);
            let data = (0..SIZE.pixels()).map(|i| u8::from(ring(i, 24.0) || ring(i, 8.0)));
            Mask::new(SIZE, data.collect()).unwrap()
        };
        let images: Vec<ImageRgb8> = shifts.into_iter().map(picture).collect();
        (Background::learn(&images, &[]), images, shifts.iter().map(mask).collect())
    }

    /// Shares of the disc, of what is seen through it, and of what is beside it that are found.
    fn found(thing: f32, camera: f32) -> [f64; 3] {
        let (background, images, masks) = seen(thing, camera);
        let enclosed = enclosed(&background, &images, &masks);
        let share = |of: &dyn Fn(usize) -> bool| {
            let all: Vec<usize> = (0..SIZE.pixels()).filter(|&i| of(i)).collect();
            all.iter().filter(|&&i| enclosed.data()[i] == 1).count() as f64 / all.len() as f64
        };
        [
            share(&|i| in_disc(i, 0.0, 20.0) && !in_disc(i, 0.0, 12.0)),
            share(&|i| in_disc(i, 0.0, 8.0)),
            share(&|i| !in_disc(i, 0.0, 26.0)),
        ]
    }

    #[test]
    fn what_sways_between_outlines_is_enclosed_and_what_lies_still_is_not() {
        let [thing, through, beside] = found(2.0, 0.0);
        assert!(thing > 0.95 && through == 0.0 && beside == 0.0, "{thing} {through} {beside}");
        assert_eq!(found(0.1, 0.0), [0.0; 3], "nothing moves");
    }

    #[test]
    fn what_sways_with_the_camera_is_not_enclosed() {
        let [thing, through, beside] = found(0.6, 0.6);
        assert_eq!([thing, through, beside], [0.0; 3]);
    }

    /// A wall in a ring of masks; in half of the pictures a soft shadow lies on it.
    #[test]
    fn what_is_shadowed_at_times_does_not_sway() {
        let picture = |shadowed: bool| {
            let light = |i: usize| if shadowed && in_disc(i, 0.0, 18.0) { 0.75 } else { 1.0 };
            let data = (0..SIZE.pixels()).flat_map(|i| [(stripes(i, 0.0, 120.0) * light(i)) as u8; 3]);
            ImageRgb8::new(SIZE, data.collect()).unwrap()
        };
        let images: Vec<ImageRgb8> = (0..8).map(|t| picture(t % 3 == 2)).collect();
        let ring = (0..SIZE.pixels()).map(|i| u8::from(in_disc(i, 0.0, 26.0) && !in_disc(i, 0.0, 22.0)));
        let masks = vec![Mask::new(SIZE, ring.collect()).unwrap(); images.len()];
        assert_eq!(enclosed(&Background::learn(&images, &[]), &images, &masks).count(), 0);
    }

    #[test]
    fn nothing_is_enclosed_by_no_masks() {
        let (background, images, masks) = seen(2.0, 0.0);
        let empty = vec![Mask::filled(SIZE, false); masks.len()];
        assert_eq!(enclosed(&background, &images, &empty).count(), 0);
        assert_eq!(enclosed(&background, &images, &[]).count(), 0);
    }
}
