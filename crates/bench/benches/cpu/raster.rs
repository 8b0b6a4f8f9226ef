//! Forward, backward and the whole training step, over image sizes, Gaussians and threads. Elements = contributions.

use crate::scene::{camera, contributions, discs, pool};
use criterion::{BenchmarkId, Criterion, Throughput};
use ffgs_core::{Camera, Gaussians, ImageRgb8, ImageSize, PixelFilter, PlanarImage};
use ffgs_rasterizer::{Background, CpuRasterizer, Gradients, PixelGradients, RenderTape, View};
use ffgs_trainer::{Adam, LearningRates, LossRegion, PhotometricLoss, Update};
use std::io::Write;

/// Standard deviation over spacing, as trained scenes have it.
const SPREAD: f32 = 0.45;

/// One case with everything that a step needs.
struct Step {
    gaussians: Gaussians,
    camera: Camera,
    photo: ImageRgb8,
    rasterizer: CpuRasterizer,
    tape: RenderTape,
    loss: PhotometricLoss,
    pixels: PlanarImage,
    gradients: Gradients,
    adam: Adam,
}

impl Step {
    fn new(gaussians: Gaussians, camera: Camera) -> Self {
        let size = camera.size();
        let bytes = (0..size.pixels() * 3).map(|i| (i * 7919 % 251) as u8).collect();
        Self {
            adam: Adam::new(gaussians.len(), gaussians.sh_degree()),
            photo: ImageRgb8::new(size, bytes).expect("three bytes per pixel"),
            rasterizer: CpuRasterizer::default(),
            tape: RenderTape::default(),
            loss: PhotometricLoss::new(),
            pixels: PlanarImage::zeros(size),
            gradients: Gradients::default(),
            gaussians,
            camera,
        }
    }

    fn forward(&mut self) {
        let view = View { camera: &self.camera, background: Background::Colour([0.3; 3]), tiles: None };
        self.rasterizer.render(&self.gaussians, &view, &mut self.tape);
    }

    fn backward(&mut self) {
        let view = View { camera: &self.camera, background: Background::Colour([0.3; 3]), tiles: None };
        self.gradients.reset(self.gaussians.len(), self.gaussians.sh_degree());
        let upstream = PixelGradients { image: &self.pixels, transmittance: None };
        self.rasterizer.backward(&self.gaussians, &view, &mut self.tape, &upstream, &mut self.gradients);
    }

    fn loss(&mut self) {
        self.loss.evaluate(self.tape.image(), &self.photo, LossRegion::Full, &mut self.pixels);
    }

    /// Render, loss, gradients, Adam; a rate so small that the scene stays what it is.
    fn step(&mut self) {
        self.forward();
        self.loss();
        self.backward();
        let rates = LearningRates {
            means: 1e-9,
            quats: 1e-9,
            scales: 1e-9,
            opacities: 1e-9,
            sh0: 1e-9,
            sh_rest: 1e-9,
        };
        let touched = Update::Touched(&self.gradients.touched);
        self.adam.step(&mut self.gaussians, &self.gradients.gaussians, &rates, touched);
    }
}

fn bench(c: &mut Criterion, name: &str, case: &mut Step, elements: u64) {
    case.forward();
    record(name, case, elements);
    for threads in [1, 2] {
        let pool = pool(threads);
        let id = |what: &str| BenchmarkId::new(what, format!("{name}/{threads}t"));
        let mut group = c.benchmark_group("raster");
        group.throughput(Throughput::Elements(elements));
        case.loss();
        group.bench_function(id("forward"), |b| b.iter(|| pool.install(|| case.forward())));
        group.bench_function(id("backward"), |b| b.iter(|| pool.install(|| case.backward())));
        group.bench_function(id("step"), |b| b.iter(|| pool.install(|| case.step())));
    }
}

/// Adds what the scene consists of to the file that `cargo xtask bench` computes floors from.
fn record(name: &str, case: &Step, contributions: u64) {
    let Ok(folder) = std::env::var("CRITERION_HOME") else { return };
    let (g, tape, pixels) = (&case.gaussians, &case.tape, case.camera.size().pixels());
    let (count, colours, visible) = (g.len(), 3 * g.sh_stride(), tape.visible());
    let line = format!("{name},{count},{colours},{visible},{},{pixels},{contributions}\n", tape.tile_pairs());
    std::fs::create_dir_all(&folder).expect("a folder for the counts");
    let path = std::path::Path::new(&folder).join("counts.csv");
    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
    file.and_then(|mut f| f.write_all(line.as_bytes())).expect("the counts are written");
}

/// Three image sizes, three counts, SH degree 3.
pub(crate) fn sizes(c: &mut Criterion) {
    for (width, height) in [(320, 180), (1280, 720), (1920, 1080)] {
        for (count, name) in [(20_000, "20k"), (200_000, "200k"), (1_000_000, "1M")] {
            if let Some(name) = wanted(&format!("{width}x{height}/{name}")) {
                let camera = camera(ImageSize { width, height }, 0.0);
                let mut case = Step::new(discs(count, 3, SPREAD), camera);
                let elements = contributions(&case.gaussians, &case.camera, None);
                bench(c, &name, &mut case, elements);
            }
        }
    }
}

/// As many Gaussians, pixels and contributions as gsplat's garden scene has in its test view: 101 201 in front,
/// 648x420, SH degree 0, 12.9 million contributions, no antialiasing. The size of the discs is tuned to that count.
pub(crate) fn garden(c: &mut Criterion) {
    const WANTED: f64 = 12.9e6;
    let Some(name) = wanted("garden") else { return };
    let camera = camera(ImageSize { width: 648, height: 420 }, 0.0);
    let (mut low, mut high) = (0.2_f32, 4.0_f32);
    let plain = |spread: f32| discs(101_201, 0, spread).with_filter(PixelFilter::Plain);
    let count = |spread: f32| contributions(&plain(spread), &camera, None);
    for _ in 0..10 {
        let middle = (low * high).sqrt();
        if (count(middle) as f64) < WANTED { low = middle } else { high = middle }
    }
    let gaussians = plain(low);
    let elements = contributions(&gaussians, &camera, None);
    println!("garden counts: {elements} contributions, spread {low:.3}");
    bench(c, &name, &mut Step::new(gaussians, camera), elements);
}

/// The name, when the environment variable `FFGS_BENCH_CASE` is empty or part of it: scenes of a million Gaussians are
/// not built for a filter that leaves them out.
fn wanted(name: &str) -> Option<String> {
    let filter = std::env::var("FFGS_BENCH_CASE").unwrap_or_default();
    name.contains(&filter).then(|| name.to_owned())
}
