//! `ffgs run`: the main job. Read this first: it composes every stage of the method.

use crate::check::check_capture;
use crate::choice::MethodChoice;
use crate::config::Config;
use crate::console::Console;
use crate::device;
use crate::exposure_files::{exposures_fact, load_equal, load_training, read_exposures, write_exposures};
use crate::folder::RunFolder;
use crate::frame::{init_views, load_views, select_views, test_views, training_views};
use crate::json::{read_json, write_json};
use crate::lock::FolderLock;
use crate::manifest::Manifest;
use crate::memory;
use crate::memory_need;
use crate::method::Parts;
use crate::provenance::{checksums, frame_digest};
use crate::publish::publish;
use crate::record::{FrameRecord, Metrics};
use crate::registry::open_capture;
use crate::request::RunRequest;
use crate::scene_files::write_splats;
use crate::scoring::{TestView, load_tests, mean_mpsnr, score, thumbnails, write_png};
use crate::state;
use crate::turntable::write_turntable;
use anyhow::{Context, Result, bail};
use ffgs_core::{Dynamic, ImageRgb8, Scene, StageLog, TrainingView, write_atomically};
use ffgs_dataset::ImageCheck;
use ffgs_method::{Capture, Finetuning, MotionMethod, Step, TrackSource, ViewAt};
use ffgs_rasterizer_gpu::SceneDevice;
use ffgs_reconstruction::exposures::can_be_told;
use ffgs_reconstruction::few_views::trial;
use ffgs_reconstruction::initial_points::start;
use ffgs_reconstruction::knowledge::Predicted;
use ffgs_reconstruction::marking::{mark_again, split};
use ffgs_reconstruction::sky::sky_or_none;
use ffgs_reconstruction::{Devices, Exposures, birth, disocclusion};
use ffgs_report::{FramePictures, motion_picture, uncertainty_picture};
use ffgs_trainer::{FirstFrame, StaticLane, camera_extent};
use std::io::Write;
use std::ops::Range;
use std::path::PathBuf;
use std::time::Instant;

/// Runs the job and returns the path of the report.
///
/// # Errors
/// When the capture, a setting or the output folder cannot be used, a frame fails, or the device does. Finished frames stay.
pub fn run(request: &RunRequest) -> Result<PathBuf> {
    run_frames(&Job::open(request)?)
}

fn run_frames(job: &Job) -> Result<PathBuf> {
    let mut console = Console::new(job.request.quiet, job.frames.clone());
    let mut method = job.method()?;
    let (mut metrics, mut last) = job.finished_frames(&mut *method)?;
    let result = job.frames_after(&mut metrics, &mut last, &mut *method, &mut console);
    if let (Ok(()), Some(last), Some(record)) = (&result, &last, metrics.frames.last()) {
        write_turntable(&job.folder, &*job.capture, record.frame, &last.scene, job.devices())?;
    }
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
    /// Training views of that frame, in one exposure.
    views: Vec<TrainingView>,
    exposures: Exposures,
}

/// Least time between two publications, in units of the duration of the first of them. Publishing takes longer the more
/// frames there are; this bounds it to a twentieth of the run.
const PUBLISHING_INTERVAL: u32 = 20;

/// The training of few cameras' first frame without one of them, on the console and in the report.
const TRIAL: &str = "first frame without its middle view";
/// The training of frame 0 once the exposures of its cameras are removed.
const EQUAL: &str = "first frame, exposures removed";

struct Job<'a> {
    request: &'a RunRequest,
    capture: Box<dyn Capture>,
    tracks: Vec<Box<dyn TrackSource>>,
    /// Training views used, by index.
    views: Vec<usize>,
    frames: Range<usize>,
    folder: RunFolder,
    manifest: Manifest,
    /// None = the CPU.
    gpus: Vec<SceneDevice>,
    /// Nobody else writes into the folder.
    _lock: FolderLock,
}

