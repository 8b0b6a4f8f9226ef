//! The least time that a case's work takes at the machine's own rates.
//!
//! A pass computes and moves memory at the same time, so its floor is the longer of the two: counted vector operations
//! at the rate of `machine/fma`, counted bytes at that of `machine/copy`. A step's floor is the sum over its passes.
//! Counts are taken from the source; caches are assumed to hold nothing from one pass to the next but a tile's own.

use super::results::{Case, Work};
use std::collections::BTreeMap;
use std::path::Path;

/// Measured rates on one thread and on two: multiply-adds and bytes per second.
#[derive(Debug, Default)]
pub(crate) struct Rates {
    operations: [Option<f64>; 2],
    bytes: [Option<f64>; 2],
}

impl Rates {
    pub(crate) fn of(cases: &[Case]) -> Self {
        let rate = |name: &str| cases.iter().find(|c| c.name == name).map(|c| c.work.amount() / c.seconds);
        let both = |what: &str| [rate(&format!("machine/{what}/1t")), rate(&format!("machine/{what}/2t"))];
        Self { operations: both("fma"), bytes: both("copy") }
    }

    /// Seconds for a pass on one thread (0) or two (1).
    fn seconds(&self, pass: Pass, threads: usize) -> Option<f64> {
        Some((pass.operations / self.operations[threads]?).max(pass.bytes / self.bytes[threads]?))
    }
}

/// What a rendered case consists of; the benchmark counts it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Counts {
    pub gaussians: f64,
    /// SH coefficients of each, all channels.
    pub colours: f64,
    /// Gaussians that reach a tile.
    pub visible: f64,
    /// (tile, splat) pairs.
    pub pairs: f64,
    pub pixels: f64,
    /// (pixel, splat) pairs that are blended.
    pub contributions: f64,
}

/// Counts by scene (size/Gaussians), as the benchmark leaves them: a line `scene,gaussians,colours,visible,…` each.
pub(crate) fn read_counts(file: &Path) -> BTreeMap<String, Counts> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.lines().filter_map(parse).collect()
}

fn parse(line: &str) -> Option<(String, Counts)> {
    let mut fields = line.split(',');
    let scene = fields.next()?.to_owned();
    let mut next = || fields.next()?.parse().ok();
    let (gaussians, colours, visible) = (next()?, next()?, next()?);
    let (pairs, pixels, contributions) = (next()?, next()?, next()?);
    Some((scene, Counts { gaussians, colours, visible, pairs, pixels, contributions }))
}

/// Vector operations (one per lane) and bytes read plus written.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Pass {
    operations: f64,
    bytes: f64,
}

/// Position, rotation, scales, opacity (bytes).
const SHAPE: f64 = 44.0;
/// A projected splat (bytes).
const SPLAT: f64 = 64.0;
/// Operations of the loss with its gradient for a sample.
const LOSS: f64 = 200.0;
/// Operations for a contribution: the blend walk and its visitor; selects, loads and stores are not counted.
const FORWARD: f64 = 25.0;
const BACKWARD: f64 = 46.0;

impl Counts {
    /// Project all, colour and list what is visible, sort, blend.
    fn forward(&self) -> Pass {
        // Products and sums: covariance and its filter 170, exponentials and a logarithm 50; two a coefficient.
        let projection = self.gaussians * 220.0 + self.visible * 2.0 * self.colours;
        // A list entry is written with its place, sorted where it lies, and read.
        let lists = self.pairs * (8.0 + 4.0 + 4.0 + 16.0 + 8.0 + SPLAT);
        let colours = 4.0 * self.colours * self.visible;
        // Tile results are written and composed: colour and transmittance twice.
        let pixels = self.pixels * 48.0;
        Pass {
            operations: projection + self.contributions * FORWARD,
            bytes: self.gaussians * SHAPE + colours + self.visible * SPLAT + lists + pixels,
        }
    }

