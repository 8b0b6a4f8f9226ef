//! Loss with gradient, and Adam.

use criterion::{BenchmarkId, Criterion, Throughput};
use ffgs_core::{Gaussians, ImageRgb8, ImageSize, Mask, PlanarImage};
use ffgs_trainer::{Adam, LearningRates, LossRegion, PhotometricLoss, Update};
use std::hint::black_box;

fn images(size: ImageSize) -> (PlanarImage, ImageRgb8) {
    let n = size.pixels() * 3;
    let mut rendered = PlanarImage::zeros(size);
    rendered.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = 0.5 + 0.4 * (i as f32 * 0.37).sin());
    let target = (0..n).map(|i| (i * 7919 % 251) as u8).collect();
    (rendered, ImageRgb8::new(size, target).expect("three bytes per pixel"))
}

/// An ellipse with the given share of the image.
pub(crate) fn ellipse(size: ImageSize, share: f64) -> Mask {
    let (w, h) = (size.width as f64, size.height as f64);
    // Area pi a b w h with a = b.
    let radius = (share / std::f64::consts::PI).sqrt();
    let inside = |i: usize| {
        let (x, y) = ((i % size.width) as f64 / w - 0.5, (i / size.width) as f64 / h - 0.5);
        u8::from(x.hypot(y) < radius)
    };
    Mask::new(size, (0..size.pixels()).map(inside).collect()).expect("one byte per pixel")
}

/// One evaluation; elements = samples (pixels times channels) that count.
pub(crate) fn loss(c: &mut Criterion) {
    let mut group = c.benchmark_group("loss");
    for (width, height) in [(320, 180), (1280, 720)] {
        let size = ImageSize { width, height };
        let (rendered, target) = images(size);
        let mask = ellipse(size, 0.08);
        let mut gradient = PlanarImage::zeros(size);
        for (name, region) in [("full", LossRegion::Full), ("masked8", LossRegion::Mask(&mask))] {
            let counted = if name == "full" { size.pixels() } else { mask.count() };
            group.throughput(Throughput::Elements(3 * counted as u64));
            let mut loss = PhotometricLoss::new();
            group.bench_function(BenchmarkId::new(name, format!("{width}x{height}")), |b| {
                b.iter(|| black_box(loss.evaluate(&rendered, &target, region, &mut gradient)));
            });
        }
    }
    group.finish();
}

/// One step of 100 k Gaussians; bytes = parameter, gradient and moments read, all but the gradient written.
pub(crate) fn adam(c: &mut Criterion) {
    const COUNT: usize = 100_000;
    let mut group = c.benchmark_group("adam");
    let mut gradient = Gaussians::zeros(COUNT, 3);
    gradient.sh.as_flattened_mut().iter_mut().enumerate().for_each(|(i, v)| *v = (i as f32).sin());
    let tenth: Vec<bool> = (0..COUNT).map(|i| i % 10 == 0).collect();
    let rates = LearningRates::with_means(1e-4);
    for (name, update) in [("dense", Update::Dense), ("touched10", Update::Touched(&tenth))] {
        let moved = if name == "dense" { COUNT } else { COUNT / 10 };
        group.throughput(Throughput::Bytes((moved * 59 * 28) as u64));
        let mut gaussians = Gaussians::zeros(COUNT, 3);
        let mut adam = Adam::new(COUNT, 3);
        group.bench_function(name, |b| b.iter(|| adam.step(&mut gaussians, &gradient, &rates, update)));
    }
    group.finish();
}