impl<'a> Job<'a> {
    fn open(request: &'a RunRequest) -> Result<Self> {
        request.config.validate()?;
        // Every frame decodes its images when it comes to them; once is enough.
        let check = check_capture(&request.capture, ImageCheck::Probe, request.quiet)?;
        if !check.is_usable() {
            bail!("the capture cannot be used:\n{check}");
        }
        check.warn();
        Self::on(open_capture(&request.capture)?, request)
    }

    /// The job on a capture that can be used.
    fn on(capture: Box<dyn Capture>, request: &'a RunRequest) -> Result<Self> {
        let views = select_views(&*capture, request.train_views.as_deref())?;
        if views.len() < 2 {
            bail!("positions need at least two training views; {} selected", views.len());
        }
        let tracks = ffgs_tracks::sources(&*capture)?;
        let count = capture.frames();
        let frames = request.frames.map_or(0..count, |f| f.start..f.end.unwrap_or(count));
        if frames.is_empty() || frames.end > count {
            bail!("--frames {}..{}: the capture has frames 0..{count}", frames.start, frames.end);
        }
        let folder = RunFolder(request.out.clone());
        require_start(request, &folder, frames.start)?;
        let gpus = request.device.open()?;
        // A method that cannot be made leaves the output folder untouched.
        let parts = Parts { config: &request.config, tracks: &tracks, gpu: gpus.first() };
        let method = match &request.method {
            Some(method) => method.build(&parts).map(|_| method.clone())?,
            None if frames.len() == 1 => MethodChoice::suitable(&parts)?,
            None => MethodChoice::default().build(&parts).map(|_| MethodChoice::default())?,
        };
        let by_lanes = method == MethodChoice::default() && frames.len() > 1;
        memory_need::require(request, &*capture, &views, by_lanes)?;
        let manifest = Manifest::new(request, &method, &*capture, &frames, device::name(&gpus))?;
        if let Some(run) = &request.first_frame {
            manifest.check_first_frame(&RunFolder(run.clone()))?;
        }
        if capture.origin() != glam::DVec3::ZERO {
            tracing::info!(
                "the cameras are far from zero: positions are relative to {} (run.json, origin)",
                capture.origin()
            );
        }
        let lock = FolderLock::take(&folder.0)?;
        manifest.claim(&folder, request.resume)?;
        folder.remove_half_written()?;
        Ok(Self { request, capture, tracks, views, frames, folder, manifest, gpus, _lock: lock })
    }

