//! Stages of a streamed frame beside the dynamic lane: motion fields, association, the prior and the sky.

use crate::lanes::{SIZE, disc};
use crate::rows::Rows;
use crate::scene::{camera, discs, training_view};
use anyhow::Result;
use ffgs_core::{DenseMotion, Gaussians, Mask, SkyCube, TrackSet, TrainingView};
use ffgs_gpu::Gpu;
use ffgs_motion_gpu::ViewFields;
use ffgs_rasterizer::{Background, Information, RenderOptions, TileMask, View};
use ffgs_rasterizer_gpu::{GpuRasterizer, GpuScene, Planes, SceneDevice};
use ffgs_trainer::{
    Around, BackgroundConfig, LayerTask, LayerTraining, LearningRates, PixelNoise, Prior, TaskView,
    TrainBackend, Training, train_sky,
};
use ffgs_trainer_gpu::GpuBackend;
use ffgs_voronoi::{AgreementConfig, VoronoiConfig};
use std::sync::Arc;

const GAUSSIANS: usize = 20_000;
/// Share of the image that is foreground.
const FOREGROUND: f64 = 0.05;
const TRACKS: usize = 400;
/// Contributions kept per pixel by `top_contributors`.
const KEPT: usize = 16;
const STEPS: usize = 40;

/// Rows `gpu/motion_fields`, `gpu/association`, `gpu/top_contributors`, `gpu/prior` and `gpu/sky_lane`.
pub(crate) fn stages(device: &SceneDevice, rows: &mut Rows) -> Result<()> {
    let (layer, mask) = (discs(GAUSSIANS, 3, 0.45), disc(FOREGROUND));
    let view = training_view(&layer, camera(SIZE, 0.0), mask);
    motion(&device.gpu, &layer, &view, rows)?;
    prior(device, &layer, &view, rows)?;
    sky(device, layer, view, rows)
}

fn case(name: &str) -> String {
    format!("{name}/{}x{}/{GAUSSIANS}", SIZE.width, SIZE.height)
}

/// One view of a sparse and a dense tracker: densification, upload, agreement, planes; then the sums under footprints.
fn motion(gpu: &Gpu, layer: &Gaussians, view: &TrainingView, rows: &mut Rows) -> Result<()> {
    let (sparse, dense) =
        (tracks(), DenseMotion { confidence: vec![1.0; SIZE.pixels()], ..DenseMotion::unknown(SIZE) });
    let fields = ViewFields::new(gpu, &view.mask, 2)?;
    let all = || -> Result<_> {
        fields.densify(0, &VoronoiConfig::default(), &sparse, &view.mask)?;
        fields.take(1, &dense)?;
        fields.agree(&AgreementConfig::default())?;
        let planes = fields.planes(0.0)?;
        gpu.finish()?;
        Ok(planes)
    };
    let mut planes = all()?;
    let seconds = rows.try_time(|| all().map(|made| planes = made))?;
    rows.add(&case("gpu/motion_fields"), seconds, None);
    let planes = Planes { values: &planes, count: fields.plane_count(), finished: 0.01 };
    let tiles = TileMask::covering(&view.mask);
    let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
    let scene = GpuScene::upload(gpu, layer)?;
    let mut rasterizer =
        GpuRasterizer::new(gpu, RenderOptions { sh_degree: Some(0), ..RenderOptions::default() })?;
    let seconds = rows
        .try_time(|| Ok(rasterizer.accumulate_planes(&scene, &frame, &planes, layer.len()).map(drop)?))?;
    rows.add(&case("gpu/association"), seconds, None);
    let seconds = rows.try_time(|| Ok(rasterizer.top_contributors(layer, &frame, KEPT).map(drop)?))?;
    rows.add(&case("gpu/top_contributors"), seconds, None);
    Ok(())
}

fn tracks() -> TrackSet {
    let mut out = TrackSet::default();
    for i in 0..TRACKS {
        let share = |step: f64| (step * i as f64).fract() as f32;
        let src = [share(0.618) * SIZE.width as f32, share(0.754) * SIZE.height as f32];
        out.src.push(src);
        out.tgt.push([src[0] + 20.0, src[1] - 3.0]);
        out.visibility.push(1.0);
    }
    out
}

/// Natural steps of a layer of which something is known, one view, uploads included.
fn prior(device: &SceneDevice, layer: &Gaussians, view: &TrainingView, rows: &mut Rows) -> Result<()> {
    let mut information = Information::none(layer.len(), layer.sh_degree());
    information.others.log_scales.fill([1.0; 3]);
    let noise = PixelNoise { sigma: 0.04, correlated: 9.0 };
    let sky = SkyCube::filled(64, [0.5; 3]);
    let seconds = rows.try_time(|| {
        let mut layer = Arc::new(layer.clone());
        let views = vec![TaskView { view, region: Some(view.mask.clone()), tiles: None }];
        let prior = Some(Prior { information: &information, noise, weight: 0.1, curvature: &information });
        let task = LayerTask { prior, ..LayerTask::new(&mut layer, views, Around::Sky(&sky)) };
        let backend = GpuBackend(device);
        let mut training = backend.upload_layer(task)?;
        for _ in 0..STEPS {
            training.forward(0, RenderOptions::default())?;
            training.backward()?;
            training.step_naturally(0.3, &LearningRates::with_means(1e-5))?;
        }
        Ok(training.download()?)
    })?;
    rows.add(&case("gpu/prior"), seconds, None);
    Ok(())
}

/// Steps of the sky behind the layer, uploads included.
fn sky(device: &SceneDevice, layer: Gaussians, view: TrainingView, rows: &mut Rows) -> Result<()> {
    let views = [TrainingView { mask: Mask::filled(SIZE, false), ..view }];
    let config = BackgroundConfig { sky_iterations: STEPS, ..BackgroundConfig::default() };
    let layer = Arc::new(layer);
    let seconds = rows.try_time(|| {
        let mut sky = SkyCube::filled(64, [0.5; 3]);
        Ok(train_sky(&GpuBackend(device), &config, &views, &layer, &mut sky, 1)?)
    })?;
    rows.add(&case("gpu/sky_lane"), seconds, None);
    Ok(())
}
