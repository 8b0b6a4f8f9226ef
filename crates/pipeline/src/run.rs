//! `ffgs run`: the main job. Read this first: it composes every stage of the method.

use crate::check::check_capture;
use crate::cli::{FrameRange, Init};
use crate::config::Config;
use crate::console::Console;
use crate::device::{self, Device};
use crate::frame::{TrainViews, cameras_and_masks, load_training, load_view};
use crate::lanes::{Lanes, Photographed};
use crate::manifest::Manifest;
use crate::motion::{MotionInput, MotionOutcome, initialise, pixel_sizes};
use crate::record::{FrameRecord, Metrics, RunFolder, publish, read_json, write_json};
use crate::scoring::{load_tests, mean_mpsnr, score, thumbnails, write_png};
use crate::state;
use anyhow::{Context, Result, bail};
use ffgs_core::{Dynamic, Gaussians, ImageRgb8, ImageSize, Scene, SkyCube, TrainingView, spatial_order};
use ffgs_dataset::{Capture, ImageCheck, Split};
use ffgs_fusion::{dynamic_split, initial_covariance};
use ffgs_gpu::Gpu;
use ffgs_report::{FramePictures, motion_picture, uncertainty_picture};
use ffgs_splats::Tracked;
use ffgs_tracks::TrackStore;
use ffgs_trainer::{FirstFrame, INITIAL_OPACITY, StaticLane, Surroundings, from_points, shows_sky};
use std::ops::Range;
use std::path::PathBuf;
use std::time::Instant;

/// What to run.
#[derive(Clone, Debug)]
pub struct RunRequest {
    /// Capture folder.
    pub capture: PathBuf,
    /// Output folder.
    pub out: PathBuf,
    /// Go on after the last finished frame.
    pub resume: bool,
    /// Trackers.
    pub init: Init,
    /// Frames; `None` = all. The first is trained from the initial points.
    pub frames: Option<FrameRange>,
    /// Training cameras; `None` = all.
    pub train_views: Option<Vec<String>>,
    /// Take frame 0 from this run instead of training it.
    pub first_frame: Option<PathBuf>,
    /// Where to compute.
    pub device: Device,
    /// No progress bars.
    pub quiet: bool,
    /// Everything else.
    pub config: Config,
}

/// Runs the job and returns the path of the report.
pub fn run(request: &RunRequest) -> Result<PathBuf> {
    run_frames(&Job::open(request)?)
}

fn run_frames(job: &Job) -> Result<PathBuf> {
    let mut console = Console::new(job.request.quiet, job.frames.clone());
    let (mut metrics, mut last) = job.finished_frames()?;
    let result = job.frames_after(&mut metrics, &mut last, &mut console);
    // Also when a frame failed: those before it are finished.
    if result.is_ok() || !metrics.frames.is_empty() {
        job.publish(&metrics)?;
    }
    result?;
    console.finish(&metrics);
    Ok(job.folder.0.join("report.html"))
}

/// What one frame leaves for the next.
struct Last {
    scene: Scene,
    /// Training views of that frame.
    views: Vec<TrainingView>,
}

/// Least time between two publications, in units of the duration of the first of them. Publishing takes longer the more
/// frames there are; this bounds it to a twentieth of the run.
const PUBLISHING_INTERVAL: u32 = 20;

struct Job<'a> {
    request: &'a RunRequest,
    capture: Capture,
    tracks: Option<TrackStore>,
    views: TrainViews,
    frames: Range<usize>,
    folder: RunFolder,
    manifest: Manifest,
    /// None = the CPU.
    gpus: Vec<Gpu>,
}

