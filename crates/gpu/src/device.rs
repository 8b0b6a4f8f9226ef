//! An opened adapter: its buffers, uniforms, pipelines and submissions, and what happens when it is lost.

use crate::adapter::{self, AdapterReport};
use crate::buffer::{Buffer, Memory, checked_size};
use crate::{GpuError, Kernel};
use bytemuck::Pod;
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Bind groups kept before all are dropped; a lane uses some hundred.
const KEPT_BINDINGS: usize = 4096;
/// Submissions that may wait on the device; more only hold memory.
const IN_FLIGHT: usize = 8;

/// Bytes that crossed between host and device since the device was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// To the device.
    pub up: u64,
    /// From the device.
    pub down: u64,
}

/// One opened adapter.
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    report: AdapterReport,
    limit: u64,
    memory: Memory,
    fault: Arc<Mutex<Option<GpuError>>>,
    pipelines: Mutex<HashMap<&'static str, wgpu::ComputePipeline>>,
    bindings: Mutex<HashMap<(&'static str, Vec<Buffer>), wgpu::BindGroup>>,
    submissions: Mutex<Vec<wgpu::SubmissionIndex>>,
    up: AtomicU64,
    down: AtomicU64,
    /// Submissions before a test takes the device away.
    left: Mutex<Option<usize>>,
}

