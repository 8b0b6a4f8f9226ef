//! How an export looks in a player, beside the run's own renders.

use crate::outputs::picture::{draw, panorama_picture};
use crate::outputs::scoring::{ScoredView, load_tests};
use anyhow::Result;
use ffgs_core::{Gaussians, ImageSize, Mask, Scene};
use ffgs_method::Capture;
use ffgs_metrics::mpsnr;
use ffgs_reconstruction::Exposures;
use ffgs_splats::Panorama;
use ffgs_trainer::sky_picture;
use serde::{Deserialize, Serialize};

/// Transmittance below which a pixel of the run's own render counts as opaque.
const OPAQUE: f32 = 0.01;

/// What a player shows of a frame.
pub(crate) struct Shown<'a> {
    /// Of both scene.
    pub gaussians: &'a Gaussians,
    /// The sky; absent where it is the run's own.
    pub sky: Option<&'a Panorama>,
}

/// Means over the test views of a frame, against the photographs (dB); absent where no pixel counts.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Measurement {
    /// Frame.
    pub frame: usize,
    /// All pixels.
    pub all: Pair,
    /// Those that are opaque in the run's render.
    pub opaque: Pair,
    /// Those of the foreground.
    pub foreground: Pair,
}

/// PSNR (dB) of two renders over the same pixels.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Pair {
    /// Of the run.
    pub run: Option<f64>,
    /// Of the export.
    pub export: Option<f64>,
}

/// Renders the test views of a frame twice and compares both with the photographs.
pub(crate) fn measure(
    (capture, exposures): (&dyn Capture, &Exposures),
    scene: &Scene,
    shown: &Shown,
    frame: usize,
) -> Result<Measurement> {
    let mut sums: [Sums; 3] = Default::default();
    for ScoredView { truth, exposure, .. } in load_tests(capture, exposures, frame)?.0 {
        let camera = &truth.camera;
        let own_sky = sky_picture(&scene.sky, camera);
        let (mut ours, transmittance) = draw(&scene.layers(), camera, &own_sky);
        let opaque = opaque(camera.size(), &transmittance);
        let behind = shown.sky.map_or(own_sky, |sky| panorama_picture(sky, camera));
        let (mut theirs, _) = draw(&[shown.gaussians], camera, &behind);
        exposure.apply(&mut ours);
        exposure.apply(&mut theirs);
        let everything = Mask::filled(camera.size(), true);
        for (sums, mask) in sums.iter_mut().zip([&everything, &opaque, &truth.mask]) {
            sums.run.extend(mpsnr(&ours, &truth.image, mask)?);
            sums.export.extend(mpsnr(&theirs, &truth.image, mask)?);
        }
    }
    let [all, opaque, foreground] = sums.map(|s| Pair { run: mean(&s.run), export: mean(&s.export) });
    Ok(Measurement { frame, all, opaque, foreground })
}

/// Values of each view.
#[derive(Default)]
struct Sums {
    run: Vec<f64>,
    export: Vec<f64>,
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Pixels that are opaque.
fn opaque(size: ImageSize, transmittance: &[f32]) -> Mask {
    let opaque = transmittance.iter().map(|&t| u8::from(t < OPAQUE)).collect();
    Mask::new(size, opaque).unwrap_or_else(|| Mask::filled(size, true))
}

/// One row per frame, and the means.
pub(crate) fn table(frames: &[Measurement]) -> String {
    let titles =
        ["all pixels (dB)", "opaque pixels (dB)", "foreground (dB)"].map(|name| format!("  {name:>24}"));
    let columns = format!("  {:>8}{:>8}{:>8}", "run", "export", "change").repeat(titles.len());
    let rows: Vec<String> =
        frames.iter().map(|m| row(&m.frame.to_string(), [m.all, m.opaque, m.foreground])).collect();
    let text = format!("{:>6}{}\n{:>6}{columns}\n{}", "", titles.concat(), "frame", rows.concat());
    let average = |of: fn(&Measurement) -> Pair| {
        let part = |part: fn(Pair) -> Option<f64>| {
            mean(&frames.iter().filter_map(|m| part(of(m))).collect::<Vec<_>>())
        };
        Pair { run: part(|p| p.run), export: part(|p| p.export) }
    };
    text + &row("mean", [average(|m| m.all), average(|m| m.opaque), average(|m| m.foreground)])
}

fn row(name: &str, pairs: [Pair; 3]) -> String {
    let cells = |pair: Pair| match (pair.run, pair.export) {
        (Some(run), Some(export)) => format!("  {run:8.2}{export:8.2}{:+8.2}", export - run),
        _ => format!("  {:>8}{:>8}{:>8}", "-", "-", "-"),
    };
    format!("{name:>6}{}\n", pairs.map(cells).concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_shows_frames_means_and_what_is_absent() {
        let pair = |run, export| Pair { run: Some(run), export: Some(export) };
        let of = |frame, all, foreground| Measurement { frame, all, foreground, opaque: all };
        let frames = [of(0, pair(24.0, 23.5), Pair::default()), of(1, pair(26.0, 26.5), pair(20.0, 19.0))];
        let text = table(&frames);
        let words: Vec<Vec<&str>> = text.lines().skip(2).map(|l| l.split_whitespace().collect()).collect();
        assert_eq!(words[0], ["0", "24.00", "23.50", "-0.50", "24.00", "23.50", "-0.50", "-", "-", "-"]);
        assert_eq!(words[2][..4], ["mean", "25.00", "25.00", "+0.00"]);
        assert_eq!(words[2][7..], ["20.00", "19.00", "-1.00"]);
    }
}