impl<'a> Job<'a> {
    fn open(request: &'a RunRequest) -> Result<Self> {
        // Every frame decodes its images when it comes to them; once is enough.
        let check = check_capture(&request.capture, ImageCheck::Probe, request.quiet)?;
        if !check.is_usable() {
            bail!("the capture cannot be used:\n{check}");
        }
        let capture = Capture::open(&request.capture)?;
        let views = TrainViews::select(&capture, request.train_views.as_deref())?;
        if views.selected.len() < 2 {
            bail!("positions need at least two training views; {} selected", views.selected.len());
        }
        let tracks = TrackStore::open(&request.capture)?;
        require_tracker(&request.init, tracks.as_ref())?;
        let count = capture.frames();
        let frames = request.frames.map_or(0..count, |f| f.start..f.end.unwrap_or(count));
        if frames.is_empty() || frames.end > count {
            bail!("--frames {}..{}: the capture has frames 0..{count}", frames.start, frames.end);
        }
        let folder = RunFolder(request.out.clone());
        let gpus = request.device.open()?;
        let manifest = Manifest::new(request, &frames, device::name(&gpus))?;
        manifest.claim(&folder, request.resume)?;
        Ok(Self { request, capture, tracks, views, frames, folder, manifest, gpus })
    }

    fn config(&self) -> &Config {
        &self.request.config
    }