    fn method(&self) -> Result<Box<dyn MotionMethod + '_>> {
        let parts = Parts { config: self.config(), tracks: &self.tracks, gpu: self.gpus.first() };
        self.manifest.method.build(&parts)
    }

    /// For errors of a method: which one it is.
    fn named(&self, what: &str) -> String {
        format!("method {}: {what}", self.manifest.method)
    }

    /// The numbers of a finished frame, whose inputs must still be those that it was made from.
    fn finished_record(&self, frame: usize) -> Result<FrameRecord> {
        let record = FrameRecord::read(&self.folder, frame, &*self.capture)?;
        if let Some(inputs) = &record.inputs
            && *inputs != self.inputs_again(frame)?
        {
            bail!(
                "an image, mask or track of frame {frame} in {} is not what {} was made from; bring it back, or run \
                 again with another --out",
                self.capture.root().display(),
                self.folder.frame(frame).display()
            );
        }
        Ok(record)
    }

    /// The digest of a finished frame's inputs as they are now.
    fn inputs_again(&self, frame: usize) -> Result<String> {
        let capture = &*self.capture;
        let views =
            [training_views(&self.views, frame), test_views(capture, frame), init_views(capture, frame)];
        frame_digest(capture, &self.views, frame, checksums(capture, &views.concat())?)
    }

    fn config(&self) -> &Config {
        &self.request.config
    }

    fn devices(&self) -> Devices<'_> {
        Devices(&self.gpus)
    }

    fn publish(&self, metrics: &Metrics) -> Result<()> {
        publish(&self.folder, &self.manifest, metrics)
    }

    /// Whether the Gaussians of a frame stay when later frames are finished.
    fn keeps(&self, frame: usize) -> bool {
        self.request.keep.is_none_or(|keep| (frame - self.frames.start).is_multiple_of(keep.get()))
    }

    /// On resume, the frames that are finished: their numbers, and what the last of them leaves.
    fn finished_frames(&self, method: &mut dyn MotionMethod) -> Result<(Metrics, Option<Last>)> {
        let finished = |frame: &usize| self.request.resume && self.folder.is_finished(*frame);
        let frames: Vec<usize> = self.frames.clone().take_while(finished).collect();
        // What an interrupted run had begun to remove.
        let half_thinned = |f: &&usize| self.folder.thinned(**f).exists() && Some(*f) != frames.last();
        frames.iter().filter(half_thinned).try_for_each(|&frame| self.folder.thin(frame))?;
        let records = frames.iter().map(|&frame| self.finished_record(frame));
        let metrics = Metrics::of(records.collect::<Result<_>>()?);
        let load = |&frame: &usize| -> Result<Last> {
            let scene = state::load(&self.folder.state(frame), frame)?;
            let saved = self.folder.read_method_state(frame)?;
            method.restore(&saved, &scene).with_context(|| self.named("state"))?;
            let exposures = read_exposures(&self.folder)?;
            let views = load_training(&*self.capture, &exposures, &self.views, frame)?;
            Ok(Last { scene, views, exposures })
        };
        Ok((metrics, frames.last().map(load).transpose()?))
    }

    /// Runs the frames that are not in `metrics` yet.
    fn frames_after(
        &self,
        metrics: &mut Metrics,
        last: &mut Option<Last>,
        method: &mut dyn MotionMethod,
        console: &mut Console,
    ) -> Result<()> {
        let mut static_lane = StaticLane::default();
        let mut publish_next = Instant::now();
        for frame in self.frames.clone().skip(metrics.frames.len()) {
            console.begin_frame(frame);
            let (next, record) = match last.take() {
                None => self.first_frame(frame, method, console)?,
                Some(previous) => self.next_frame(frame, previous, method, &mut static_lane, console)?,
            };
            console.end_frame(&record);
            metrics.push(record);
            *last = Some(next);
            if frame > self.frames.start && !self.keeps(frame - 1) {
                self.folder.thin(frame - 1)?;
            }
            let start = Instant::now();
            if start >= publish_next {
                self.publish(metrics)?;
                publish_next = Instant::now() + PUBLISHING_INTERVAL * start.elapsed();
            }
        }
        Ok(())
    }

    /// Frame 0: all layers together, then the split.
    fn first_frame(
        &self,
        frame: usize,
        method: &mut dyn MotionMethod,
        console: &mut Console,
    ) -> Result<(Last, FrameRecord)> {
        let start = Instant::now();
        let mut record = FrameRecord { frame, ..FrameRecord::default() };
        let shots = [training_views(&self.views, frame), init_views(&*self.capture, frame)].concat();
        let (mut views, sums) = load_views(&*self.capture, &shots)?;
        let count = self.views.len();
        let (mut scene, exposures) = if let Some(run) = &self.request.first_frame {
            let run = RunFolder(run.clone());
            let exposures = read_exposures(&run)?;
            exposures.remove(&*self.capture, &shots, &mut views)?;
            (self.taken_from(&run, frame, &views)?, exposures)
        } else {
            record.log.since("load", start);
            let (trained, exposures) = self.train_all(&shots, &mut views, console, &mut record.log)?;
            let sky = sky_or_none(trained.sky, &trained.gaussians, &views[..count]);
            (split(&self.config().marking, &trained.gaussians, sky, &views[..count], &views)?, exposures)
        };
        write_exposures(&exposures, &self.folder)?;
        if scene.dynamic.knowledge.information.is_empty() {
            let learning = Instant::now();
            self.learn(&mut scene, None, &views);
            record.log.since("information", learning);
        }
        if scene.hidden.is_empty() {
            let config = &self.config().disocclusion;
            let dilation = self.config().marking.dilation;
            scene.hidden = disocclusion::hidden(config, &scene.static_layer, &views, dilation)?;
        }
        views.truncate(count);
        if let Some(iterations) = self.request.refine_first {
            self.refine(frame, &mut scene, &views, iterations, console, &mut record.log)?;
        }
        method.begin(&scene).with_context(|| self.named("first frame"))?;
        record.log.since("wall", start);
        let (tests, read) = load_tests(&*self.capture, &exposures, frame)?;
        let sums = [&sums[..count], &read, &sums[count..]].concat();
        record.inputs = Some(frame_digest(&*self.capture, &self.views, frame, sums)?);
        let record = self.finish(frame, &scene, &tests, method, FramePictures::default(), record)?;
        Ok((Last { scene, views, exposures }, record))
    }

    /// The first frame of another run; marked again where that run marked otherwise. `views` begins with the training
    /// views.
    fn taken_from(&self, run: &RunFolder, frame: usize, views: &[TrainingView]) -> Result<Scene> {
        let scene = state::load(&run.state(frame), frame).context("--first-frame")?;
        let other: Result<Manifest> = read_json(&run.manifest());
        if other.is_ok_and(|other| other.config.marking.marks_as(&self.config().marking)) {
            return Ok(scene);
        }
        tracing::info!("--first-frame: {} marked otherwise; its Gaussians are marked again", run.0.display());
        let own = &views[..self.views.len()];
        split(&self.config().marking, &scene.joint(), scene.sky, own, views)
    }

    /// Trains frame 0. Where the exposures of the cameras differ, they are removed from `views`, taken at `shots`, for the
    /// training that counts.
    fn train_all(
        &self,
        shots: &[ViewAt],
        views: &mut [TrainingView],
        console: &mut Console,
        log: &mut StageLog,
    ) -> Result<(FirstFrame, Exposures)> {
        let config = &self.config().first_frame;
        let train = |name: &'static str, views: &[TrainingView]| {
            let config = &config.for_views(views.len());
            let bar = console.lane(name, config.iterations);
            self.devices().first_frame(
                config,
                views,
                start(&*self.capture, &self.config().reconstruction(), config.sh_degree, views)?,
                camera_extent(views),
                self.config().seed,
                &mut |p| bar.show(p),
            )
        };
        let start = Instant::now();
        let mut trained_for_trial = |views: &[TrainingView]| train(TRIAL, views);
        if let Some(trial) = trial(config.few_views, views, self.devices(), &mut trained_for_trial)? {
            log.since(TRIAL, start);
            trial.warning(views.len()).into_iter().for_each(|warning| log.warn(warning));
        }
        let first = train("first frame", views)?;
        let estimating = Instant::now();
        let exposures = if config.exposures && can_be_told(config.iterations, views.len()) {
            Exposures::estimate(&*self.capture, shots, views, &first.gaussians)
        } else {
            Exposures::default()
        };
        log.since("exposures", estimating);
        let Some(differ) = exposures_fact(&exposures) else { return Ok((first, exposures)) };
        tracing::info!("exposures {differ}");
        exposures.remove(&*self.capture, shots, views)?;
        Ok((train(EQUAL, views)?, exposures))
    }

    /// t - 1 to t: motion initialisation, then the three lanes at the same time.
    fn next_frame(
        &self,
        frame: usize,
        last: Last,
        method: &mut dyn MotionMethod,
        static_lane: &mut StaticLane,
        console: &Console,
    ) -> Result<(Last, FrameRecord)> {
        let start = Instant::now();
        let Last { mut scene, views: before, exposures } = last;
        let (now, sums) = load_equal(&*self.capture, &exposures, &training_views(&self.views, frame))?;
        let mut record = FrameRecord { frame, ..FrameRecord::default() };
        let log = &mut record.log;
        log.since("load", start);
        let step = Step {
            frame,
            seed: self.config().seed,
            capture: &*self.capture,
            views: &self.views,
            before: &before,
            now: &now,
            tracks: &self.tracks,
        };
        if self.config().marking.every_frame && method.births() {
            self.mark_again(&mut scene, &before, static_lane, log)?;
        }
        method
            .predict(&step, &mut scene, log)
            .with_context(|| self.named(&format!("prediction of frame {frame}")))?;
        let measuring = Instant::now();
        let pictures = self.motion_pictures(frame, &scene.dynamic, &now)?;
        let (tests, read) = load_tests(&*self.capture, &exposures, frame)?;
        record.inputs = Some(frame_digest(&*self.capture, &self.views, frame, [sums, read].concat())?);
        record.initial_mpsnr = mean_mpsnr(&scene, &tests, self.devices())?;
        let measuring = measuring.elapsed().as_secs_f64();
        if method.births() {
            self.add_newborn(frame, &mut scene, &now, console, log)?;
        }
        let predicted = Predicted::new(&scene, &self.config().dynamic);
        let known = predicted.as_ref().map(Predicted::prior);
        match method
            .finetune(&step, &mut scene, log)
            .with_context(|| self.named(&format!("finetuning of frame {frame}")))?
        {
            Finetuning::ByLanes => {
                let lane = (frame, &self.config().dynamic);
                self.finetune(lane, &mut scene, (static_lane, known), &now, console, log)?;
                self.train_disoccluded(frame, &mut scene, static_lane, &now, console, log)?;
                let learning = Instant::now();
                self.learn(&mut scene, predicted.as_ref(), &now);
                log.since("information", learning);
            }
            Finetuning::Done => {}
        }
        log.add_seconds("wall", start.elapsed().as_secs_f64() - measuring);
        let record = self.finish(frame, &scene, &tests, method, pictures, record)?;
        Ok((Last { scene, views: now, exposures }, record))
    }

    /// Which Gaussians move, decided anew by the masks of t-1.
    fn mark_again(
        &self,
        scene: &mut Scene,
        before: &[TrainingView],
        static_lane: &mut StaticLane,
        log: &mut StageLog,
    ) -> Result<()> {
        let start = Instant::now();
        let Config { marking, background, .. } = self.config();
        let [started, stopped] = mark_again(marking, background, scene, before)?;
        if started + stopped > 0 {
            static_lane.forget();
        }
        log.skip("static Gaussians that move from now on", started);
        log.skip("moving Gaussians that stand still from now on", stopped);
        log.since("marking", start);
        Ok(())
    }

    /// Moving Gaussians where the masks are not explained.
    fn add_newborn(
        &self,
        frame: usize,
        scene: &mut Scene,
        views: &[TrainingView],
        console: &Console,
        log: &mut StageLog,
    ) -> Result<()> {
        let start = Instant::now();
        let bar = console.lane("birth", self.config().birth.iterations);
        let (report, config) = (&mut |p| bar.show(p), self.config().reconstruction());
        let born = birth::add_newborn(self.devices(), &config, scene, views, self.seed(frame), report)?;
        if born > 0 {
            tracing::info!("frame {frame}: {born} Gaussians are born where the masks were not explained");
        }
        log.since("birth", start);
        Ok(())
    }

    /// The static layer where something that moves covered it so far.
    fn train_disoccluded(
        &self,
        frame: usize,
        scene: &mut Scene,
        static_lane: &mut StaticLane,
        views: &[TrainingView],
        console: &Console,
        log: &mut StageLog,
    ) -> Result<()> {
        let start = Instant::now();
        let (config, seed) = (self.config(), self.seed(frame));
        if !frame.is_multiple_of(config.disocclusion.every) {
            return Ok(());
        }
        let bar = console.lane("disocclusion", config.disocclusion.iterations);
        let learnt = disocclusion::learn(
            self.devices(),
            &config.disocclusion,
            (scene, static_lane),
            views,
            config.marking.dilation,
            seed,
            &mut |p| bar.show(p),
        )?;
        tracing::debug!("frame {frame}: {learnt} static Gaussians come to light");
        log.since("disocclusion", start);
        Ok(())
    }

    fn seed(&self, frame: usize) -> u64 {
        self.config().seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ frame as u64
    }

    /// Motion and uncertainty over the photograph that shows most of the foreground.
    fn motion_pictures(
        &self,
        frame: usize,
        dynamic: &Dynamic,
        views: &[TrainingView],
    ) -> Result<FramePictures> {
        let Some(best) = views.iter().max_by_key(|v| v.mask.count()).filter(|v| v.mask.count() > 0) else {
            return Ok(FramePictures::default());
        };
        let (camera, image): (_, &ImageRgb8) = (&best.camera, &best.image);
        let now = dynamic.gaussians.positions();
        let before = match dynamic.known_steps() {
            Some(steps) => now.iter().zip(steps).map(|(now, step)| *now - *step).collect(),
            None => now.clone(),
        };
        let thumbnails = thumbnails(&*self.capture);
        let save = |name: &str, picture: &ImageRgb8| -> Result<Option<String>> {
            write_png(&self.folder.frame(frame).join(name), picture)?;
            Ok(Some(thumbnails.encode(picture)?))
        };
        let motion = save("motion.png", &motion_picture(camera, &before, &now, image)?)?;
        let uncertainty = uncertainty_picture(camera, &now, &dynamic.covariances, image)?;
        let uncertainty = save("uncertainty.png", &uncertainty)?;
        Ok(FramePictures { motion, uncertainty, ..FramePictures::default() })
    }

    /// Writes everything of a frame; the state comes last and marks the frame as finished.
    fn finish(
        &self,
        frame: usize,
        scene: &Scene,
        tests: &[TestView],
        method: &dyn MotionMethod,
        mut pictures: FramePictures,
        mut record: FrameRecord,
    ) -> Result<FrameRecord> {
        let folder = self.folder.frame(frame);
        let splats = write_splats(&folder, scene)?;
        (record.views, pictures.views) = score(&*self.capture, scene, tests, &folder, self.devices())?;
        write_json(&self.folder.pictures(frame), &pictures)?;
        record.static_gaussians = scene.static_layer.len();
        record.dynamic_gaussians = scene.dynamic.gaussians.len();
        let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
        record.peak_memory_mib = memory::peak_mib();
        (record.read_mib, record.processor_seconds) = (memory::read_mib(), memory::processor_seconds());
        let stored = method.store(scene, &folder).with_context(|| self.named("storage"))?;
        // What a method stores in its own form reproduces the frame alone.
        record.bytes = if stored.is_empty() { &splats[..] } else { &stored }.iter().map(size).sum();
        write_json(&self.folder.record(frame), &record)?;
        let saved = method.save();
        if !saved.is_empty() {
            let file = self.folder.method_state(frame);
            write_atomically(&file, |out| out.write_all(&saved))
                .with_context(|| format!("cannot write {}", file.display()))?;
        }
        state::save(&self.folder.state(frame), frame, scene)?;
        forget_motion_accuracy(&self.folder)?;
        Ok(record)
    }
}

/// What `ffgs-lab motion-eval` found does not hold for a run with one more frame.
fn forget_motion_accuracy(folder: &RunFolder) -> Result<()> {
    let file = folder.motion_accuracy();
    if file.exists() {
        std::fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
    }
    Ok(())
}

/// A frame after the first starts from the one before it: the initial points and init views are of frame 0.
fn require_start(request: &RunRequest, folder: &RunFolder, start: usize) -> Result<()> {
    let begun = request.resume && folder.is_finished(start);
    if start > 0 && request.first_frame.is_none() && !begun {
        bail!(
            "--frames {start}..: the initial points are of frame 0; run the frames 0..{next} first, then give that \
             output folder as --first-frame",
            next = start + 1
        );
    }
    Ok(())
}

mod finetune;
#[cfg(test)]
mod tests;
