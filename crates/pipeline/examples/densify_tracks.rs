//! Turns the tracks of one view into a motion field, tracker by tracker:
//! `cargo run --release --example densify_tracks -- CAPTURE CAMERA FRAME`

use anyhow::{Context, Result, bail};
use ffgs_core::ViewMotion;
use ffgs_method::{Split, ViewStep};
use ffgs_pipeline::plugins::registry::open_capture;
use ffgs_voronoi::{VoronoiConfig, densify_view};
use std::path::Path;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [capture, name, frame] = words.as_slice() else { bail!("CAPTURE CAMERA FRAME") };
    let capture = &*open_capture(Path::new(capture))?;
    let view = capture.views(Split::Train).iter().position(|view| view == name).context("no such camera")?;
    let frame: usize = frame.parse()?;
    if frame == 0 {
        bail!("motion leads into a frame from the one before it: the first is 1");
    }
    let mut step = ViewStep { capture, view, frame, size: ffgs_core::ImageSize { width: 0, height: 0 } };
    step.size = capture.camera(step.before())?.size();
    let mask =
        capture.mask(step.before())?.context("motion is densified over the mask, and there is none")?;
    for tracker in ffgs_tracks::sources(capture)? {
        let field = match tracker.motion(&step)?.map(|tracked| tracked.motion) {
            None => continue,
            Some(ViewMotion::Dense(field)) => field,
            Some(ViewMotion::Tracks(tracks)) => densify_view(&VoronoiConfig::default(), &tracks, &mask)?,
        };
        let known: Vec<_> = field.flow.iter().zip(&field.confidence).filter(|(_, c)| **c > 0.0).collect();
        let length: f32 = known.iter().map(|([x, y], _)| x.hypot(*y)).sum();
        println!("{}: {} pixels, mean {:.2} px", tracker.name(), known.len(), length / known.len() as f32);
    }
    Ok(())
}
