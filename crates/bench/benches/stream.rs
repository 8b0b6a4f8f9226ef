//! Reading a stream from its files to Gaussians, on two threads: `cargo bench -p ffgs-bench --bench stream`.
//!
//! `FFGS_STREAM=FOLDER` reads that stream; without it one of made-up layers, as large as those of the sample, is written first.
//! 60 frames per second leave 16.7 ms for each.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use ffgs_core::Gaussians;
use ffgs_stream::{Frame, Manifest, Precision, Reader, Steps, Writer};
use std::hint::black_box;
use std::path::{Path, PathBuf};

const STATIC: usize = 67_000;
const DYNAMIC: usize = 23_000;
const FRAMES: u64 = 4;
const PRECISION: Precision = Precision {
    position: 10.0,
    scales_per_octave: 4,
    rotation: 32,
    opacity: 16,
    colour: 0.12,
    harmonic: 0.05,
};

/// A made-up layer whose colours depend on `time`.
fn layer(n: usize, time: f32) -> Gaussians {
    let mut g = Gaussians::zeros(n, 3);
    let wave = |i: usize, scale: f32| (i as f32 * scale).sin();
    for i in 0..n {
        g.means[i] = [wave(i, 0.37) * 20.0, wave(i, 0.11) * 20.0, wave(i, 0.73)];
        g.log_scales[i] = [wave(i, 0.5) - 3.0, wave(i, 0.9) - 3.0, -6.0];
        g.quats[i] = [1.0, wave(i, 0.3), wave(i, 0.2), wave(i, 0.6)];
    }
    let values = g.sh.as_flattened_mut().iter_mut().enumerate();
    values.for_each(|(k, v)| *v = 0.05 * wave(k, 1.3 + 0.001 * time));
    g
}

fn write(folder: &Path) {
    let [still, moving] = [STATIC, DYNAMIC].map(|n| layer(n, 0.0));
    let manifest = Manifest {
        format: String::new(),
        version: 0,
        title: "bench".into(),
        frames_per_second: 30.0,
        antialiased: true,
        up: [0.0, 0.0, 1.0],
        forward: [1.0, 0.0, 0.0],
        static_steps: Steps::of(&still, &PRECISION),
        dynamic_steps: Steps::of(&moving, &PRECISION),
    };
    let ids: Vec<u32> = (0..DYNAMIC as u32).collect();
    let first = [&still, &moving];
    let mut writer = Writer::create(folder, manifest, first, [&PRECISION; 2], 30).expect("a new stream");
    for frame in 0..FRAMES {
        let [static_layer, dynamic_layer] = [STATIC, DYNAMIC].map(|n| layer(n, frame as f32));
        let frame = Frame {
            frame,
            static_layer: &static_layer,
            dynamic_layer: &dynamic_layer,
            ids: &ids,
            uncertainty: None,
            sky: &[],
            sky_has_changed: false,
            importance: None,
        };
        writer.push(&frame).expect("a frame");
    }
}

fn read(c: &mut Criterion) {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let folder = std::env::var_os("FFGS_STREAM").map_or_else(
        || {
            write(scratch.path());
            scratch.path().to_owned()
        },
        PathBuf::from,
    );
    let open = || Reader::open(&folder).expect("a stream");
    let frames: Vec<u64> = open().entries().iter().map(|entry| entry.frame).collect();
    let bytes: Vec<u64> = open().entries().iter().map(|entry| entry.bytes).collect();
    eprintln!("frames {frames:?} of {bytes:?} bytes");
    let mut group = c.benchmark_group("stream");
    group.sample_size(20);
    group.bench_function("key frame", |b| b.iter(|| black_box(open().read(frames[0]))));
    let at = |before: u64| {
        let mut reader = open();
        reader.read(before).expect("a frame");
        reader
    };
    for pair in frames.windows(2).take(2) {
        let name = format!("frame {} after {}", pair[1], pair[0]);
        group.bench_function(name, |b| {
            b.iter_batched_ref(
                || at(pair[0]),
                |reader| black_box(reader.read(pair[1])),
                BatchSize::LargeInput,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, read);
criterion_main!(benches);