impl Gpu {
    /// Opens adapter `index` of [`crate::adapters`], or the best one (hardware before software).
    ///
    /// # Errors
    /// When there is no such adapter, none at all, or it lacks what every kernel needs.
    pub fn open(index: Option<usize>) -> Result<Self, GpuError> {
        let (adapter, report) = adapter::choose(adapter::all(&adapter::instance()), index)?;
        let wanted = (wgpu::Features::SUBGROUP | wgpu::Features::TIMESTAMP_QUERY) & adapter.features();
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("ffgs"),
            required_features: wanted,
            required_limits: adapter::requested_limits(&adapter),
            ..Default::default()
        };
        let opened = pollster::block_on(adapter.request_device(&descriptor));
        let (device, queue) = opened
            .map_err(|e| GpuError::Unsupported { adapter: report.name.clone(), reason: e.to_string() })?;
        tracing::info!("computing on {} ({}): {}", report.name, report.driver, report.path());
        Ok(Self::new(device, queue, report))
    }

    /// The best adapter, for tests that are marked `#[ignore = "needs a GPU"]`.
    ///
    /// # Panics
    /// Without an adapter: `cargo xtask ci` runs these tests and provides at least a software adapter.
    pub fn for_test() -> Self {
        Self::open(None).unwrap_or_else(|error| panic!("{error}"))
    }

    fn new(device: wgpu::Device, queue: wgpu::Queue, report: AdapterReport) -> Self {
        let fault = Arc::new(Mutex::new(None));
        let keep = fault.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| remember(&keep, described(&error))));
        let keep = fault.clone();
        device.set_device_lost_callback(move |reason, message| {
            let why = if message.is_empty() { format!("{reason:?}").to_lowercase() } else { message };
            remember(&keep, GpuError::Lost(why));
        });
        Self {
            limit: report.max_binding,
            memory: Memory::new(u64::MAX),
            device,
            queue,
            report,
            fault,
            pipelines: Mutex::default(),
            bindings: Mutex::default(),
            submissions: Mutex::default(),
            up: AtomicU64::new(0),
            down: AtomicU64::new(0),
            left: Mutex::new(None),
        }
    }

    /// The same device with the kernels for adapters without subgroup operations.
    #[must_use]
    pub fn without_subgroups(mut self) -> Self {
        self.report.subgroups = None;
        self
    }

    /// The same device, on which all buffers together hold at most so many bytes: more is [`GpuError::OutOfMemory`].
    #[must_use]
    pub fn with_memory_limit(mut self, bytes: u64) -> Self {
        self.memory.limit = bytes;
        self
    }

    /// Bytes that buffers hold now.
    pub fn memory_held(&self) -> u64 {
        self.memory.held()
    }

    /// Most bytes that buffers have held at once.
    pub fn memory_peak(&self) -> u64 {
        self.memory.peak()
    }

    /// The adapter.
    pub fn report(&self) -> &AdapterReport {
        &self.report
    }

    /// Whether the subgroup variants of the kernels run here.
    pub(crate) fn has_subgroups(&self) -> bool {
        self.report.reduces_by_subgroups()
    }

    /// Bytes moved so far.
    pub fn traffic(&self) -> Traffic {
        Traffic { up: self.up.load(Ordering::Relaxed), down: self.down.load(Ordering::Relaxed) }
    }

    /// Zeroed memory of at least `bytes`; `what` names it in an error.
    ///
    /// # Errors
    /// When one buffer may not be so large, or the memory is full.
    pub fn buffer(&self, what: &str, bytes: u64) -> Result<Buffer, GpuError> {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::INDIRECT;
        self.allocate(what, bytes, usage)
    }

    /// Memory with a copy of `values`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn upload<T: Pod>(&self, what: &str, values: &[T]) -> Result<Buffer, GpuError> {
        let buffer = self.buffer(what, size_of_val(values) as u64)?;
        self.write(&buffer, values);
        Ok(buffer)
    }

    /// A uniform binding with `value`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn uniform<T: Pod>(&self, what: &str, value: &T) -> Result<Buffer, GpuError> {
        let buffer = self.allocate(what, size_of::<T>() as u64, wgpu::BufferUsages::UNIFORM)?;
        self.write(&buffer, std::slice::from_ref(value));
        Ok(buffer)
    }

    pub(crate) fn allocate(
        &self,
        what: &str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<Buffer, GpuError> {
        let size = checked_size(what, bytes, self.limit)?;
        let usage = usage | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let share = self.memory.take(size)?;
        let label = Some(what);
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label,
            size,
            usage,
            mapped_at_creation: false,
        });
        pollster::block_on(scope.pop()).map_or_else(|| Ok(share.of(buffer)), |_| Err(GpuError::OutOfMemory))
    }

    /// Overwrites the start of a buffer before the next submission runs.
    pub fn write<T: Pod>(&self, buffer: &Buffer, values: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        self.up.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let whole = bytes.len() / 4 * 4;
        self.queue.write_buffer(&buffer.0, 0, &bytes[..whole]);
        if whole < bytes.len() {
            let mut last = [0; 4];
            last[..bytes.len() - whole].copy_from_slice(&bytes[whole..]);
            self.queue.write_buffer(&buffer.0, whole as u64, &last);
        }
    }

    /// Hands finished commands to the queue. Returns without waiting for them, unless much is in flight.
    pub(crate) fn enqueue(&self, commands: wgpu::CommandBuffer) -> Result<(), GpuError> {
        self.count_down();
        let index = self.queue.submit([commands]);
        let mut waiting = lock(&self.submissions);
        waiting.push(index);
        if waiting.len() > IN_FLIGHT {
            let oldest = waiting.remove(0);
            self.wait(Some(oldest))?;
        }
        self.check()
    }

    /// The first `count` values of a buffer, after everything submitted so far. Waits for the device.
    ///
    /// # Errors
    /// When the device failed, now or before.
    pub fn download<T: Pod>(&self, buffer: &Buffer, count: usize) -> Result<Vec<T>, GpuError> {
        let bytes = (count * size_of::<T>()) as u64;
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let size = bytes.next_multiple_of(4);
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("download"),
            size,
            usage,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&buffer.0, 0, &staging, 0, size);
        self.queue.submit([encoder.finish()]);
        self.check()?;
        staging.slice(..).map_async(wgpu::MapMode::Read, |_| ());
        self.wait(None)?;
        self.check()?;
        let mapped = staging.slice(..).get_mapped_range().map_err(|e| GpuError::Refused(e.to_string()))?;
        self.down.fetch_add(bytes, Ordering::Relaxed);
        Ok(bytemuck::pod_collect_to_vec(&mapped[..bytes as usize]))
    }

    /// Waits until everything submitted so far is done.
    ///
    /// # Errors
    /// When the device failed, now or before.
    pub fn finish(&self) -> Result<(), GpuError> {
        self.wait(None)?;
        lock(&self.submissions).clear();
        self.check()
    }

    fn wait(&self, submission_index: Option<wgpu::SubmissionIndex>) -> Result<(), GpuError> {
        // wgpu panics when the driver reports the loss to this very call.
        let poll = || self.device.poll(wgpu::PollType::Wait { submission_index, timeout: None });
        match catch_unwind(AssertUnwindSafe(poll)) {
            Ok(polled) => polled.map(|_| ()).map_err(|e| GpuError::Lost(e.to_string())),
            Err(_) => Err(GpuError::Lost("while waiting for it".to_owned())),
        }
    }

    /// The first fault since the device was opened; there is no way back from one.
    fn check(&self) -> Result<(), GpuError> {
        let known = || lock(&self.fault).clone();
        if let Some(GpuError::Refused(_)) = known() {
            // On a lost device every command is refused; wgpu tells of the loss once nothing is in flight any more.
            self.wait(None)?;
        }
        known().map_or(Ok(()), Err)
    }

    /// Lets go of buffers that only cached bindings still hold.
    pub fn release_unused(&self) {
        lock(&self.bindings).clear();
    }

    /// Takes the device away after so many more submissions, as a driver may at any time: for tests of what follows.
    pub fn lose_after(&self, submissions: usize) {
        *lock(&self.left) = Some(submissions);
    }

    /// Counts a submission of a device that is to be lost.
    fn count_down(&self) {
        let mut left = lock(&self.left);
        match left.as_mut() {
            Some(0) => self.device.destroy(),
            Some(count) => *count -= 1,
            None => {}
        }
    }

    pub(crate) fn bound(
        &self,
        kernel: &Kernel,
        buffers: &[&Buffer],
    ) -> (wgpu::ComputePipeline, wgpu::BindGroup) {
        let pipeline = self.pipeline(kernel);
        let mut cache = lock(&self.bindings);
        if cache.len() >= KEPT_BINDINGS {
            cache.clear();
        }
        let key = (kernel.name, buffers.iter().map(|&b| b.clone()).collect());
        let group = cache.entry(key).or_insert_with(|| self.bind(&pipeline, kernel.name, buffers));
        (pipeline, group.clone())
    }

    fn bind(&self, pipeline: &wgpu::ComputePipeline, name: &str, buffers: &[&Buffer]) -> wgpu::BindGroup {
        let entries: Vec<_> = buffers
            .iter()
            .enumerate()
            .map(|(i, b)| wgpu::BindGroupEntry { binding: i as u32, resource: b.0.as_entire_binding() })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(name),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        })
    }

    fn pipeline(&self, kernel: &Kernel) -> wgpu::ComputePipeline {
        lock(&self.pipelines).entry(kernel.name).or_insert_with(|| self.compile(kernel)).clone()
    }

    fn compile(&self, kernel: &Kernel) -> wgpu::ComputePipeline {
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(kernel.name),
            source: wgpu::ShaderSource::Wgsl(kernel.text().into()),
        });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(kernel.name),
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions {
                // The kernels write what they read of workgroup memory.
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        })
    }
}

/// A panic elsewhere leaves these tables as good as before.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps the first fault; but a loss explains the refusals before it.
fn remember(fault: &Mutex<Option<GpuError>>, error: GpuError) {
    let mut kept = lock(fault);
    match (&*kept, &error) {
        (None, _) | (Some(GpuError::Refused(_)), GpuError::Lost(_)) => *kept = Some(error),
        _ => {}
    }
}

fn described(error: &wgpu::Error) -> GpuError {
    match error {
        wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory,
        other => GpuError::Refused(other.to_string()),
    }
}
