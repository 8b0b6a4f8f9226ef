//! Pictures of motion and uncertainty: dots over the dimmed photograph, with a legend.

use crate::colour::{hsv, viridis};
use ffgs_core::{Camera, ImageRgb8, ImageSize};
use glam::{DMat3, DVec2, DVec3};
use std::f64::consts::TAU;
use thiserror::Error;

/// Share of its brightness that the photograph keeps under the dots.
const DIM: f64 = 0.35;
/// Magnitude that gets full colour: this quantile of the magnitudes, so that a stray does not wash out the rest.
const FULL_COLOUR_QUANTILE: f64 = 0.95;
/// Quantiles that the uncertainty's colour bar spans.
const BAR_QUANTILES: [f64; 2] = [0.02, 0.98];

/// Why an overlay cannot be drawn.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OverlayError {
    /// Two columns that go together differ in length.
    #[error("{expected} means come with {found} values")]
    Length {
        /// Number of means.
        expected: usize,
        /// Length of the other column.
        found: usize,
    },
    /// The background is not of the camera's size.
    #[error("the background has {}x{} pixels, its camera {}x{}", .background.width, .background.height,
        .camera.width, .camera.height)]
    Size {
        /// Size of the background (px).
        background: ImageSize,
        /// Size of the camera's image (px).
        camera: ImageSize,
    },
}

/// Motion from `means_prev` to `means_now` (m, one per Gaussian) as `camera` sees it, over the dimmed `background`:
/// hue = direction of the projected displacement, saturation = its length, up to the 95 % quantile. The wheel in the
/// corner is the legend: its rim has the colours of motions towards that side of the length written below it (px).
///
/// # Errors
/// When the columns differ in length, or background and camera in size.
pub fn motion_picture(
    camera: &Camera,
    means_prev: &[DVec3],
    means_now: &[DVec3],
    background: &ImageRgb8,
) -> Result<ImageRgb8, OverlayError> {
    check(camera, means_prev.len(), means_now.len(), background)?;
    let seen = |(prev, now): (&DVec3, &DVec3)| {
        let (prev, now) = (camera.project(*prev)?, camera.project(*now)?);
        let motion = now.pixel - prev.pixel;
        motion.is_finite().then_some((now.depth, now.pixel, motion))
    };
    let dots: Vec<(f64, DVec2, DVec2)> = means_prev.iter().zip(means_now).filter_map(seen).collect();
    let full = quantile(dots.iter().map(|d| d.2.length()), FULL_COLOUR_QUANTILE).unwrap_or(1.0).max(1e-6);
    let mut canvas = Canvas::dimmed(background);
    let colour = |(depth, at, motion): (f64, DVec2, DVec2)| (depth, at, motion_colour(motion / full));
    canvas.dots(dots.into_iter().map(colour).collect());
    canvas.wheel(full);
    Ok(canvas.finish())
}

/// Position uncertainty, sqrt(tr Sigma), of each Gaussian (covariances in m^2) as dots in viridis over the dimmed
/// `background`, logarithmic. The bar spans the 2 % to the 98 % quantile; its end values are written beside it, in the
/// unit of the means: a capture need not say which one that is.
///
/// # Errors
/// When the columns differ in length, or background and camera in size.
pub fn uncertainty_picture(
    camera: &Camera,
    means: &[DVec3],
    covariances: &[DMat3],
    background: &ImageRgb8,
) -> Result<ImageRgb8, OverlayError> {
    check(camera, means.len(), covariances.len(), background)?;
    let seen = |(mean, covariance): (&DVec3, &DMat3)| {
        let projection = camera.project(*mean)?;
        let trace = covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z;
        (trace > 0.0 && trace.is_finite()).then(|| (projection.depth, projection.pixel, trace.sqrt().log10()))
    };
    let dots: Vec<(f64, DVec2, f64)> = means.iter().zip(covariances).filter_map(seen).collect();
    let limits = BAR_QUANTILES.map(|q| quantile(dots.iter().map(|d| d.2), q).unwrap_or(0.0));
    let [low, high] = [limits[0], limits[1].max(limits[0] + 0.1)];
    let mut canvas = Canvas::dimmed(background);
    let colour = |(depth, at, log): (f64, DVec2, f64)| (depth, at, viridis((log - low) / (high - low)));
    canvas.dots(dots.into_iter().map(colour).collect());
    canvas.bar([low, high]);
    Ok(canvas.finish())
}

fn check(camera: &Camera, expected: usize, found: usize, background: &ImageRgb8) -> Result<(), OverlayError> {
    if expected != found {
        return Err(OverlayError::Length { expected, found });
    }
    let (background, camera) = (background.size(), camera.size());
    if background == camera { Ok(()) } else { Err(OverlayError::Size { background, camera }) }
}

/// `motion` relative to the length with full colour; y points down, as in the image.
fn motion_colour(motion: DVec2) -> [u8; 3] {
    hsv(motion.y.atan2(motion.x) / TAU, motion.length().min(1.0), 1.0)
}

fn quantile(values: impl Iterator<Item = f64>, share: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get((sorted.len().saturating_sub(1) as f64 * share).round() as usize).copied()
}

struct Canvas {
    size: ImageSize,
    data: Vec<u8>,
}

impl Canvas {
    fn dimmed(background: &ImageRgb8) -> Self {
        let dim = |&v: &u8| (f64::from(v) * DIM) as u8;
        Self { size: background.size(), data: background.data().iter().map(dim).collect() }
    }

