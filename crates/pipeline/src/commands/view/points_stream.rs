//! What `ffgs view` shows of a capture without a run: its initial points as a stream.

use crate::commands::export::axes::Axes;
use crate::commands::export::stream::PRECISION;
use anyhow::Result;
use ffgs_core::{Gaussians, PixelFilter};
use ffgs_method::{Capture, Points};
use ffgs_stream::{Frame, Manifest, Steps, Writer};
use ffgs_trainer::from_points;
use std::path::Path;

/// Opacity of a point.
const OPACITY: f32 = 0.9;
/// At which the photographs play.
const FRAMES_PER_SECOND: f64 = 30.0;

/// Writes a stream with the same points in each frame of a capture; without points its layers are empty.
///
/// # Errors
/// When cameras or points cannot be read, or the folder cannot be written.
pub(crate) fn write_points(capture: &dyn Capture, folder: &Path) -> Result<()> {
    let points = capture.points()?;
    let layer =
        |foreground: bool| points.as_ref().map_or_else(|| Gaussians::zeros(0, 0), |p| discs(p, foreground));
    let [still, moving] = [false, true].map(layer);
    let ids: Vec<u32> = (0..moving.len() as u32).collect();
    let axes = Axes::of(capture, 0)?;
    let manifest = Manifest {
        format: String::new(),
        version: 0,
        title: capture.root().file_name().unwrap_or_default().to_string_lossy().into_owned(),
        frames_per_second: FRAMES_PER_SECOND,
        antialiased: false,
        up: axes.up.to_array(),
        forward: axes.forward.to_array(),
        static_steps: Steps::of(&still, &PRECISION[0]),
        dynamic_steps: Steps::of(&moving, &PRECISION[1]),
    };
    // Nothing changes: one key is enough.
    let mut writer = Writer::create(folder, manifest, [&still, &moving], PRECISION.each_ref(), u64::MAX)?;
    for frame in 0..capture.frames() as u64 {
        let (static_layer, dynamic_layer) = (&still, &moving);
        writer.push(&Frame {
            frame,
            static_layer,
            dynamic_layer,
            ids: &ids,
            uncertainty: None,
            sky: &[],
            sky_has_changed: false,
            importance: None,
        })?;
    }
    Ok(())
}

/// The points of one kind, as training starts from them.
fn discs(points: &Points, foreground: bool) -> Gaussians {
    let of_kind = |i: &usize| points.foreground[*i] == foreground;
    let chosen: Vec<usize> = (0..points.positions.len()).filter(of_kind).collect();
    let of = |column: &[[f32; 3]]| -> Vec<[f32; 3]> { chosen.iter().map(|&i| column[i]).collect() };
    let discs = from_points(&of(&points.positions), &of(&points.colours), 0, OPACITY);
    discs.with_filter(PixelFilter::Plain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_stream::Reader;

    #[test]
    fn the_sample_is_shown_by_its_points() {
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let (capture, folder) =
            (crate::plugins::registry::open_capture(&sample).unwrap(), tempfile::tempdir().unwrap());
        write_points(&*capture, folder.path()).unwrap();
        let mut reader = Reader::open(folder.path()).unwrap();
        assert_eq!(reader.entries().len(), capture.frames());
        let points = capture.points().unwrap().unwrap();
        let last = reader.read(capture.frames() as u64 - 1).unwrap();
        assert_eq!(last.static_layer.len() + last.dynamic_layer.len(), points.positions.len());
        assert!(reader.entries()[1].bytes < reader.entries()[0].bytes / 100);
    }
}