    fn lanes(&self) -> Lanes<'_> {
        Lanes(&self.gpus)
    }

    fn publish(&self, metrics: &Metrics) -> Result<()> {
        publish(&self.folder, &self.manifest, metrics)
    }

    /// On resume, the frames that are finished: their numbers, and what the last of them leaves.
    fn finished_frames(&self) -> Result<(Metrics, Option<Last>)> {
        let finished = |frame: &usize| self.request.resume && self.folder.state(*frame).exists();
        let frames: Vec<usize> = self.frames.clone().take_while(finished).collect();
        let records = frames.iter().map(|&frame| read_json(&self.folder.record(frame)));
        let metrics = Metrics::of(records.collect::<Result<_>>()?);
        let load = |&frame: &usize| -> Result<Last> {
            let scene = state::load(&self.folder.state(frame))?;
            Ok(Last { scene, views: load_training(&self.capture, &self.views, frame)? })
        };
        Ok((metrics, frames.last().map(load).transpose()?))
    }

    /// Runs the frames that are not in `metrics` yet.
    fn frames_after(
        &self,
        metrics: &mut Metrics,
        last: &mut Option<Last>,
        console: &mut Console,
    ) -> Result<()> {
        let mut static_lane = StaticLane::default();
        let mut publish_next = Instant::now();
        for frame in self.frames.clone().skip(metrics.frames.len()) {
            console.begin_frame(frame);
            let (next, record) = match last.take() {
                None => self.first_frame(frame, console)?,
                Some(previous) => self.next_frame(frame, previous, &mut static_lane, console)?,
            };
            console.end_frame(&record);
            metrics.push(record);
            *last = Some(next);
            let start = Instant::now();
            if start >= publish_next {
                self.publish(metrics)?;
                publish_next = Instant::now() + PUBLISHING_INTERVAL * start.elapsed();
            }
        }
        Ok(())
    }

    /// Frame 0: all layers together, then the split.
    fn first_frame(&self, frame: usize, console: &mut Console) -> Result<(Last, FrameRecord)> {
        let start = Instant::now();
        let mut record = FrameRecord { frame, ..FrameRecord::default() };
        let mut views = load_training(&self.capture, &self.views, frame)?;
        let scene = if let Some(run) = &self.request.first_frame {
            state::load(&RunFolder(run.clone()).state(frame))
                .context("--first-frame: not a run of this capture")?
        } else {
            let count = views.len();
            if frame == 0 {
                for v in 0..self.capture.views(Split::Init).len() {
                    views.push(load_view(&self.capture, Split::Init, v, 0)?);
                }
            }
            record.seconds.load = Some(start.elapsed().as_secs_f64());
            let trained = self.train_all(&views, console)?;
            let sky = sky_or_none(trained.sky, &trained.gaussians, &views[..count]);
            let scene = self.split(&trained.gaussians, sky, &views[..count], &views)?;
            views.truncate(count);
            scene
        };
        record.seconds.wall = Some(start.elapsed().as_secs_f64());
        let truths = load_tests(&self.capture, frame)?;
        let record = self.finish(frame, &scene, &truths, FramePictures::default(), record)?;
        Ok((Last { scene, views }, record))
    }

    fn train_all(&self, views: &[TrainingView], console: &mut Console) -> Result<FirstFrame> {
        let points = self.capture.initial_points()?;
        let degree = self.config().first_frame.sh_degree;
        let initial = from_points(&points.positions, &points.colours, degree, INITIAL_OPACITY);
        let initial = initial.select(&spatial_order(&initial.means));
        let sky = SkyCube::filled(self.config().sky_face_size, mean_colour(views));
        let bar = console.lane("first frame", self.config().first_frame.iterations);
        let extent = camera_extent(views);
        let seed = self.config().seed;
        let start = FirstFrame { gaussians: initial, sky };
        let config = &self.config().first_frame;
        self.lanes().first_frame(config, views, start, extent, seed, &mut |p| bar.show(p))
    }

    fn split(
        &self,
        all: &Gaussians,
        sky: SkyCube,
        views: &[TrainingView],
        training: &[TrainingView],
    ) -> Result<Scene> {
        let (cameras, masks) = cameras_and_masks(training);
        let marking = self.config().marking;
        let moving = dynamic_split(&all.positions(), &cameras, &masks, marking.dilation, marking.slack)?;
        // Training left what it added at the end; all later frames keep this order.
        let order = spatial_order(&all.means);
        let indices = |keep: bool| order.iter().copied().filter(|&i| moving[i] == keep).collect::<Vec<_>>();
        let gaussians = all.select(&indices(true));
        if gaussians.is_empty() {
            tracing::warn!("no Gaussian lies inside the masks: nothing is dynamic");
        }
        let pixel_m = pixel_sizes(&gaussians.positions(), views);
        let smallest = |s: &[f32; 3]| f64::from(s.iter().copied().fold(f32::INFINITY, f32::min).exp());
        let axes = gaussians.log_scales.iter().map(smallest);
        let covariances = axes.zip(pixel_m).map(|(axis, pixel)| initial_covariance(axis, pixel)).collect();
        let mut dynamic = Dynamic { gaussians, covariances, ..Dynamic::default() };
        dynamic.number_new();
        Ok(Scene { static_layer: all.select(&indices(false)), dynamic, sky })
    }

    /// t - 1 to t: motion initialisation, then the three lanes at the same time.
    fn next_frame(
        &self,
        frame: usize,
        last: Last,
        static_lane: &mut StaticLane,
        console: &Console,
    ) -> Result<(Last, FrameRecord)> {
        let start = Instant::now();
        let Last { mut scene, views: before } = last;
        let now = load_training(&self.capture, &self.views, frame)?;
        let loading = start.elapsed().as_secs_f64();
        let input = MotionInput {
            config: self.config(),
            init: &self.request.init,
            tracks: self.tracks.as_ref(),
            views: &self.views,
            before: &before,
            now: &now,
            frame,
            static_layer: &scene.static_layer,
            gpu: self.gpus.first(),
        };
        let motion = initialise(&input, &mut scene.dynamic)?;
        drop(before);
        let mut record = FrameRecord { frame, ..FrameRecord::default() };
        record.seconds = motion.seconds;
        record.seconds.load = Some(loading + motion.seconds.load.unwrap_or(0.0));
        record.skips.clone_from(&motion.skips);
        record.warnings.clone_from(&motion.warnings);
        let measuring = Instant::now();
        let pictures = self.motion_pictures(frame, &scene.dynamic, &motion, &now)?;
        let truths = load_tests(&self.capture, frame)?;
        record.initial_mpsnr = mean_mpsnr(&scene, &truths, self.lanes())?;
        let measuring = measuring.elapsed().as_secs_f64();
        self.finetune(frame, &mut scene, static_lane, &now, console, &mut record)?;
        record.seconds.wall = Some(start.elapsed().as_secs_f64() - measuring);
        let record = self.finish(frame, &scene, &truths, pictures, record)?;
        Ok((Last { scene, views: now }, record))
    }

    /// Every lane reads the state at the frame's start and writes its own layer, so the order does not matter.
    fn finetune(
        &self,
        frame: usize,
        scene: &mut Scene,
        static_lane: &mut StaticLane,
        views: &[TrainingView],
        console: &Console,
        record: &mut FrameRecord,
    ) -> Result<()> {
        let (config, lanes) = (self.config(), self.lanes());
        let seed = config.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ frame as u64;
        let (static_start, sky_start) = (scene.static_layer.clone(), scene.sky.clone());
        let around = Surroundings { static_layer: &static_start, sky: &sky_start };
        let Scene { static_layer, dynamic, sky } = scene;
        let dynamic_bar = console.lane("dynamic", config.dynamic.iterations);
        let static_bar = console.lane("static", config.background.static_passes());
        let timed = |work: &mut (dyn FnMut() -> Result<()> + Send)| {
            let start = Instant::now();
            work().map(|()| start.elapsed().as_secs_f64())
        };
        let background = &config.background;
        let (dynamic_s, static_s, sky_s) = lanes.together(
            || {
                timed(&mut || {
                    let layer = &mut dynamic.gaussians;
                    lanes.dynamic(&config.dynamic, views, around, layer, seed, &mut |p| dynamic_bar.show(p))
                })
            },
            || {
                timed(&mut || {
                    let photographed = Photographed { views, sky: &sky_start };
                    let report = &mut |p| static_bar.show(p);
                    lanes.static_layer(static_lane, background, photographed, static_layer, seed, report)
                })
            },
            || timed(&mut || lanes.sky(background, views, &static_start, sky, seed)),
        );
        record.seconds.dynamic = Some(dynamic_s?);
        record.seconds.static_lane = Some(static_s?);
        record.seconds.sky = Some(sky_s?);
        Ok(())
    }

    /// Motion and uncertainty over the photograph that shows most of the foreground.
    fn motion_pictures(
        &self,
        frame: usize,
        dynamic: &Dynamic,
        motion: &MotionOutcome,
        views: &[TrainingView],
    ) -> Result<FramePictures> {
        let Some(best) = views.iter().max_by_key(|v| v.mask.count()).filter(|v| v.mask.count() > 0) else {
            return Ok(FramePictures::default());
        };
        let (camera, image): (_, &ImageRgb8) = (&best.camera, &best.image);
        let now = dynamic.gaussians.positions();
        let thumbnails = thumbnails(&self.capture);
        let save = |name: &str, picture: &ImageRgb8| -> Result<Option<String>> {
            write_png(&self.folder.frame(frame).join(name), picture)?;
            Ok(Some(thumbnails.encode(picture)?))
        };
        let motion = save("motion.png", &motion_picture(camera, &motion.previous, &now, image)?)?;
        let uncertainty = uncertainty_picture(camera, &now, &dynamic.covariances, image)?;
        let uncertainty = save("uncertainty.png", &uncertainty)?;
        Ok(FramePictures { motion, uncertainty, ..FramePictures::default() })
    }

    /// Writes everything of a frame; the state comes last and marks the frame as finished.
    fn finish(
        &self,
        frame: usize,
        scene: &Scene,
        truths: &[TrainingView],
        mut pictures: FramePictures,
        mut record: FrameRecord,
    ) -> Result<FrameRecord> {
        let folder = self.folder.frame(frame);
        let (static_ply, dynamic_ply) = (folder.join("static.ply"), folder.join("dynamic.ply"));
        ffgs_splats::write_ply(&static_ply, &scene.static_layer, None)?;
        let Dynamic { gaussians, covariances, ids, .. } = &scene.dynamic;
        ffgs_splats::write_ply(&dynamic_ply, gaussians, Some(Tracked { covariances, ids }))?;
        let texels = scene.sky.texels.as_flattened();
        ffgs_splats::write_sky_cross(&folder.join("sky.png"), scene.sky.face_size(), texels)?;
        (record.views, pictures.views) = score(&self.capture, scene, truths, &folder, self.lanes())?;
        write_json(&self.folder.pictures(frame), &pictures)?;
        record.static_gaussians = scene.static_layer.len();
        record.dynamic_gaussians = scene.dynamic.gaussians.len();
        let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
        record.peak_memory_mib = crate::memory::peak_mib();
        record.bytes = size(&static_ply) + size(&dynamic_ply) + size(&folder.join("sky.png"));
        write_json(&self.folder.record(frame), &record)?;
        state::save(&self.folder.state(frame), frame, scene)?;
        forget_motion_accuracy(&self.folder)?;
        Ok(record)
    }
}

