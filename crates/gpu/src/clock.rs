//! Times of single kernels on the device, for benchmarks.

/// Most kernels of one measured submission: WebGPU's limit of 4096 timestamps per set, two per kernel.
pub(crate) const MOST_KERNELS: usize = 2048;

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
    pub(crate) queries: wgpu::QuerySet,
    pub(crate) kernels: Vec<&'static str>,
}

impl Clock {
    /// No timestamp taken yet.
    pub(crate) fn new(queries: wgpu::QuerySet) -> Self {
        Self { queries, kernels: Vec::new() }
    }

    /// The places of the next kernel's two timestamps; none when the set is full.
    pub(crate) fn next(&mut self, kernel: &'static str) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let first = 2 * self.kernels.len() as u32;
        self.kernels.push(kernel);
        (self.kernels.len() <= MOST_KERNELS).then_some(wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }
}