    fn finish(self) -> ImageRgb8 {
        let Self { size, data } = self;
        // The data kept the background's length; the fallback is never taken.
        ImageRgb8::new(size, data).unwrap_or_else(|| ImageRgb8::from(&ffgs_core::PlanarImage::zeros(size)))
    }

    fn set(&mut self, x: f64, y: f64, colour: [u8; 3]) {
        let inside = x >= 0.0 && y >= 0.0 && x < self.size.width as f64 && y < self.size.height as f64;
        if inside {
            let start = 3 * (y as usize * self.size.width + x as usize);
            self.data[start..start + 3].copy_from_slice(&colour);
        }
    }

    fn rectangle(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], colour: [u8; 3]) {
        for row in 0..height as usize {
            for column in 0..width as usize {
                self.set(x + column as f64, y + row as f64, colour);
            }
        }
    }

    /// 2 x 2 pixels each, the nearest last.
    fn dots(&mut self, mut dots: Vec<(f64, DVec2, [u8; 3])>) {
        dots.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, at, colour) in dots {
            let corner = (at - 0.5).floor();
            self.rectangle([corner.x, corner.y], [2.0; 2], colour);
        }
    }

    /// Size of legends: a ninth of the shorter side, readable from 16 px.
    fn legend_size(&self) -> f64 {
        (self.size.width.min(self.size.height) as f64 / 9.0).max(16.0).floor()
    }

    /// The rim's motion, `full` pixels, is written below.
    fn wheel(&mut self, full: f64) {
        let radius = self.legend_size();
        let centre = DVec2::splat(radius + 6.0);
        let reach = radius as i64 + 2;
        for y in -reach..=reach {
            for x in -reach..=reach {
                let offset = DVec2::new(x as f64, y as f64);
                let length = offset.length();
                let colour = if length <= radius { motion_colour(offset / radius) } else { [20; 3] };
                if length <= radius + 2.0 {
                    self.set(centre.x + offset.x, centre.y + offset.y, colour);
                }
            }
        }
        let (label, scale) = (format!("{} px", short(full)), self.text_scale());
        let corner = [6.0, 2.0 * radius + 14.0];
        let width = 4.0 * scale * label.len() as f64;
        self.rectangle([corner[0] - 3.0, corner[1] - 3.0], [width + 6.0, 5.0 * scale + 6.0], [20; 3]);
        self.text(corner, &label, scale);
    }

    /// Pixels per dot of a glyph.
    fn text_scale(&self) -> f64 {
        (self.legend_size() / 22.0).round().max(1.0)
    }

    /// A vertical bar over `[low, high]` (log10), with the values at its ends.
    fn bar(&mut self, [low, high]: [f64; 2]) {
        let height = 2.5 * self.legend_size();
        let scale = self.text_scale();
        let (left, top, width) = (8.0, 8.0, 6.0 * scale);
        let box_width = width + 8.0 + 4.0 * scale * 8.0;
        self.rectangle([2.0, 2.0], [box_width, height + 12.0], [20; 3]);
        for row in 0..height as usize {
            let colour = viridis(1.0 - row as f64 / height);
            self.rectangle([left, top + row as f64], [width, 1.0], colour);
        }
        let text_left = left + width + 4.0;
        let [low_text, high_text] = [low, high].map(|log| two_digits(10f64.powf(log)));
        self.text([text_left, top], &high_text, scale);
        self.text([text_left, top + height - 5.0 * scale], &low_text, scale);
    }

    fn text(&mut self, [mut left, top]: [f64; 2], text: &str, scale: f64) {
        for character in text.chars() {
            for (row, bits) in glyph(character).into_iter().enumerate() {
                for column in (0..3).filter(|c| bits >> (2 - c) & 1 == 1) {
                    let at = [left + column as f64 * scale, top + row as f64 * scale];
                    self.rectangle(at, [scale; 2], [240; 3]);
                }
            }
            left += 4.0 * scale;
        }
    }
}

/// At most five characters.
fn short(value: f64) -> String {
    match value {
        v if v >= 10.0 => format!("{:.0}", v.min(99_999.0)),
        v if v >= 1.0 => format!("{v:.1}"),
        v => format!("{v:.2}"),
    }
}

/// A positive value of any size with two significant digits, in at most seven characters.
fn two_digits(value: f64) -> String {
    if !(1e-4..1e6).contains(&value) {
        return format!("{value:.0e}");
    }
    let decimals = (1.0 - value.log10().floor()).max(0.0) as usize;
    format!("{value:.decimals$}")
}

/// Five rows of three pixels.
fn glyph(character: char) -> [u8; 5] {
    match character {
        '0' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 7, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 1, 2, 2],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        '.' => [0, 0, 0, 0, 2],
        '-' => [0, 0, 7, 0, 0],
        'e' => [7, 5, 7, 4, 7],
        'p' => [0, 7, 5, 7, 4],
        'x' => [0, 5, 2, 2, 5],
        _ => [0; 5],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_every_unit_have_two_digits() {
        let written = [4.2e-6, 4.2e-4, 0.042, 0.42, 4.24, 42.4, 4200.0, 4.2e7].map(two_digits);
        assert_eq!(written, ["4e-6", "0.00042", "0.042", "0.42", "4.2", "42", "4200", "4e7"]);
        assert!(written.iter().flat_map(|text| text.chars()).all(|c| glyph(c) != [0; 5]), "all can be drawn");
    }
}
