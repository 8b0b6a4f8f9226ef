//! What goes wrong on a device is an error of the next call and never a panic.

use ffgs_gpu::{Gpu, GpuError, Groups, Kernel};

#[test]
#[ignore = "needs a GPU"]
fn too_large_a_buffer_is_refused_before_it_is_allocated_and_the_device_lives_on() {
    let gpu = Gpu::for_test();
    let limit = gpu.report().max_binding;
    let error = gpu.buffer("splats", limit + 1).unwrap_err();
    assert_eq!(error, GpuError::TooLarge { what: "splats".into(), bytes: limit + 1, limit });
    let values = gpu.upload("values", &[1_u8, 2, 3, 4, 5]).unwrap();
    assert_eq!(gpu.download::<u8>(&values, 5).unwrap(), [1, 2, 3, 4, 5]);
    assert_eq!(gpu.download::<u8>(&values, 0).unwrap(), []);
}

#[test]
#[ignore = "needs a GPU"]
fn traffic_counts_every_byte() {
    let gpu = Gpu::for_test();
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
    group: 1,
    subgroups: false,
};

#[test]
#[ignore = "needs a GPU"]
fn a_shader_that_does_not_compile_is_an_error() {
    let gpu = Gpu::for_test();
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

const COUNT: Kernel = Kernel {
    name: "count",
    source: &["@group(0) @binding(0) var<storage, read_write> a: array<u32>;
        @compute @workgroup_size(1) fn count() { a[0] += 1u; }"],
    group: 1,
    subgroups: false,
};

/// Submissions until the first error, which must say that the device is gone.
fn steps_until_lost(gpu: &Gpu) -> usize {
    let values = gpu.upload("values", &[0_u32]).unwrap();
    for step in 0..100 {
        let mut commands = gpu.commands();
        commands.run(&COUNT, &[&values], Groups::Direct(1));
        if let Err(error) = gpu.submit(commands).and_then(|()| gpu.download::<u32>(&values, 1)) {
            assert!(matches!(error, GpuError::Lost(_)), "{error}");
            assert!(error.to_string().contains("--resume"), "{error}");
            return step;
        }
    }
    panic!("the device was never lost");
}

#[test]
#[ignore = "needs a GPU"]
fn a_lost_device_is_an_error_of_the_next_call_and_of_all_after() {
    let gpu = Gpu::for_test();
    gpu.lose_after(3);
    assert_eq!(steps_until_lost(&gpu), 3);
    assert_eq!(steps_until_lost_again(&gpu), 0);
    assert!(matches!(gpu.finish(), Err(GpuError::Lost(_))));
}

/// Everything a caller may still try; none of it panics.
fn steps_until_lost_again(gpu: &Gpu) -> usize {
    let other = gpu.buffer("more", 64);
    assert!(other.is_ok() || matches!(other, Err(GpuError::Lost(_))));
    gpu.release_unused();
    steps_until_lost(gpu)
}

#[test]
#[ignore = "needs a GPU"]
fn a_device_lost_between_submissions_that_nobody_waits_for_is_found() {
    let gpu = Gpu::for_test();
    let values = gpu.upload("values", &[0_u32]).unwrap();
    gpu.lose_after(2);
    let step = || {
        let mut commands = gpu.commands();
        commands.run(&COUNT, &[&values], Groups::Direct(1));
        gpu.submit(commands)
    };
    let failed = (0..100).find_map(|_| step().err());
    assert!(matches!(failed, Some(GpuError::Lost(_))), "{failed:?}");
}

#[test]
#[ignore = "needs a GPU"]
fn memory_beyond_the_limit_is_refused_and_the_device_lives_on() {
    let gpu = Gpu::for_test();
    let gpu = gpu.with_memory_limit(1000);
    let kept = gpu.buffer("kept", 800).unwrap();
    let error = gpu.buffer("too much", 400).unwrap_err();
    assert_eq!(error, GpuError::OutOfMemory);
    assert!(error.to_string().contains("--device cpu"), "{error}");
    assert_eq!(gpu.memory_held(), 800);
    drop(kept);
    let values = gpu.upload("values", &[7_u32]).unwrap();
    assert_eq!(gpu.download::<u32>(&values, 1).unwrap(), [7]);
}

#[test]
#[ignore = "needs a GPU"]
fn kernels_are_timed_in_their_order() {
    let gpu = Gpu::for_test();
    let values = gpu.upload("values", &[0_u32]).unwrap();
    let Some(mut commands) = gpu.timed_commands() else { return eprintln!("no timestamps here") };
    commands.run(&COUNT, &[&values], Groups::Direct(1));
    commands.run(&COUNT, &[&values], Groups::Direct(1));
    let times = gpu.submit_timed(commands).unwrap();
    assert_eq!(times.iter().map(|t| t.kernel).collect::<Vec<_>>(), ["count", "count"]);
    assert!(times.iter().all(|t| t.seconds > 0.0 && t.seconds < 10.0), "{times:?}");
    assert_eq!(gpu.download::<u32>(&values, 1).unwrap(), [2]);
    assert_eq!(gpu.submit_timed(gpu.commands()).unwrap(), []);
}