    /// Blend backwards, sum over tiles, differentiate the projection.
    fn backward(&self) -> Pass {
        let projection = self.visible * (600.0 + 6.0 * self.colours);
        let pairs = self.pairs * (8.0 + SPLAT + 36.0 + 4.0 + 36.0);
        let parameters = self.visible * 2.0 * (SHAPE + 4.0 * self.colours);
        Pass {
            operations: projection + self.contributions * BACKWARD,
            bytes: pairs + parameters + self.pixels * 28.0,
        }
    }

    /// Reads image and photograph, writes the gradient.
    fn loss(&self) -> Pass {
        Pass { operations: 3.0 * self.pixels * LOSS, bytes: self.pixels * (12.0 + 3.0 + 12.0) }
    }

    /// Parameter, gradient and two moments read, all but the gradient written; some ten operations.
    fn adam(&self) -> Pass {
        let values = self.visible * (11.0 + self.colours);
        Pass { operations: 10.0 * values, bytes: 28.0 * values }
    }
}

/// Seconds; `None` where a rate is missing.
pub(crate) fn seconds(case: &Case, rates: &Rates, counts: &BTreeMap<String, Counts>) -> Option<f64> {
    let threads = usize::from(!case.name.ends_with("/1t"));
    let sum = |passes: &[Pass]| passes.iter().map(|&p| rates.seconds(p, threads)).sum();
    let mut parts = case.name.splitn(3, '/');
    let (group, what, rest) = (parts.next()?, parts.next()?, parts.next().unwrap_or_default());
    let scene = rest.rsplit_once('/').map_or(rest, |(scene, _)| scene);
    match (group, what, counts.get(scene)) {
        ("raster", "forward", Some(c)) => sum(&[c.forward()]),
        ("raster", "backward", Some(c)) => sum(&[c.backward()]),
        ("raster", "step", Some(c)) => sum(&[c.forward(), c.loss(), c.backward(), c.adam()]),
        _ => plain(case, rates, threads),
    }
}

/// Work of one kind.
fn plain(case: &Case, rates: &Rates, threads: usize) -> Option<f64> {
    let each = match case.name.split('/').next() {
        Some("machine" | "trackers") => 1.0,
        Some("loss") => LOSS,
        _ => FORWARD + BACKWARD,
    };
    match case.work {
        Work::Elements(n) => rates.operations[threads].map(|rate| n * each / rate),
        Work::Bytes(n) => rates.bytes[threads].map(|rate| n / rate),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(name: &str, work: Work) -> Case {
        Case { name: name.to_owned(), seconds: 1.0, work }
    }

    fn rates() -> Rates {
        Rates::of(&[
            case("machine/fma/1t", Work::Elements(1e9)),
            case("machine/fma/2t", Work::Elements(2e9)),
            case("machine/copy/1t", Work::Bytes(1e8)),
            case("machine/copy/2t", Work::Bytes(1e8)),
        ])
    }

    #[test]
    fn plain_work_runs_at_the_rate_of_as_many_threads() {
        let floor = |name, work| seconds(&case(name, work), &rates(), &BTreeMap::new()).unwrap();
        assert!((floor("adam/dense", Work::Bytes(1e8)) - 1.0).abs() < 1e-9);
        assert!((floor("loss/full/a", Work::Elements(1e7)) - 1.0).abs() < 1e-9);
        assert!((floor("dynamic_lane/1%/1t", Work::Elements(1e7)) - 0.71).abs() < 1e-9);
    }

    #[test]
    fn a_pass_takes_the_longer_of_computing_and_moving() {
        let line = "a/20k,0,0,0,0,0,2e7\nb/20k,0,0,0,2e6,0,0\n";
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), line).unwrap();
        let counts = read_counts(file.path());
        let floor = |name| seconds(&case(name, Work::Elements(1.0)), &rates(), &counts).unwrap();
        // 2e7 contributions of 25 operations; 2e6 pairs of 104 bytes.
        assert!((floor("raster/forward/a/20k/1t") - 0.5).abs() < 1e-9);
        assert!((floor("raster/forward/a/20k/2t") - 0.25).abs() < 1e-9);
        assert!((floor("raster/forward/b/20k/2t") - 2.08).abs() < 1e-9);
        assert!((floor("raster/step/a/20k/1t") - 1.42).abs() < 1e-9);
    }
}
