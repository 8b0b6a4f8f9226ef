//! The table: a line per case, and lines with `#` about the adapter.

use ffgs_gpu::{Gpu, GpuError};
use ffgs_trainer_gpu::Floor;
use std::fmt::Write as _;
use std::time::Instant;

/// Measured cases as text: name, seconds, bytes and operations at least.
pub(crate) struct Rows {
    text: String,
    samples: usize,
}

impl Rows {
    pub(crate) fn new(gpu: &Gpu, samples: usize) -> Self {
        let report = gpu.report();
        let clock = if report.timestamps {
            "kernels by timestamps, each in a pass of its own"
        } else {
            "no timestamps: whole submissions only"
        };
        let kind = if report.software { "software" } else { "hardware" };
        let text = format!(
            "# {} ({kind}); {} {}; {}; {clock}\nname,seconds,bytes,operations\n",
            report.name,
            report.backend,
            report.driver,
            report.path()
        );
        Self { text, samples: samples.max(1) }
    }

    pub(crate) fn add(&mut self, name: &str, seconds: f64, floor: Option<Floor>) {
        let work = floor.map_or_else(|| ",".to_owned(), |f| format!("{:.0},{:.0}", f.bytes, f.operations));
        eprintln!("{name:<52} {:>12.3} ms", seconds * 1e3);
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "{name},{seconds:.6e},{work}");
    }

    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    /// Median seconds of `work` on the host, once done before.
    pub(crate) fn time(&self, mut work: impl FnMut()) -> f64 {
        work();
        self.median(|| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
    }

    /// The same of work that may fail.
    pub(crate) fn try_time(&self, mut work: impl FnMut() -> anyhow::Result<()>) -> anyhow::Result<f64> {
        let mut result = Ok(());
        let seconds = self.time(|| {
            if result.is_ok() {
                result = work();
            }
        });
        result.map(|()| seconds)
    }

    /// Median seconds of one submission of `work` among as many as take a tenth of a second, to the end of the last.
    pub(crate) fn time_on(
        &self,
        gpu: &Gpu,
        mut work: impl FnMut() -> Result<(), GpuError>,
    ) -> Result<f64, GpuError> {
        let mut run = |times: usize| -> Result<f64, GpuError> {
            let start = Instant::now();
            (0..times).try_for_each(|_| work())?;
            gpu.finish()?;
            Ok(start.elapsed().as_secs_f64() / times as f64)
        };
        run(1)?;
        let times = (0.1 / run(1)?).clamp(1.0, 200.0) as usize;
        let samples: Vec<f64> = (0..self.samples).map(|_| run(times)).collect::<Result<_, _>>()?;
        Ok(median(samples))
    }

    pub(crate) fn median(&self, mut sample: impl FnMut() -> f64) -> f64 {
        median((0..self.samples).map(|_| sample()).collect())
    }

    pub(crate) fn samples(&self) -> usize {
        self.samples
    }
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
