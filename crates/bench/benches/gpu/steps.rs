//! A training step and its parts, whole and kernel by kernel, and the forward pass of the same frame on the CPU.

use crate::rows::{Rows, median};
use crate::scene::{camera, contributions, discs, training_view};
use anyhow::{Context, Result};
use ffgs_core::{ImageSize, Mask};
use ffgs_gpu::Gpu;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, View};
use ffgs_trainer_gpu::{Counts, Floor, Part, Probe};
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviation over spacing, as trained scenes have it and as in the CPU's cases.
const SPREAD: f32 = 0.45;
const OPTIONS: RenderOptions = RenderOptions { sh_degree: None, dropout: None, at_centres: false };
const PARTS: [(&str, Part); 5] = [
    ("forward", Part::Forward),
    ("loss", Part::Loss),
    ("backward", Part::Backward),
    ("adam", Part::Adam),
    ("step", Part::Step),
];

/// Rows `gpu/PART/SIZE/COUNT`, `gpu/round_trip/SIZE/COUNT` (density control), `kernel/NAME/SIZE/COUNT` and `cpu/forward/SIZE/COUNT`.
pub(crate) fn step(gpu: &Gpu, size: ImageSize, count: usize, rows: &mut Rows) -> Result<()> {
    let case = format!("{}x{}/{count}", size.width, size.height);
    let gaussians = discs(count, 3, SPREAD);
    let view = training_view(&gaussians, camera(size, 0.0), Mask::filled(size, true));
    let blended = contributions(&gaussians, &view.camera, None);
    let frame = View { camera: &view.camera, background: Background::Colour([0.3; 3]), tiles: None };
    let (rasterizer, mut tape) = (CpuRasterizer::new(OPTIONS), RenderTape::default());
    let seconds = rows.time(|| rasterizer.render(&gaussians, &frame, &mut tape));
    rows.add(&format!("cpu/forward/{case}"), seconds, None);
    let mut probe = Probe::new(gpu, &gaussians, &view, OPTIONS)?;
    let counts = probe.counts(blended)?;
    for (name, part) in PARTS {
        let seconds = rows.time_on(gpu, || probe.run(part))?;
        let floor = floor_of(&probe, part, &counts)?;
        rows.add(&format!("gpu/{name}/{case}"), seconds, floor);
    }
    for (kernel, seconds) in kernel_times(&probe, Part::Step, rows.samples())? {
        let floor = counts.floor(kernel).with_context(|| format!("{kernel} has no floor"))?;
        rows.add(&format!("kernel/{kernel}/{case}"), seconds, Some(floor));
    }
    let mut moved = probe.round_trip();
    let seconds = rows.time(|| moved = probe.round_trip());
    let floor = Floor { bytes: moved? as f64, operations: 0.0 };
    rows.add(&format!("gpu/round_trip/{case}"), seconds, Some(floor));
    gpu.release_unused();
    Ok(())
}

/// Sum over the kernels of a part.
fn floor_of(probe: &Probe, part: Part, counts: &Counts) -> Result<Option<Floor>> {
    let Some(times) = probe.times(part)? else { return Ok(None) };
    let kernels: BTreeSet<&str> = times.iter().map(|t| t.kernel).collect();
    let floors = kernels.iter().filter_map(|kernel| counts.floor(kernel));
    Ok(Some(floors.fold(Floor::default(), |sum, f| Floor {
        bytes: sum.bytes + f.bytes,
        operations: sum.operations + f.operations,
    })))
}

/// Median seconds of each kernel in a submission, over all its dispatches; none without timestamps.
fn kernel_times(probe: &Probe, part: Part, samples: usize) -> Result<BTreeMap<&'static str, f64>> {
    let mut all: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for _ in 0..samples {
        let mut sums: BTreeMap<&str, f64> = BTreeMap::new();
        for time in probe.times(part)?.unwrap_or_default() {
            *sums.entry(time.kernel).or_default() += time.seconds;
        }
        sums.into_iter().for_each(|(kernel, seconds)| all.entry(kernel).or_default().push(seconds));
    }
    Ok(all.into_iter().map(|(kernel, seconds)| (kernel, median(seconds))).collect())
}
