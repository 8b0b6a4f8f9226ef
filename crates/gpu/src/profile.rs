//! Submissions whose kernels are timed one by one, for benchmarks.

use crate::clock::{Clock, KernelTime, MOST_KERNELS};
use crate::{Commands, Gpu, GpuError};

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
        commands.clock = Some(Clock::new(queries));
        Some(commands)
    }

    /// Submits commands of [`Gpu::timed_commands`] and returns the time of every kernel in their order; of others
    /// none. Waits for the device.
    ///
    /// # Errors
    /// When the device failed, or there are more kernels than timestamps.
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
}
