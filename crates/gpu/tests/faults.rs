//! What goes wrong on a device is an error of the next call and never a panic.

use ffgs_gpu::{Gpu, GpuError, Groups, Kernel};

#[test]
fn too_large_a_buffer_is_refused_before_it_is_allocated_and_the_device_lives_on() {
    let Some(gpu) = Gpu::for_test() else { return };
    let limit = gpu.report().max_binding;
    let error = gpu.buffer("splats", limit + 1).unwrap_err();
    assert_eq!(error, GpuError::TooLarge { what: "splats".into(), bytes: limit + 1, limit });
    let values = gpu.upload("values", &[1_u8, 2, 3, 4, 5]).unwrap();
    assert_eq!(gpu.download::<u8>(&values, 5).unwrap(), [1, 2, 3, 4, 5]);
    assert_eq!(gpu.download::<u8>(&values, 0).unwrap(), []);
}

#[test]
fn traffic_counts_every_byte() {
    let Some(gpu) = Gpu::for_test() else { return };
    let before = gpu.traffic();
    let values = gpu.upload("values", &[1_u32; 10]).unwrap();
    gpu.download::<u32>(&values, 7).unwrap();
    let after = gpu.traffic();
    assert_eq!((after.up - before.up, after.down - before.down), (40, 28));
}

const BROKEN: Kernel = Kernel {
    name: "broken",
    source: &["@group(0) @binding(0) var<storage, read_write> a: array<u32>;
        @compute @workgroup_size(1) fn broken() { a[0] = 1.5; }"],
    subgroups: false,
};

#[test]
fn a_shader_that_does_not_compile_is_an_error() {
    let Some(gpu) = Gpu::for_test() else { return };
    let values = gpu.upload("values", &[1_u32]).unwrap();
    let mut commands = gpu.commands();
    commands.run(&BROKEN, &[&values], Groups::Direct(1));
    assert!(matches!(gpu.submit(commands), Err(GpuError::Refused(_))));
    // There is no way back: what comes after says the same.
    assert!(matches!(gpu.download::<u32>(&values, 1), Err(GpuError::Refused(_))));
}

#[test]
fn an_adapter_that_does_not_exist_is_named() {
    let count = ffgs_gpu::adapters().len();
    let error = Gpu::open(Some(count)).err().unwrap();
    assert_eq!(error, GpuError::NoSuchAdapter { index: count, count });
}
