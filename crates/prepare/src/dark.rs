//! Dark pictures, made as bright as others are: what tells things apart by grey levels sees little in them.

use ffgs_core::ImageRgb8;

/// Pictures are dark when 99 % of their values are less than this (0 to 255),
const DARK: usize = 128;
const SHARE: f64 = 0.99;
/// and are multiplied so that these 99 % are less than this one, by this at most: noise grows as well.
const BRIGHT: f32 = 230.0;
const MOST: f32 = 8.0;

/// By what the pictures are multiplied; 1 where they are not dark.
pub(crate) fn gain<'a>(images: impl IntoIterator<Item = &'a ImageRgb8>) -> f32 {
    let mut counts = [0_u64; 256];
    for image in images {
        image.data().iter().for_each(|value| counts[usize::from(*value)] += 1);
    }
    let all: u64 = counts.iter().sum();
    let mut below = 0;
    let high = counts.iter().position(|count| {
        below += count;
        below as f64 >= SHARE * all as f64
    });
    match high {
        Some(high) if high < DARK && all > 0 => (BRIGHT / high.max(1) as f32).clamp(1.0, MOST),
        _ => 1.0,
    }
}

/// The picture with its values multiplied.
pub(crate) fn brightened(image: ImageRgb8, gain: f32) -> ImageRgb8 {
    if gain == 1.0 {
        return image;
    }
    let data = image.data().iter().map(|value| (f32::from(*value) * gain).round() as u8).collect();
    ImageRgb8::new(image.size(), data).expect("as many values")
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    fn picture(of: impl Fn(usize) -> u8) -> ImageRgb8 {
        let size = ImageSize { width: 20, height: 10 };
        ImageRgb8::new(size, (0..3 * size.pixels()).map(of).collect()).unwrap()
    }

    #[test]
    fn dark_pictures_alone_are_brightened() {
        let up_to = |most: usize| picture(move |i| (i % (most + 1)) as u8);
        assert_eq!(gain([&up_to(255)]), 1.0);
        assert_eq!(gain([&up_to(59), &up_to(200)]), 1.0, "one of them is bright");
        let dark = gain([&up_to(59), &up_to(49)]);
        assert!((dark - BRIGHT / 59.0).abs() < 0.2, "{dark}");
        assert_eq!(gain([&picture(|_| 0)]), MOST, "black");
        assert_eq!(gain([]), 1.0);
        // A lamp in the dark is no reason to leave it dark.
        let lamp = picture(|i| if i < 5 { 255 } else { (i % 40) as u8 });
        assert!(gain([&lamp]) > 5.0);
        let bright = brightened(lamp.clone(), 5.0);
        assert_eq!((bright.data()[0], bright.data()[45]), (255, 25));
        assert_eq!(brightened(lamp.clone(), 1.0), lamp);
    }
}
