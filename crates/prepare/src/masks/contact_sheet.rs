//! One picture of many masks, to be looked at.

use super::sheet_path;
use crate::PrepareError;
use crate::extraction::file_name;
use crate::pictures::read_mask;
use ffgs_core::{ImageRgb8, ImageSize, Mask};
use ffgs_dataset::{Capture, Split, write_image};
use std::path::Path;

/// Frames of a camera, one beside the other.
const FRAMES: usize = 4;
/// Cameras that are shown; of more, some spread over the list.
const CAMERAS: usize = 24;
/// Width of a small picture (px).
const WIDTH: usize = 320;

/// Writes `masks.png`: a row per camera; what is no foreground is darkened.
pub(crate) fn write(capture: &Capture, seg: &Path) -> Result<(), PrepareError> {
    let views = capture.views(Split::Train);
    let spread = |count: usize, all: usize| (0..count.min(all)).map(move |i| i * all / count.min(all));
    let mut rows = Vec::new();
    for v in spread(CAMERAS, views.len()) {
        let mut row = Vec::new();
        for frame in spread(FRAMES, capture.frames()) {
            let image = capture.load_image(Split::Train, v, frame)?;
            let mask = read_mask(&seg.join(file_name(&views[v].name, frame)))?;
            row.push(small(&image, &mask));
        }
        rows.push(row);
    }
    Ok(write_image(&sheet_path(capture.root()), &joined(&rows))?)
}

fn small(image: &ImageRgb8, mask: &Mask) -> ImageRgb8 {
    let from = image.size();
    let width = WIDTH.min(from.width);
    let size = ImageSize { width, height: (from.height * width / from.width).max(1) };
    let data = (0..size.pixels()).flat_map(|i| {
        let (x, y) =
            ((i % size.width) * from.width / size.width, (i / size.width) * from.height / size.height);
        let at = y * from.width + x;
        let p = &image.data()[at * 3..at * 3 + 3];
        let dim = |v: u8| if mask.data()[at] == 1 { v } else { v / 4 };
        [dim(p[0]), dim(p[1]), dim(p[2]).max(if mask.data()[at] == 1 { 0 } else { 60 })]
    });
    ImageRgb8::new(size, data.collect()).expect("three values per pixel")
}

fn joined(rows: &[Vec<ImageRgb8>]) -> ImageRgb8 {
    let width = rows.iter().map(|r| r.iter().map(|i| i.size().width).sum::<usize>()).max().unwrap_or(1);
    let heights: Vec<usize> =
        rows.iter().map(|r| r.iter().map(|i| i.size().height).max().unwrap_or(1)).collect();
    let mut data = vec![0; width * heights.iter().sum::<usize>() * 3];
    let mut top = 0;
    for (row, height) in rows.iter().zip(&heights) {
        let mut left = 0;
        for image in row {
            let ImageSize { width: w, .. } = image.size();
            for (y, line) in image.data().chunks_exact(w * 3).enumerate() {
                data[((top + y) * width + left) * 3..][..w * 3].copy_from_slice(line);
            }
            left += w;
        }
        top += height;
    }
    ImageRgb8::new(ImageSize { width, height: heights.iter().sum() }, data).expect("the data has this size")
}
