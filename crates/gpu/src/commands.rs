//! Kernels and copies gathered into one submission, in order.

use crate::clock::Clock;
use crate::{Buffer, Gpu, GpuError, Kernel};

/// Workgroups of a dispatch.
#[derive(Clone, Copy, Debug)]
pub enum Groups<'a> {
    /// As many, split over two dimensions; a kernel counts them with `linear_group`.
    Direct(u32),
    /// One invocation per item, in workgroups of the kernel's size.
    Items(usize),
    /// As the buffer says: three u32 at this byte offset, written by an earlier kernel.
    Indirect(&'a Buffer, u64),
}

impl Groups<'_> {
    /// Enough groups for `items`, of which each takes `size`.
    pub fn of(items: usize, size: usize) -> Self {
        Self::Direct(items.div_ceil(size) as u32)
    }
}

/// Work for one submission, in order. A kernel sees everything that earlier ones wrote.
pub struct Commands<'a> {
    gpu: &'a Gpu,
    encoder: wgpu::CommandEncoder,
    pass: Option<wgpu::ComputePass<'static>>,
    pub(crate) clock: Option<Clock>,
}

impl<'a> Commands<'a> {
    fn new(gpu: &'a Gpu) -> Self {
        let encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        Self { gpu, encoder, pass: None, clock: None }
    }

    /// Runs `kernel` on `buffers`, in the order of its bindings. Nothing happens for zero groups.
    pub fn run(&mut self, kernel: &Kernel, buffers: &[&Buffer], groups: Groups) {
        let Self { gpu, encoder, pass, clock } = self;
        if matches!(groups, Groups::Direct(0) | Groups::Items(0)) {
            return;
        }
        let (pipeline, bindings) = gpu.bound(kernel, buffers);
        let timestamp_writes = clock.as_mut().and_then(|clock| clock.next(kernel.name));
        if timestamp_writes.is_some() {
            *pass = None;
        }
        let pass = pass.get_or_insert_with(|| {
            let descriptor = wgpu::ComputePassDescriptor { label: Some(kernel.name), timestamp_writes };
            encoder.begin_compute_pass(&descriptor).forget_lifetime()
        });
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        let count = match groups {
            Groups::Direct(count) => count,
            Groups::Items(items) => items.div_ceil(kernel.group) as u32,
            Groups::Indirect(buffer, offset) => {
                return pass.dispatch_workgroups_indirect(&buffer.0, offset);
            }
        };
        let [x, y] = grid(count);
        pass.dispatch_workgroups(x, y, 1);
    }

    /// The variant for this device.
    pub fn pick<'k>(&self, plain: &'k Kernel, subgroups: &'k Kernel) -> &'k Kernel {
        if self.gpu.has_subgroups() { subgroups } else { plain }
    }

    /// Fills a buffer with zeros.
    pub fn clear(&mut self, buffer: &Buffer) {
        self.pass = None;
        self.encoder.clear_buffer(&buffer.0, 0, None);
    }

    /// Copies the first `bytes` (a multiple of 4) of one buffer over another's.
    pub fn copy(&mut self, from: &Buffer, to: &Buffer, bytes: u64) {
        self.copy_to(from, to, 0, bytes);
    }

    /// Likewise, to byte `at` (a multiple of 4) of the other.
    pub fn copy_to(&mut self, from: &Buffer, to: &Buffer, at: u64, bytes: u64) {
        if bytes > 0 {
            self.pass = None;
            self.encoder.copy_buffer_to_buffer(&from.0, 0, &to.0, at, bytes);
        }
    }

    /// Writes the first `count` timestamps of a set to a buffer.
    pub(crate) fn resolve(&mut self, queries: &wgpu::QuerySet, count: u32, to: &Buffer) {
        self.pass = None;
        self.encoder.resolve_query_set(queries, 0..count, &to.0, 0);
    }

    fn finish(self) -> wgpu::CommandBuffer {
        drop(self.pass);
        self.encoder.finish()
    }
}

impl Gpu {
    /// Starts recording.
    pub fn commands(&self) -> Commands<'_> {
        Commands::new(self)
    }

    /// Hands work to the device. Returns without waiting for it, unless much is in flight.
    ///
    /// # Errors
    /// When the device failed, now or before.
    pub fn submit(&self, commands: Commands) -> Result<(), GpuError> {
        self.enqueue(commands.finish())
    }
}

/// Largest number of groups in one dimension that WebGPU guarantees.
const MAX_GROUPS: u32 = 65_535;

/// `count` groups over two dimensions; the last row may be padded, kernels check.
fn grid(count: u32) -> [u32; 2] {
    let rows = count.div_ceil(MAX_GROUPS).max(1);
    [count.div_ceil(rows), rows]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_count_fits_in_two_dimensions() {
        for count in [1, 65_535, 65_536, 1_000_000, u32::MAX / 2] {
            let [x, y] = grid(count);
            assert!(x <= MAX_GROUPS && y <= MAX_GROUPS, "{count}: {x} x {y}");
            assert!(u64::from(x) * u64::from(y) >= u64::from(count));
            assert!(u64::from(x) * u64::from(y - 1) < u64::from(count));
        }
    }
}
