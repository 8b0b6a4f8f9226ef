//! Lines 3 to 19 on a GPU: motion fields, agreement and association, view by view. CPU twin: [`crate::observe`]. The fields
//! stay on the device; tracks go there, and a Gaussian's sums come back.

use crate::MotionInput;
use crate::fields::{Loaded, count, load};
use crate::observe::{rows, views_at_once};
use anyhow::Result;
use ffgs_core::{Gaussians, Observations, StageLog, ViewMotion, stage};
use ffgs_gpu::Gpu;
use ffgs_motion_gpu::ViewFields;
use ffgs_rasterizer::{Background, Observed, RenderOptions, TileMask, View};
use ffgs_rasterizer_gpu::{GpuRasterizer, GpuScene, Planes, SceneDevice};
use rayon::prelude::*;
use std::time::Instant;

/// The GPU of `input`, if there is one and the configuration has kernels; the CPU does the rest.
pub(crate) fn device<'a>(input: &MotionInput<'a>, log: &mut StageLog) -> Option<&'a SceneDevice> {
    if input.gpu.is_some() && input.config.association.contributors > 0 {
        log.warn("association.contributors: association and motion fields are left to the CPU");
        return None;
    }
    input.gpu.filter(|_| ffgs_motion_gpu::supports(&input.config.voronoi, input.trackers.len()))
}

/// What every tracker says of every Gaussian of `gaussians` in every view. Files are read for a group of views at a time, by all
/// processors; the device works on meanwhile, so that the time of association holds what the fields still cost.
pub(crate) fn observe(
    device: &SceneDevice,
    input: &MotionInput,
    gaussians: &Gaussians,
    log: &mut StageLog,
) -> Result<Vec<Observations>> {
    let unobserved = || Observations::unobserved(input.step.before.len(), gaussians.len());
    let mut observations: Vec<_> = input.trackers.iter().map(|_| unobserved()).collect();
    let gpu = &device.gpu;
    let moving = GpuScene::upload(gpu, gaussians)?;
    let scene = GpuScene::joined(gpu, &[&moving, &device.layer(input.static_layer)?])?;
    let options = RenderOptions { sh_degree: Some(0), ..RenderOptions::default() };
    let mut on_device = OnDevice { gpu, scene, rasterizer: GpuRasterizer::new(gpu, options)? };
    let mut rows = rows(&mut observations);
    let views: Vec<usize> =
        (0..input.step.before.len()).filter(|&v| input.step.before[v].mask.count() > 0).collect();
    for group in views.chunks(views_at_once(input)) {
        let start = Instant::now();
        let loaded: Vec<_> = group.par_iter().map(|&v| load(input, v)).collect::<Result<_>>()?;
        log.since(stage::LOAD, start);
        for (&v, files) in group.iter().zip(loaded) {
            let fields = view_fields(gpu, input, v, files, log)?;
            let start = Instant::now();
            on_device.associate(input, v, &fields, &mut rows[v])?;
            log.since(stage::ASSOCIATION, start);
        }
    }
    gpu.release_unused();
    Ok(observations)
}

struct OnDevice<'a> {
    gpu: &'a Gpu,
    scene: GpuScene,
    rasterizer: GpuRasterizer<'a>,
}

impl OnDevice<'_> {
    /// Sums the fields of view `v` under the footprints. Waits for the device.
    fn associate(
        &mut self,
        input: &MotionInput,
        v: usize,
        fields: &ViewFields,
        rows: &mut [Observed],
    ) -> Result<()> {
        let view = &input.step.before[v];
        let planes = fields.planes(input.config.association.flow_floor_px)?;
        let finished = input.config.association.min_transmittance;
        let planes = Planes { values: &planes, count: fields.plane_count(), finished };
        let tiles = TileMask::covering(&view.mask);
        let frame =
            View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
        let sums = self.rasterizer.accumulate_planes(&self.scene, &frame, &planes, input.previous.len())?;
        let config = &input.config.association;
        for (i, &mean) in input.previous.iter().enumerate() {
            let values = sums.of(i);
            if values[0] <= config.min_coverage || sums.hits(i) < config.min_hits {
                continue;
            }
            if let Some(projection) = view.camera.project(mean) {
                for (row, sums) in rows.iter_mut().zip(values[1..].as_chunks::<4>().0) {
                    row.take(i, projection.pixel, *sums, config.min_coverage, config.normalise);
                }
            }
        }
        self.gpu.release_unused();
        Ok(())
    }
}

