//! Pictures of a frame, scaled down and encoded once.

use crate::ReportError;
use crate::colour::inferno;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use ffgs_core::{ImageRgb8, ImageSize};
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use serde::{Deserialize, Serialize};

/// Most text that all pictures of a run take in its report: browsers open such a page from disk without delay.
const REPORT_BYTES: usize = 42_000_000;
/// Photographs and renders of street scenes as JPEGs of the best quality below, measured: bytes per pixel.
const BYTES_PER_PIXEL: f64 = 0.14;
/// Qualities to try until a picture fits: artefacts of the first are invisible at the size shown.
const QUALITIES: [u8; 4] = [85, 70, 50, 30];
/// Widest picture (px): a third of a laptop's width, twice over for sharp screens.
const MAX_WIDTH: f64 = 960.0;
/// Narrowest picture (px) in which a viewer still recognises the scene.
const MIN_WIDTH: f64 = 160.0;
/// Absolute difference shown as the brightest colour (of 255).
pub(crate) const ERROR_RANGE: f64 = 64.0;

/// The pictures of one frame as `data:` URIs (JPEG).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FramePictures {
    /// Ground truth, render and error of each view that measures the frame, in the order of the frame's views.
    pub views: Vec<[String; 3]>,
    /// Fused displacement ([`crate::motion_picture`]), if drawn.
    pub motion: Option<String>,
    /// Position uncertainty ([`crate::uncertainty_picture`]), if drawn.
    pub uncertainty: Option<String>,
}

/// Pictures all around what moves in a frame, in order, as `data:` URIs (JPEG).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Turntable {
    /// Frame.
    pub frame: usize,
    /// The pictures.
    pub pictures: Vec<String>,
}

/// What is believed of the training cameras in one frame: masks, points and tracks drawn on their photographs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraPictures {
    /// Frame.
    pub frame: usize,
    /// A picture per camera.
    pub cameras: Vec<CameraPicture>,
}

/// One camera's.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraPicture {
    /// Camera name.
    pub name: String,
    /// The picture as a `data:` URI (JPEG).
    pub picture: String,
}

/// Size of the pictures of a run: the more there are, the smaller is each, so that the report of the whole run keeps a
/// bounded size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Thumbnails {
    most_bytes: usize,
}

impl Thumbnails {
    /// For so many frames with so many test views each.
    pub fn for_run(frames: usize, views: usize) -> Self {
        let pictures = frames.max(1) * (3 * views + 2);
        // Base64 writes three bytes as four characters.
        Self { most_bytes: REPORT_BYTES / 4 * 3 / pictures }
    }

    /// Of at most so many bytes each, before they become text.
    pub fn of_bytes(most_bytes: usize) -> Self {
        Self { most_bytes }
    }

    /// Ground truth, render and error of a view; `None` when the sizes differ.
    ///
    /// # Errors
    /// [`ReportError::Encode`] for a picture without pixels.
    pub fn view(self, truth: &ImageRgb8, render: &ImageRgb8) -> Result<Option<[String; 3]>, ReportError> {
        let Some(error) = error_map(truth, render) else { return Ok(None) };
        Ok(Some([self.encode(truth)?, self.encode(render)?, self.encode(&error)?]))
    }

    /// The picture, scaled down, as a `data:` URI.
    ///
    /// # Errors
    /// [`ReportError::Encode`] for a picture without pixels.
    pub fn encode(self, picture: &ImageRgb8) -> Result<String, ReportError> {
        let (width, height) = (picture.size().width as u32, picture.size().height as u32);
        let scaled_width = self.width(f64::from(width) / f64::from(height.max(1))).min(width);
        let scaled_height = (u64::from(height) * u64::from(scaled_width) / u64::from(width.max(1))) as u32;
        let (width, height) = (scaled_width, scaled_height.max(1).min(height));
        let scaled = scaled(picture, ImageSize { width: width as usize, height: height as usize });
        let mut bytes = Vec::new();
        for quality in QUALITIES {
            bytes.clear();
            let encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
            let colours = ExtendedColorType::Rgb8;
            encoder.write_image(scaled.data(), width, height, colours).map_err(ReportError::Encode)?;
            if bytes.len() <= self.most_bytes {
                break;
            }
        }
        Ok(format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes)))
    }

    /// Width (px) at which a picture of this aspect should fit.
    fn width(self, aspect: f64) -> u32 {
        let pixels = self.most_bytes as f64 / BYTES_PER_PIXEL;
        (pixels * aspect).sqrt().clamp(MIN_WIDTH, MAX_WIDTH) as u32
    }
}

