//! `metrics.json` and `report.html`.

use crate::job::manifest::Manifest;
use crate::outputs::exposure_files::{exposures_fact, read_usual};
use crate::outputs::folder::RunFolder;
use crate::outputs::json::{read_json, write_json};
use crate::outputs::record::{FrameRecord, Metrics, ViewMetrics};
use anyhow::{Context, Result};
use ffgs_core::{read_text, write_atomically};
use ffgs_prepare::Summary;
use ffgs_report::{Fact, FrameReport, ReportInput, SkipCount, ViewReport};
use std::collections::BTreeMap;
use std::io::{self, Write};

/// It holds a sentence per camera and step.
const MAX_PREPARATION_BYTES: u64 = 1 << 24;

/// Writes `metrics.json` and `report.html`. The report copies the encoded pictures of each frame from its folder.
///
/// # Errors
/// When a file cannot be written.
pub fn publish(folder: &RunFolder, manifest: &Manifest, metrics: &Metrics) -> Result<()> {
    let mut facts = manifest.facts();
    write_json(&folder.0.join("metrics.json"), metrics)?;
    let mut skips = BTreeMap::<String, u64>::new();
    for (what, count) in metrics.frames.iter().flat_map(|f| &f.log.skips) {
        *skips.entry(what.clone()).or_default() += count;
    }
    let peak =
        |held: fn(&FrameRecord) -> Option<f64>| metrics.frames.iter().filter_map(held).reduce(f64::max);
    let memory =
        [("peak memory", peak(|f| f.peak_memory_mib)), ("peak memory of a GPU", peak(|f| f.gpu_memory_mib))];
    let fact = |(name, mib): (&str, Option<f64>)| {
        Some(Fact { name: name.into(), value: format!("{:.0} MiB", mib?) })
    };
    facts.extend(memory.into_iter().filter_map(fact));
    let changing = metrics.frames.iter().filter(|f| folder.exposures_of(f.frame).exists()).count();
    let exposures = exposures_fact(&read_usual(folder)?, changing);
    facts.extend(exposures.map(|value| Fact { name: "exposures".into(), value }));
    let scored = folder.motion_accuracy();
    let input = ReportInput {
        motion: if scored.exists() { read_json(&scored)? } else { Vec::new() },
        title: format!("fastflowgs: {}", manifest.capture),
        turntable: Some(folder.turntable()).filter(|path| path.exists()),
        cameras: Some(folder.cameras()).filter(|path| path.exists()),
        configuration: manifest.config.to_toml()?,
        facts,
        preparation: preparation(folder, manifest)?,
        trained_on: metrics.mean_training_views.is_some(),
        frames: metrics.frames.iter().map(|f| frame_report(folder, f)).collect(),
        skips: skips.into_iter().map(|(what, count)| SkipCount { what, count }).collect(),
        warnings: metrics
            .frames
            .iter()
            .flat_map(|f| f.log.warnings.iter().map(|w| format!("frame {}: {w}", f.frame)))
            .collect(),
    };
    let report = folder.0.join("report.html");
    ffgs_report::write_report(&report, &input).with_context(|| format!("cannot write {}", report.display()))
}

/// How the capture was prepared. The file is copied, because the capture may be elsewhere when the report is made again.
/// A run does not depend on it: a damaged one is told in the report.
fn preparation(folder: &RunFolder, manifest: &Manifest) -> Result<Vec<Fact>> {
    let (source, copy) = (manifest.capture_path.join(Summary::FILE), folder.preparation());
    if let Ok(text) = read_text(&source, MAX_PREPARATION_BYTES) {
        write_atomically::<io::Error>(&copy, |w| w.write_all(text.as_bytes()))
            .with_context(|| format!("cannot write {}", copy.display()))?;
    }
    if !copy.is_file() {
        return Ok(Vec::new());
    }
    let fact = |(name, value)| Fact { name, value };
    Ok(match Summary::read(&copy) {
        Ok(summary) => summary.rows.into_iter().map(fact).collect(),
        Err(error) => vec![fact((Summary::FILE.to_owned(), error.to_string()))],
    })
}

fn frame_report(folder: &RunFolder, f: &FrameRecord) -> FrameReport {
    let view = |v: &ViewMetrics| ViewReport {
        name: v.camera.clone(),
        psnr: Some(v.psnr),
        mpsnr: v.mpsnr,
        ssim: Some(v.ssim),
        vmaf: v.vmaf,
        flicker: v.flicker,
        mssim: v.mssim,
        mvmaf: v.mvmaf,
        mflicker: v.mflicker,
    };
    FrameReport {
        index: f.frame,
        views: f.measured().map(view).collect(),
        initial_mpsnr: f.initial_mpsnr,
        static_gaussians: f.static_gaussians,
        dynamic_gaussians: f.dynamic_gaussians,
        bytes: f.bytes,
        changes: f.log.changes.clone(),
        seconds: f.log.seconds.clone(),
        pictures: Some(folder.pictures(f.frame)).filter(|path| path.exists()),
    }
}
