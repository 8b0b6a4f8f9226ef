//! The training views of the first frame, from which points are made.

use crate::{PrepareError, dark};
use ffgs_core::{Camera, ImageRgb8, Mask};
use ffgs_dataset::{Capture, Split};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// One training view of the first frame.
pub(crate) struct View {
    pub camera: Camera,
    pub image: ImageRgb8,
    pub mask: Option<Mask>,
}

impl View {
    /// Whether the mask contains a pixel of the image.
    pub(crate) fn is_foreground(&self, pixel: DVec2) -> bool {
        self.mask.as_ref().is_some_and(|m| m.contains(pixel.x as usize, pixel.y as usize))
    }

    /// sRGB (0 to 1) of a pixel of the image.
    pub(crate) fn colour(&self, pixel: DVec2) -> [f32; 3] {
        self.image.pixel(pixel.y as usize * self.image.size().width + pixel.x as usize)
    }

    /// The point of a pixel at a depth (m).
    pub(crate) fn at_depth(&self, pixel: DVec2, depth: f64) -> DVec3 {
        at_depth(&self.camera, pixel, depth)
    }
}

/// The point of a pixel of a camera at a depth (m).
pub(crate) fn at_depth(camera: &Camera, pixel: DVec2, depth: f64) -> DVec3 {
    let ray = camera.ray(pixel);
    camera.center() + ray * (depth / ray.dot(camera.rotation().row(2)))
}

/// Reads them; dark pictures are multiplied by the gain that is returned, 1 where they are not dark.
///
/// # Errors
/// When one of them cannot be read.
pub(crate) fn load(capture: &Capture) -> Result<(Vec<View>, f32), PrepareError> {
    let view = |v: usize| -> Result<View, PrepareError> {
        Ok(View {
            camera: capture.camera(Split::Train, v, 0)?,
            image: capture.load_image(Split::Train, v, 0)?,
            mask: capture.load_mask(Split::Train, v, 0)?,
        })
    };
    let all = (0..capture.views(Split::Train).len()).into_par_iter().map(view);
    let views: Vec<View> = all.collect::<Result<_, _>>()?;
    let gain = dark::gain(views.iter().map(|view| &view.image));
    let bright = |view: View| View { image: dark::brightened(view.image, gain), ..view };
    Ok((views.into_iter().map(bright).collect(), gain))
}