/// Indoors no sky is seen; what frame 0 made of it shows as soon as something before it moves.
fn sky_or_none(sky: SkyCube, layer: &Gaussians, views: &[TrainingView]) -> SkyCube {
    if shows_sky(layer, views) {
        return sky;
    }
    tracing::info!(
        "the views see no sky (indoors?): one colour stands behind everything, and the sky lane rests"
    );
    SkyCube::none(sky.mean())
}

/// What `ffgs-lab motion-eval` found does not hold for a run with one more frame.
fn forget_motion_accuracy(folder: &RunFolder) -> Result<()> {
    let file = folder.motion_accuracy();
    if file.exists() {
        std::fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
    }
    Ok(())
}

fn require_tracker(init: &Init, tracks: Option<&TrackStore>) -> Result<()> {
    let Init::Tracker(name) = init else { return Ok(()) };
    let known: Vec<&str> =
        tracks.map(|t| t.trackers().iter().map(|k| k.name.as_str()).collect()).unwrap_or_default();
    if known.contains(&name.as_str()) {
        return Ok(());
    }
    bail!("--init tracker:{name}: tracks/tracks.json names {known:?}")
}

/// Radius of the camera positions around their mean (m), a tenth larger as in 3DGS.
fn camera_extent(views: &[TrainingView]) -> f32 {
    let centers = || views.iter().map(|v| v.camera.center());
    let mean = centers().sum::<glam::DVec3>() / views.len().max(1) as f64;
    1.1 * centers().map(|c| (c - mean).length()).fold(0.0, f64::max) as f32
}

