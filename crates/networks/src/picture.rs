//! Photographs as tensors, and how positions of a network's picture become those of the photograph.

use crate::{Colour, Input, Layout};
use ffgs_core::{ImageRgb8, ImageSize};
use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Rgb};

/// How photographs of one size are shown to a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fit {
    /// Size of the photographs.
    pub photograph: ImageSize,
    /// Size to which they are brought.
    pub content: ImageSize,
    /// The same, continued to the right and below.
    pub padded: ImageSize,
}

impl Fit {
    /// `fixed` is the size that the network asks for.
    pub(crate) fn new(photograph: ImageSize, fixed: Option<ImageSize>, multiple: usize) -> Self {
        let content = fixed.unwrap_or(photograph);
        let up = |side: usize| side.next_multiple_of(multiple);
        let padded = match fixed {
            Some(size) => size,
            None => ImageSize { width: up(content.width), height: up(content.height) },
        };
        Self { photograph, content, padded }
    }

    /// Pixels of the photograph in one of the content, by column and row.
    pub(crate) fn scale(&self) -> [f32; 2] {
        let ratio = |a: usize, b: usize| a as f32 / b as f32;
        [ratio(self.photograph.width, self.content.width), ratio(self.photograph.height, self.content.height)]
    }

    /// The values of one picture in the order of the layout.
    pub(crate) fn tensor(&self, image: &ImageRgb8, input: &Input) -> Vec<f32> {
        let brought = brought_to(image, self.content);
        let pixels = (0..self.padded.pixels()).map(|i| {
            let (x, y) = (i % self.padded.width, i / self.padded.width);
            let (x, y) = (x.min(self.content.width - 1), y.min(self.content.height - 1));
            normalised(brought.pixel_bytes(x, y), input)
        });
        let channels = channels(input.colour);
        match input.layout {
            Layout::Nhwc => pixels.flat_map(|p| p.into_iter().take(channels)).collect(),
            Layout::Nchw => {
                let all: Vec<[f32; 3]> = pixels.collect();
                (0..channels).flat_map(|c| all.iter().map(move |p| p[c])).collect()
            }
        }
    }
}

/// Channels of a picture.
pub(crate) fn channels(colour: Colour) -> usize {
    if colour == Colour::Grey { 1 } else { 3 }
}

fn normalised([r, g, b]: [u8; 3], input: &Input) -> [f32; 3] {
    let [r, g, b] = [r, g, b].map(f32::from);
    let ordered = match input.colour {
        Colour::Rgb => [r, g, b],
        Colour::Bgr => [b, g, r],
        Colour::Grey => [0.299 * r + 0.587 * g + 0.114 * b; 3],
    };
    std::array::from_fn(|c| (ordered[c] - input.subtract[c]) / input.divide[c])
}

/// A picture of 8-bit RGB, borrowed where its size is already right.
enum Brought<'a> {
    AsIs(&'a ImageRgb8),
    Resized(ImageBuffer<Rgb<u8>, Vec<u8>>),
}

fn brought_to(image: &ImageRgb8, size: ImageSize) -> Brought<'_> {
    if image.size() == size {
        return Brought::AsIs(image);
    }
    let (width, height) = (image.size().width as u32, image.size().height as u32);
    let buffer: ImageBuffer<Rgb<u8>, &[u8]> =
        ImageBuffer::from_raw(width, height, image.data()).expect("three bytes per pixel");
    // A triangle as wide as a pixel of the smaller picture: an average where it gets smaller, linear where larger.
    Brought::Resized(resize(&buffer, size.width as u32, size.height as u32, FilterType::Triangle))
}

impl Brought<'_> {
    fn pixel_bytes(&self, x: usize, y: usize) -> [u8; 3] {
        match self {
            Self::AsIs(image) => {
                let at = 3 * (y * image.size().width + x);
                [image.data()[at], image.data()[at + 1], image.data()[at + 2]]
            }
            Self::Resized(image) => image.get_pixel(x as u32, y as u32).0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(text: &str) -> Input {
        toml::from_str(&format!("names = ['a', 'b']\n{text}")).unwrap()
    }

    /// Two pixels: (10, 20, 30) and (40, 50, 60).
    fn pair() -> ImageRgb8 {
        ImageRgb8::new(ImageSize { width: 2, height: 1 }, vec![10, 20, 30, 40, 50, 60]).unwrap()
    }

    #[test]
    fn channels_are_ordered_and_normalised() {
        let fit = Fit::new(pair().size(), None, 1);
        let tensor = |text: &str| fit.tensor(&pair(), &input(text));
        assert_eq!(tensor(""), [10.0, 40.0, 20.0, 50.0, 30.0, 60.0]);
        assert_eq!(tensor("layout = 'nhwc'"), [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
        assert_eq!(tensor("colour = 'bgr'"), [30.0, 60.0, 20.0, 50.0, 10.0, 40.0]);
        let normalised = tensor("layout = 'nhwc'\nsubtract = [10, 0, 0]\ndivide = [10, 20, 30]");
        assert_eq!(normalised, [0.0, 1.0, 1.0, 3.0, 2.5, 2.0]);
        let grey = tensor("colour = 'grey'");
        assert!((grey[0] - 18.15).abs() < 1e-4 && grey.len() == 2, "{grey:?}");
    }

    #[test]
    fn padding_repeats_the_border_and_keeps_the_scale() {
        let fit = Fit::new(pair().size(), None, 4);
        assert_eq!((fit.padded.width, fit.padded.height, fit.scale()), (4, 4, [1.0; 2]));
        let tensor = fit.tensor(&pair(), &input("colour = 'grey'"));
        assert_eq!(tensor[..4], [tensor[0], tensor[1], tensor[1], tensor[1]]);
        assert_eq!(tensor[4..8], tensor[..4]);
    }

    #[test]
    fn a_fixed_size_scales_by_column_and_row() {
        let fixed = ImageSize { width: 4, height: 2 };
        let fit = Fit::new(pair().size(), Some(fixed), 8);
        assert_eq!((fit.padded, fit.scale()), (fixed, [0.5, 0.5]));
        assert_eq!(fit.tensor(&pair(), &input("")).len(), 24);
    }
}