/// Means over the pixels that each pixel of the smaller picture covers.
fn scaled(picture: &ImageRgb8, size: ImageSize) -> ImageRgb8 {
    let whole = picture.size();
    // Of one type of pixel: of an untyped image the compiler would make the code for all of them, which takes minutes.
    let from = TypedImageRef::<U8x3>::from_buffer(whole.width as u32, whole.height as u32, picture.data());
    let mut to = TypedImage::<U8x3>::new(size.width as u32, size.height as u32);
    let means = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Box));
    let from = from.expect("an ImageRgb8 holds its size's bytes");
    Resizer::new().resize_typed(&from, &mut to, &means).expect("the whole picture is inside of itself");
    ImageRgb8::new(size, to.pixels().iter().flat_map(|pixel| pixel.0).collect())
        .expect("three bytes per pixel")
}

/// Colour-mapped mean absolute difference over the channels: black = equal, bright = a quarter of the range or more.
/// `None` when the sizes differ.
pub(crate) fn error_map(a: &ImageRgb8, b: &ImageRgb8) -> Option<ImageRgb8> {
    let colours: Vec<[u8; 3]> =
        (0..=3 * 255).map(|sum| inferno(f64::from(sum) / (3.0 * ERROR_RANGE))).collect();
    let difference = |(a, b): (&[u8; 3], &[u8; 3])| {
        let sum: usize = (0..3).map(|c| usize::from(a[c].abs_diff(b[c]))).sum();
        colours[sum]
    };
    let pixels = a.data().as_chunks().0.iter().zip(b.data().as_chunks().0);
    let data = pixels.flat_map(difference).collect();
    (a.size() == b.size()).then(|| ImageRgb8::new(a.size(), data)).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    fn filled(width: usize, height: usize, colour: [u8; 3]) -> ImageRgb8 {
        let size = ImageSize { width, height };
        ImageRgb8::new(size, colour.repeat(size.pixels())).unwrap()
    }

    /// Neighbouring pixels that have nothing in common: no picture takes more bytes.
    fn noise(width: usize, height: usize) -> ImageRgb8 {
        let size = ImageSize { width, height };
        let byte = |i: usize| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as u8;
        ImageRgb8::new(size, (0..3 * size.pixels()).map(byte).collect()).unwrap()
    }

    #[test]
    fn equal_pictures_have_a_black_error_and_large_differences_a_bright_one() {
        let a = filled(3, 2, [9, 80, 200]);
        assert!(error_map(&a, &a).unwrap().data().chunks(3).all(|p| p == [0, 0, 4]));
        let bright = error_map(&filled(3, 2, [0; 3]), &filled(3, 2, [64; 3])).unwrap();
        assert!(bright.data().chunks(3).all(|p| p == [252, 255, 164]));
        assert!(error_map(&a, &filled(2, 3, [0; 3])).is_none());
    }

    #[test]
    fn pictures_of_a_long_run_stay_small_whatever_they_show() {
        let thumbnails = Thumbnails::for_run(300, 7);
        let views = thumbnails.view(&noise(1920, 1080), &filled(1920, 1080, [90; 3])).unwrap().unwrap();
        let of_frame = 7 * views.iter().map(String::len).sum::<usize>() + 2 * views[0].len();
        assert!(300 * of_frame < 50_000_000, "{of_frame} bytes per frame");
    }

    #[test]
    fn a_smaller_picture_has_the_means_of_the_larger_one() {
        // Columns of 0 and 200 that each pixel of the smaller picture covers alike.
        let size = ImageSize { width: 8, height: 4 };
        let stripes = ImageRgb8::new(size, [[0; 3], [200; 3]].concat().repeat(16)).unwrap();
        let half = scaled(&stripes, ImageSize { width: 4, height: 2 });
        assert!(half.data().iter().all(|&v| v == 100), "{:?}", half.data());
        assert_eq!(scaled(&stripes, size), stripes);
    }

    #[test]
    fn a_picture_without_pixels_is_an_error() {
        for [width, height] in [[0, 0], [0, 9], [2000, 0]] {
            let empty = ImageRgb8::new(ImageSize { width, height }, Vec::new()).unwrap();
            assert!(Thumbnails::for_run(1, 1).encode(&empty).is_err(), "{width} x {height}");
        }
    }

    #[test]
    fn pictures_of_a_short_run_are_wide_and_small_pictures_are_not_enlarged() {
        assert_eq!(Thumbnails::for_run(6, 7).width(16.0 / 9.0), 960);
        let uri = Thumbnails::for_run(6, 7).encode(&filled(40, 20, [1, 2, 3])).unwrap();
        let bytes = STANDARD.decode(uri.strip_prefix("data:image/jpeg;base64,").unwrap()).unwrap();
        let decoded = image::load_from_memory(&bytes).unwrap();
        assert_eq!((decoded.width(), decoded.height()), (40, 20));
    }
}