/// Fields of every tracker in view `v`, weighted by their agreement.
fn view_fields<'a>(
    gpu: &'a Gpu,
    input: &MotionInput,
    v: usize,
    files: Vec<Loaded>,
    log: &mut StageLog,
) -> Result<ViewFields<'a>> {
    let mask = &input.step.before[v].mask;
    let start = Instant::now();
    let fields = ViewFields::new(gpu, mask, input.trackers.len())?;
    for (l, file) in files.into_iter().enumerate() {
        match count(log, file) {
            None => {}
            Some(ViewMotion::Dense(dense)) => fields.take(l, &dense)?,
            Some(ViewMotion::Tracks(set)) => fields.densify(l, &input.config.voronoi, &set, mask)?,
        }
    }
    log.since(stage::VORONOI, start);
    let start = Instant::now();
    fields.agree(&input.config.agreement)?;
    log.since(stage::AGREEMENT, start);
    Ok(fields)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MotionConfig;
    use ffgs_core::TrainingView;
    use ffgs_dataset::Dynamic3dGaussians;
    use ffgs_method::{Capture, CaptureFormat, Split, Step, TrackSource, ViewAt};
    use std::path::Path;
    use std::sync::Arc;

    /// The initial points of the sample near its first car as Gaussians, and everything else as the static layer.
    fn layers(capture: &dyn Capture, inside: impl Fn(glam::DVec3) -> bool) -> (Gaussians, Arc<Gaussians>) {
        let points = capture.points().unwrap().unwrap();
        let all = ffgs_trainer::from_points(&points.positions, &points.colours, 0, 0.9);
        let places = all.positions();
        let (moving, fixed): (Vec<usize>, Vec<usize>) = (0..all.len()).partition(|&i| inside(places[i]));
        (all.select(&moving), Arc::new(all.select(&fixed)))
    }

    fn view(capture: &dyn Capture, view: usize, frame: usize) -> TrainingView {
        let at = ViewAt { split: Split::Train, view, frame };
        let mask = capture.mask(at).unwrap().unwrap();
        TrainingView { camera: capture.camera(at).unwrap(), image: capture.image(at).unwrap(), mask }
    }

    /// Both paths on views of the sample: the same Gaussians are seen, and go to the same pixels.
    #[test]
    #[ignore = "needs a GPU"]
    fn observations_agree_with_the_cpu_on_the_sample() {
        let device = SceneDevice::new(Gpu::for_test());
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let capture = Dynamic3dGaussians.open(&path).unwrap();
        let tracks = ffgs_tracks::sources(&*capture).unwrap();
        let names = capture.views(Split::Train);
        let views: Vec<usize> =
            (0..names.len()).filter(|&v| ["trk000", "trk008"].contains(&&*names[v])).collect();
        let now: Vec<TrainingView> = views.iter().map(|&v| view(&*capture, v, 0)).collect();
        let config = MotionConfig::default();
        let seen = |p: glam::DVec3| {
            now.iter().all(|v| v.camera.pixel_of(p).is_some_and(|(x, y)| v.mask.contains(x, y)))
        };
        let (moving, fixed) = layers(&*capture, seen);
        let previous = moving.positions();
        let step = Step {
            frame: 1,
            seed: 1,
            capture: &*capture,
            views: &views,
            before: &now,
            now: &now,
            reduced: [&now, &now],
            tracks: &tracks,
        };
        let trackers = || tracks.iter().map(AsRef::as_ref).collect::<Vec<&dyn TrackSource>>();
        let input = MotionInput {
            config: &config,
            step,
            trackers: trackers(),
            static_layer: &fixed,
            previous: &previous,
            gpu: Some(&device),
        };
        assert!(
            super::device(&input, &mut StageLog::default()).is_some() && moving.len() > 100,
            "{} Gaussians",
            moving.len()
        );
        let mut limited = config;
        limited.association.contributors = 16;
        let (limited, mut warned) =
            (MotionInput { config: &limited, trackers: trackers(), ..input }, StageLog::default());
        assert!(super::device(&limited, &mut warned).is_none() && warned.warnings.len() == 1);
        let mut log = StageLog::default();
        let expected = crate::observe(&input, &moving, &mut log, &mut |_, _| {}).unwrap();
        let found = observe(&device, &input, &moving, &mut log).unwrap();
        assert_eq!(found.len(), expected.len());
        for (l, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let seen = |o: &Observations| o.weights.iter().filter(|w| **w > 0.0).count();
            assert!(seen(expected) > 1000 && seen(found).abs_diff(seen(expected)) * 200 < seen(expected));
            let both = (0..found.weights.len()).filter(|&e| found.weights[e].min(expected.weights[e]) > 0.0);
            let differences = both.map(|e| {
                let apart = (found.targets[e] - expected.targets[e]).length();
                [apart, (found.weights[e] / expected.weights[e] - 1.0).abs()]
            });
            let differences: Vec<[f64; 2]> = differences.collect();
            let quantile = |which: usize, share: f64| {
                let mut column: Vec<f64> = differences.iter().map(|d| d[which]).collect();
                column.sort_by(f64::total_cmp);
                column[(share * column.len() as f64) as usize]
            };
            let [middle, most] = [0.5, 0.98].map(|share| [0, 1].map(|which| quantile(which, share)));
            // Tracks on a grid are equally far from many pixels; which of them is the last neighbour is up to rounding.
            assert!(
                middle[0] < 0.01 && middle[1] < 0.005,
                "tracker {l}: {middle:?} (px, share of the weight)"
            );
            assert!(most[0] < 0.5 && most[1] < 0.1, "tracker {l}: {most:?} (px, share of the weight)");
        }
    }
}
