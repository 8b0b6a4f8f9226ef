use crate::device::lock;
use crate::{Commands, Gpu, GpuError};

/// Most kernels of one measured submission: WebGPU's limit of 4096 timestamps a set, two a kernel.
const MOST_KERNELS: usize = 2048;

/// How long one dispatch of a kernel took on the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KernelTime {
    /// Name of the kernel.
    pub kernel: &'static str,
    /// From the first group's start to the last one's end (s).
    pub seconds: f64,
}

/// Timestamps around every kernel of some commands. Each kernel gets a pass of its own, so nothing overlaps.
pub(crate) struct Clock {
    queries: wgpu::QuerySet,
    kernels: Vec<&'static str>,
}

impl Clock {
    /// The places of the next kernel's two timestamps; none when the set is full.
    pub fn next(&mut self, kernel: &'static str) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let first = 2 * self.kernels.len() as u32;
        self.kernels.push(kernel);
        (self.kernels.len() <= MOST_KERNELS).then_some(wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }
}

impl Gpu {
    /// Like [`Gpu::commands`], with the time of every kernel taken; `None` where the adapter has no timestamps.
    pub fn timed_commands(&self) -> Option<Commands<'_>> {
        let queries = self.report().timestamps.then(|| {
            self.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("kernels"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MOST_KERNELS as u32,
            })
        })?;
        let mut commands = self.commands();
        commands.clock = Some(Clock { queries, kernels: Vec::new() });
        Some(commands)
    }

    /// Submits commands of [`Gpu::timed_commands`] and returns the time of every kernel in their order; of others
    /// none. Waits for the device.
    pub fn submit_timed(&self, mut commands: Commands) -> Result<Vec<KernelTime>, GpuError> {
        let clock = commands.clock.take().filter(|clock| !clock.kernels.is_empty());
        let Some(Clock { queries, kernels }) = clock else {
            self.submit(commands)?;
            return Ok(Vec::new());
        };
        let count = kernels.len();
        if count > MOST_KERNELS {
            return Err(GpuError::Refused(format!("{count} kernels in one measured submission")));
        }
        let usage = wgpu::BufferUsages::QUERY_RESOLVE;
        let ticks = self.allocate("timestamps", 16 * count as u64, usage)?;
        commands.resolve(&queries, 2 * count as u32, &ticks);
        self.submit(commands)?;
        let ticks: Vec<[u64; 2]> = self.download(&ticks, count)?;
        let period = f64::from(self.queue.get_timestamp_period()) * 1e-9;
        let time = |(&kernel, [start, end]): (&&'static str, &[u64; 2])| KernelTime {
            kernel,
            seconds: end.saturating_sub(*start) as f64 * period,
        };
        Ok(kernels.iter().zip(&ticks).map(time).collect())
    }

    /// Takes the device away after so many more submissions, as a driver may at any time: for tests of what follows.
    pub fn lose_after(&self, submissions: usize) {
        *lock(&self.left) = Some(submissions);
    }

    /// Counts a submission of a device that is to be lost.
    pub(crate) fn count_down(&self) {
        let mut left = lock(&self.left);
        match left.as_mut() {
            Some(0) => self.device.destroy(),
            Some(count) => *count -= 1,
            None => {}
        }
    }
}
