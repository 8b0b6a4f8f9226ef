//! How much the error of a video changes from frame to frame.

use crate::{SizeMismatch, same_size};
use ffgs_core::{ImageRgb8, Mask};

/// A photograph and the render of it.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// What was photographed.
    pub photograph: &'a ImageRgb8,
    /// What was rendered.
    pub render: &'a ImageRgb8,
}

/// Temporal flicker: how much the error (render minus photograph) changes from one frame to the next, as a mean of absolute
/// values over pixels and channels (8-bit levels, 0 to 510). A constant error does not flicker, however large it is; what
/// moves in the photographs counts only where the render does not follow.
///
/// # Errors
/// When the images differ in size.
pub fn flicker(before: Seen, now: Seen) -> Result<f64, SizeMismatch> {
    check(before, now)?;
    Ok(mean_change(before, now, 0..now.render.size().pixels()).unwrap_or(0.0))
}

/// [`flicker`] over the pixels of `mask`, the foreground of `now`; `None` for an empty mask.
///
/// # Errors
/// When images and mask differ in size.
pub fn masked_flicker(before: Seen, now: Seen, mask: &Mask) -> Result<Option<f64>, SizeMismatch> {
    check(before, now)?;
    same_size(now.render.size(), mask.size())?;
    Ok(mean_change(before, now, (0..mask.data().len()).filter(|&pixel| mask.data()[pixel] != 0)))
}

fn check(before: Seen, now: Seen) -> Result<(), SizeMismatch> {
    [before.photograph, before.render, now.photograph]
        .into_iter()
        .try_for_each(|image| same_size(now.render.size(), image.size()))
}

/// Mean over pixels and channels; `None` over no pixels.
fn mean_change(before: Seen, now: Seen, pixels: impl Iterator<Item = usize>) -> Option<f64> {
    let error =
        |seen: Seen, i: usize| i64::from(seen.render.data()[i]) - i64::from(seen.photograph.data()[i]);
    let change = |pixel: usize| (3 * pixel..3 * pixel + 3).map(|i| error(now, i).abs_diff(error(before, i)));
    let (sum, values) = pixels.flat_map(change).fold((0, 0_u64), |(sum, n), value| (sum + value, n + 1));
    (values > 0).then(|| sum as f64 / values as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    fn image(values: [u8; 6]) -> ImageRgb8 {
        ImageRgb8::new(ImageSize { width: 2, height: 1 }, values.to_vec()).unwrap()
    }

    #[test]
    fn only_changes_of_the_error_count() {
        let (a, b) = (image([10, 20, 30, 40, 50, 60]), image([15, 25, 35, 45, 55, 65]));
        let (dark, bright) = (image([0; 6]), image([200, 100, 0, 0, 0, 0]));
        let of = |before: [&ImageRgb8; 2], now: [&ImageRgb8; 2]| {
            let seen = |[photograph, render]: [_; 2]| Seen { photograph, render };
            flicker(seen(before), seen(now)).unwrap()
        };
        assert_eq!(of([&a, &b], [&a, &b]), 0.0, "a constant error");
        assert_eq!(of([&a, &a], [&bright, &bright]), 0.0, "the render follows");
        assert_eq!(of([&a, &a], [&a, &b]), 5.0, "the render changes");
        assert_eq!(of([&a, &b], [&b, &a]), 10.0, "the error turns round");
        assert_eq!(
            of([&dark, &dark], [&bright, &dark]),
            50.0,
            "the render does not follow: 300 levels over 6 values"
        );
    }

    #[test]
    fn over_a_mask_the_other_pixels_do_not_count() {
        let (a, b) = (image([10; 6]), image([10, 10, 10, 40, 40, 40]));
        let (before, now) = (Seen { photograph: &a, render: &a }, Seen { photograph: &a, render: &b });
        let of = |mask: [u8; 2]| {
            let mask = Mask::new(ImageSize { width: 2, height: 1 }, mask.to_vec()).unwrap();
            masked_flicker(before, now, &mask).unwrap()
        };
        assert_eq!(
            [of([1, 1]), of([1, 0]), of([0, 1]), of([0, 0])],
            [Some(15.0), Some(0.0), Some(30.0), None]
        );
        let small = Mask::filled(ImageSize { width: 1, height: 2 }, true);
        assert!(masked_flicker(before, now, &small).is_err());
    }

    #[test]
    fn another_size_is_an_error() {
        let (a, small) =
            (image([0; 6]), ImageRgb8::new(ImageSize { width: 1, height: 1 }, vec![0; 3]).unwrap());
        let seen = Seen { photograph: &a, render: &a };
        assert!(flicker(Seen { photograph: &small, render: &a }, seen).is_err());
    }
}
