//! The stages of the trackers on one view of 1280x720 and one thread: `cargo xtask bench trackers`.
//!
//! A capture of 20 views on two cores takes ten times the sum of the three stages per frame, besides reading and writing.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ffgs_core::{ImageRgb8, ImageSize, Mask};
use ffgs_trackers::{Frame, TrackerConfig, lucas_kanade, matches};
use std::hint::black_box;
use std::time::Duration;

const SIZE: ImageSize = ImageSize { width: 1280, height: 720 };
/// Columns and rows of the moving part: 5 % of the image.
const MOVING: [std::ops::Range<usize>; 2] = [400..656, 300..480];

fn inside(x: usize, y: usize, motion: [usize; 2]) -> bool {
    let [columns, rows] = MOVING;
    columns.contains(&x.wrapping_sub(motion[0])) && rows.contains(&y.wrapping_sub(motion[1]))
}

/// A seeded texture of three scales; the moving part shows another one, displaced by `motion` (px).
fn picture(motion: [usize; 2]) -> ImageRgb8 {
    let value = |i: usize| {
        let (x, y) = (i % SIZE.width, i / SIZE.width);
        let moved = inside(x, y, motion);
        let (u, v) = if moved { (x - motion[0], y - motion[1]) } else { (x, y) };
        let seed = if moved { 7.0 } else { 0.0 };
        let wave = |scale: f32| {
            let (u, v) = (u as f32 / scale + seed, v as f32 / scale - seed);
            ((u + 1.7 * (0.6 * v).sin()).sin() * (v + 1.3 * (0.7 * u).cos()).sin()).clamp(-0.6, 0.6)
        };
        (128.0 + 70.0 * wave(2.3) + 60.0 * wave(6.1) + 50.0 * wave(19.0)).clamp(0.0, 255.0) as u8
    };
    let data = (0..SIZE.pixels()).flat_map(|i| [value(i); 3]).collect();
    ImageRgb8::new(SIZE, data).expect("three bytes per pixel")
}

fn mask(motion: [usize; 2]) -> Mask {
    let value = |i: usize| u8::from(inside(i % SIZE.width, i / SIZE.width, motion));
    Mask::new(SIZE, (0..SIZE.pixels()).map(value).collect()).expect("one byte per pixel")
}

fn stages(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    pool.build_global().expect("this thread is the pool");
    let config = TrackerConfig::default();
    let images = [[0, 0], [23, 5]].map(|motion| (picture(motion), mask(motion)));
    let frame = |i: usize| Frame::new(&images[i].0, Some(&images[i].1), &config);
    let (before, now) = (frame(0), frame(1));
    let sparse = matches(&before, &now, &config);
    let medium = lucas_kanade(&before, &now, &sparse, &config);
    eprintln!(
        "{} corners, {} keypoints, {} sparse and {} medium tracks",
        before.corners().len(),
        before.keypoints().len(),
        sparse.src.len(),
        medium.src.len()
    );
    let mut group = c.benchmark_group("trackers");
    // Bytes read of the picture and written of three planes of f32 in all levels.
    group.throughput(Throughput::Bytes((SIZE.pixels() * (3 + 12 * 4 / 3)) as u64));
    group.bench_function("frame/1t", |b| b.iter(|| black_box(frame(0))));
    // Operations: a difference and a multiply-add for each of 128 entries, of all pairs within reach, here half of them.
    let pairs = before.keypoints().len() * now.keypoints().len() / 2;
    group.throughput(Throughput::Elements((pairs * 128 * 2) as u64));
    group.bench_function("matches/1t", |b| b.iter(|| black_box(matches(&before, &now, &config))));
    // Operations, six for a pixel: two interpolations, two products. There and back, five levels, five windows of 15 x 15: the
    // template, its two derivatives, and two iterations.
    group.throughput(Throughput::Elements((before.corners().len() * 2 * 5 * 5 * 225 * 6) as u64));
    group.bench_function("lucas_kanade/1t", |b| {
        b.iter(|| black_box(lucas_kanade(&before, &now, &sparse, &config)));
    });
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    targets = stages
}
criterion_main!(benches);