/// Mean colour of the top rows, where outdoor views show the sky.
fn mean_colour(views: &[TrainingView]) -> [f32; 3] {
    let mut sum = [0.0_f64; 3];
    let mut count = 0.0;
    for view in views {
        let ImageSize { width, height } = view.image.size();
        for pixel in 0..width * (height / 8).max(1) {
            let rgb = view.image.pixel(pixel);
            (0..3).for_each(|c| sum[c] += f64::from(rgb[c]));
            count += 1.0;
        }
    }
    sum.map(|s| (s / f64::max(count, 1.0)) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use std::path::Path;

    /// A short run of the sample on GPUs, every lane on them.
    fn request(out: &Path, gpus: &[usize], frames: usize, resume: bool) -> RunRequest {
        let mut config = Config::default();
        config.first_frame.iterations = 3;
        config.dynamic.iterations = 4;
        config.background.static_method = ffgs_trainer::StaticMethod::Steps;
        config.background.static_iterations = 3;
        config.background.sky_iterations = 3;
        RunRequest {
            capture: Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini"),
            out: out.to_owned(),
            resume,
            init: Init::Fused,
            frames: Some(FrameRange { start: 0, end: Some(frames) }),
            train_views: Some(["trk000", "trk004", "trk008"].map(str::to_owned).to_vec()),
            first_frame: None,
            device: Device::Gpu(gpus.to_vec()),
            quiet: true,
            config,
        }
    }

    /// Several GPUs, one lost in the second frame, and a run that was never disturbed on one: equal bytes.
    #[test]
    fn a_lost_gpu_ends_the_frame_and_a_resumed_run_ends_as_one_that_never_stopped() {
        if Gpu::for_test().is_none() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let [whole, cut] = ["whole", "cut"].map(|name| folder.path().join(name));
        let state = |out: &Path, frame: usize| std::fs::read(RunFolder(out.to_owned()).state(frame)).unwrap();
        run(&request(&cut, &[0, 0, 0], 1, false)).unwrap();
        let first = state(&cut, 0);
        run(&RunRequest { first_frame: Some(cut.clone()), ..request(&whole, &[0], 2, false) }).unwrap();
        let request_cut = request(&cut, &[0, 0, 0], 2, true);
        let job = Job::open(&request_cut).unwrap();
        assert_eq!(job.gpus.len(), 3);
        job.gpus[2].lose_after(2);
        let error = format!("{:#}", run_frames(&job).unwrap_err());
        assert!(error.contains("the GPU was lost") && error.contains("--resume"), "{error}");
        assert!(!job.folder.state(1).exists(), "the frame did not finish");
        assert!(state(&cut, 0) == first, "the finished frame stays");

        run(&request(&cut, &[0, 0, 0], 2, true)).unwrap();
        assert!(state(&cut, 1) == state(&whole, 1));
    }
}
