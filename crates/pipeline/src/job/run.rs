//! `ffgs run`: the frames of a capture, one after another, from files to files. What happens to a frame in memory is in
//! `ffgs_reconstruction`.

use crate::cli::console::Console;
use crate::commands::check::check_capture;
use crate::job::device;
use crate::job::frame::{
    first_views_and_checksums, init_views, select_views, test_views, trained_cameras, training_views,
};
use crate::job::lock::FolderLock;
use crate::job::manifest::Manifest;
use crate::job::memory;
use crate::job::memory_need::{self, Room};
use crate::job::provenance::{Checksum, checksums, frame_digest, track_checksums};
use crate::job::read_ahead::{Inputs, ReadAhead};
use crate::job::request::RunRequest;
use crate::outputs::camera_pictures::write_camera_pictures;
use crate::outputs::exposure_files::{
    exposures_fact, load_training, read_exposures, write_changed, write_usual,
};
use crate::outputs::folder::RunFolder;
use crate::outputs::json::{read_json, write_json};
use crate::outputs::publish::publish;
use crate::outputs::record::{FrameRecord, Metrics};
use crate::outputs::scene_files::write_splats;
use crate::outputs::scoring::{ScoredView, load_tests, load_trained_on, mean_mpsnr, score, thumbnails};
use crate::outputs::state;
use crate::outputs::turntable::write_turntable;
use crate::plugins::choice::MethodChoice;
use crate::plugins::method::MethodContext;
use crate::plugins::registry::open_capture;
use crate::settings::config::Config;
use anyhow::{Context, Result, bail};
use ffgs_core::{Camera, Dynamic, ImageRgb8, Scene, TrainingView, stage, write_atomically};
use ffgs_dataset::{ImageCheck, write_image};
use ffgs_method::{Capture, Step, TrackSource};
use ffgs_rasterizer_gpu::SceneDevice;
use ffgs_reconstruction::{Devices, Earlier, Exposures, Reconstructor, State};
use ffgs_report::{FramePictures, motion_picture, uncertainty_picture};
use std::io::Write;
use std::ops::Range;
use std::path::PathBuf;
use std::time::Instant;

/// Runs the job and returns the path of the report.
///
/// # Errors
/// When the capture, a setting or the output folder cannot be used, a frame fails, or the device does. Finished frames stay.
pub fn run(request: &RunRequest) -> Result<PathBuf> {
    run_while(request, &|| Ok(()))
}

/// As [`run`]; before each frame `go_on` may end the run.
///
/// # Errors
/// Those of [`run`] and of `go_on`. Finished frames stay, and the report shows them.
pub fn run_while(request: &RunRequest, go_on: &dyn Fn() -> Result<()>) -> Result<PathBuf> {
    run_frames(&Job::open(request)?, go_on)
}

fn run_frames(job: &Job, go_on: &dyn Fn() -> Result<()>) -> Result<PathBuf> {
    let console = Console::new(job.request.quiet, job.frames.clone());
    let mut reconstructor = job.reconstructor(&console)?;
    let (mut metrics, mut last) = job.finished_frames(&mut reconstructor)?;
    let run = job.frames_after(&mut metrics, &mut last, &mut reconstructor, &console, go_on);
    let drawn = match (&run, &last, metrics.frames.last()) {
        (Ok(()), Some(last), Some(record)) => {
            write_turntable(&job.folder, &*job.capture, record.frame, &last.scene, job.devices())
        }
        _ => Ok(()),
    };
    // Also when a frame failed: those before it are finished.
    let has_news = run.is_ok() || !metrics.frames.is_empty();
    let published = if has_news { job.publish(&metrics) } else { Ok(()) };
    first_error([run, published, drawn])?;
    console.finish(&metrics);
    Ok(job.folder.0.join("report.html"))
}

/// The first of the errors; the others are told.
fn first_error<const N: usize>(results: [Result<()>; N]) -> Result<()> {
    let mut errors = results.into_iter().filter_map(Result::err);
    let first = errors.next().map_or(Ok(()), Err);
    errors.for_each(|error| tracing::warn!("{error:#}"));
    first
}

/// Least time between two publications, in units of the duration of the first of them. Publishing takes longer the more
/// frames there are; this bounds it to a twentieth of the run.
const PUBLISHING_INTERVAL: u32 = 20;

struct Job<'a> {
    request: &'a RunRequest,
    capture: Box<dyn Capture>,
    tracks: Vec<Box<dyn TrackSource>>,
    /// Training views used, by index.
    views: Vec<usize>,
    frames: Range<usize>,
    /// Those of them that are read while the one before is trained.
    read_ahead: Range<usize>,
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
        require_end(request, &folder, frames.clone())?;
        let gpus = request.device.open_within(request.memory)?;
        // A method that cannot be made leaves the output folder untouched.
        let context = MethodContext { config: &request.config, tracks: &tracks, gpu: gpus.first() };
        let method = match &request.method {
            Some(method) => {
                if method.build(&context)?.trains_on_cpu() && !gpus.is_empty() {
                    tracing::warn!("--method {method} trains on the CPU, whatever --device says");
                }
                method.clone()
            }
            None if frames.len() == 1 => MethodChoice::suitable(&context)?,
            None => MethodChoice::default().build(&context).map(|_| MethodChoice::default())?,
        };
        let by_lanes = method == MethodChoice::default() && frames.len() > 1;
        let room = memory_need::require(request, &*capture, &views, (by_lanes, !gpus.is_empty()))?;
        let read_ahead = if room == Room::ForReadingAhead { frames.clone() } else { 0..0 };
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
        Ok(Self { request, capture, tracks, views, frames, read_ahead, folder, manifest, gpus, _lock: lock })
    }

    fn reconstructor<'s>(&'s self, console: &'s Console) -> Result<Reconstructor<'s>> {
        let context = MethodContext { config: self.config(), tracks: &self.tracks, gpu: self.gpus.first() };
        Ok(Reconstructor {
            config: self.config().reconstruction(),
            devices: self.devices(),
            capture: &*self.capture,
            views: &self.views,
            tracks: &self.tracks,
            method: self.manifest.method.build(&context)?,
            method_name: self.manifest.method.to_string(),
            monitor: console,
        })
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
        let tracks = track_checksums(capture, &self.views, frame)?;
        Ok(frame_digest(&[&checksums(capture, &views.concat())?, &tracks]))
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
    fn finished_frames(&self, reconstructor: &mut Reconstructor) -> Result<(Metrics, Option<State>)> {
        let finished = |frame: &usize| self.request.resume && self.folder.is_finished(*frame);
        let frames: Vec<usize> = self.frames.clone().take_while(finished).collect();
        // What an interrupted run had begun to remove, or would have removed next.
        let before_last = frames.iter().rev().nth(1).copied();
        let is_left = |f: &&usize| {
            Some(*f) != frames.last()
                && (self.folder.thinned(**f).exists() || Some(**f) == before_last && !self.keeps(**f))
        };
        frames.iter().filter(is_left).try_for_each(|&frame| self.folder.thin(frame))?;
        let records = frames.iter().map(|&frame| self.finished_record(frame));
        let metrics = Metrics::of(records.collect::<Result<_>>()?);
        let load = |&frame: &usize| -> Result<State> {
            let scene = state::load(&self.folder.state(frame), frame)?;
            let saved = self.folder.read_method_state(frame)?;
            let restored = reconstructor.method.restore(&saved, &scene);
            restored.with_context(|| reconstructor.named("state"))?;
            let exposures = read_exposures(&self.folder, frame)?;
            let views = load_training(&*self.capture, &exposures, &self.views, frame)?;
            Ok(State::new(scene, views, exposures))
        };
        Ok((metrics, frames.last().map(load).transpose()?))
    }

    /// Runs the frames that are not in `metrics` yet. Each is read while the one before it is trained.
    fn frames_after(
        &self,
        metrics: &mut Metrics,
        last: &mut Option<State>,
        reconstructor: &mut Reconstructor,
        console: &Console,
        go_on: &dyn Fn() -> Result<()>,
    ) -> Result<()> {
        std::thread::scope(|scope| {
            let mut inputs = ReadAhead::new(scope, &*self.capture, &self.views, self.read_ahead.clone());
            self.frames_from(&mut inputs, metrics, last, reconstructor, console, go_on)
        })
    }

    fn frames_from(
        &self,
        inputs: &mut ReadAhead,
        metrics: &mut Metrics,
        last: &mut Option<State>,
        reconstructor: &mut Reconstructor,
        console: &Console,
        go_on: &dyn Fn() -> Result<()>,
    ) -> Result<()> {
        let mut publish_next = Instant::now();
        for frame in self.frames.clone().skip(metrics.frames.len()) {
            go_on()?;
            console.begin_frame(frame);
            let (next, record) = match last.take() {
                None => self.first_frame(frame, inputs, reconstructor)?,
                Some(previous) => self.later_frame(frame, previous, inputs, reconstructor)?,
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

    /// Frame 0, or the first of the frames asked for.
    fn first_frame(
        &self,
        frame: usize,
        inputs: &mut ReadAhead,
        reconstructor: &mut Reconstructor,
    ) -> Result<(State, FrameRecord)> {
        let start = Instant::now();
        let mut record = FrameRecord { frame, ..FrameRecord::default() };
        let (photographs, sums) = first_views_and_checksums(&*self.capture, &self.views, frame)?;
        inputs.begin(frame + 1);
        record.log.since(stage::LOAD, start);
        write_camera_pictures(&self.folder, &*self.capture, &photographs)?;
        let earlier = self.request.first_frame.as_ref();
        let earlier = earlier.map(|run| self.earlier(&RunFolder(run.clone()), frame)).transpose()?;
        let state = reconstructor.first_frame(frame, photographs, earlier, &mut record.log)?;
        exposures_fact(&state.exposures, 0)
            .into_iter()
            .for_each(|differ| tracing::info!("exposures {differ}"));
        write_usual(&state.exposures, &self.folder)?;
        write_changed(&state.exposures, &self.folder, frame)?;
        record.log.since(stage::WALL, start);
        let (tests, of_tests) = load_tests(&*self.capture, &state.exposures, frame)?;
        let (own, others) = sums.split_at(self.views.len());
        let tracks = track_checksums(&*self.capture, &self.views, frame)?;
        record.inputs = Some(frame_digest(&[own, &of_tests, others, &tracks]));
        let measured = Measured { tests, ..Measured::default() };
        let record = self.finish(frame, &state, reconstructor, measured, record)?;
        Ok((state, record))
    }

    /// The first frame of another run; to be split again where that run marked otherwise.
    fn earlier(&self, run: &RunFolder, frame: usize) -> Result<Earlier> {
        let scene = state::load(&run.state(frame), frame).context("--first-frame")?;
        let other: Result<Manifest> = read_json(&run.manifest());
        let split_again = !other.is_ok_and(|other| other.config.marking.marks_as(&self.config().marking));
        if split_again {
            tracing::info!(
                "--first-frame: {} marked otherwise; its Gaussians are marked again",
                run.0.display()
            );
        }
        Ok(Earlier {
            scene,
            exposures: read_exposures(run, frame)?,
            split_again,
            finetune: self.request.refine_first,
        })
    }

    /// Frame t from t-1.
    fn later_frame(
        &self,
        frame: usize,
        last: State,
        inputs: &mut ReadAhead,
        reconstructor: &mut Reconstructor,
    ) -> Result<(State, FrameRecord)> {
        let start = Instant::now();
        let Inputs { views: now, sums, track_sums } = inputs.take(frame)?;
        inputs.begin(frame + 1);
        let mut record = FrameRecord { frame, ..FrameRecord::default() };
        record.log.since(stage::LOAD, start);
        let mut measured = None;
        let mut measure = |step: &Step, scene: &Scene, exposures: &Exposures| -> Result<()> {
            measured = Some(self.measure_prediction(step, scene, exposures)?);
            Ok(())
        };
        let state = reconstructor.later_frame(frame, last, now, &mut record.log, &mut measure)?;
        let measured = measured.context("the prediction was not measured")?;
        write_changed(&state.exposures, &self.folder, frame)?;
        record.log.add_seconds(stage::WALL, start.elapsed().as_secs_f64() - measured.seconds);
        record.inputs = Some(frame_digest(&[&sums, &measured.sums, &track_sums]));
        let record = self.finish(frame, &state, reconstructor, measured, record)?;
        Ok((state, record))
    }

    /// What is known of the motion initialisation, before the scene is trained.
    fn measure_prediction(&self, step: &Step, scene: &Scene, exposures: &Exposures) -> Result<Measured> {
        let start = Instant::now();
        let pictures = self.motion_pictures(step.frame, &scene.dynamic, step.now)?;
        let (tests, sums) = load_tests(&*self.capture, exposures, step.frame)?;
        let initial_mpsnr = mean_mpsnr(scene, &tests, &self.trained_cameras(step.frame)?, self.devices())?;
        Ok(Measured { tests, sums, pictures, initial_mpsnr, seconds: start.elapsed().as_secs_f64() })
    }

    fn trained_cameras(&self, frame: usize) -> Result<Vec<Camera>> {
        trained_cameras(&*self.capture, &self.views, frame)
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
            write_image(&self.folder.frame(frame).join(name), picture)?;
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
        state: &State,
        reconstructor: &Reconstructor,
        measured: Measured,
        mut record: FrameRecord,
    ) -> Result<FrameRecord> {
        let Measured { tests, mut pictures, initial_mpsnr, .. } = measured;
        let scene = &state.scene;
        record.initial_mpsnr = initial_mpsnr;
        let folder = self.folder.frame(frame);
        let splats = write_splats(&folder, scene)?;
        let trained = self.trained_cameras(frame)?;
        let score =
            |views: &[ScoredView]| score(&*self.capture, scene, (views, &trained), &folder, self.devices());
        (record.views, pictures.views) = score(&tests)?;
        if tests.is_empty() {
            let views = load_trained_on(&*self.capture, &state.exposures, &self.views, frame)?;
            (record.training_views, pictures.views) = score(&views)?;
        }
        write_json(&self.folder.pictures(frame), &pictures)?;
        record.static_gaussians = scene.static_layer.len();
        record.dynamic_gaussians = scene.dynamic.gaussians.len();
        let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
        record.peak_memory_mib = memory::peak_mib();
        record.gpu_memory_mib = device::peak_mib(&self.gpus);
        (record.read_mib, record.processor_seconds) = (memory::read_mib(), memory::processor_seconds());
        let method = &reconstructor.method;
        let stored = method.store(scene, &folder).with_context(|| reconstructor.named("storage"))?;
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

/// What is known of a frame before it is trained, and the test views on which it is measured afterwards.
#[derive(Default)]
struct Measured {
    tests: Vec<ScoredView>,
    /// Of the test views.
    sums: Vec<Checksum>,
    pictures: FramePictures,
    /// Mean foreground PSNR (dB) of the motion initialisation.
    initial_mpsnr: Option<f64>,
    /// How long that took.
    seconds: f64,
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

/// A resumed run goes on from the last of the finished frames, or ends with it.
fn require_end(request: &RunRequest, folder: &RunFolder, frames: Range<usize>) -> Result<()> {
    let finished = frames.take_while(|frame| request.resume && folder.is_finished(*frame));
    let Some(last) = finished.last().filter(|last| folder.thinned(*last).exists()) else { return Ok(()) };
    bail!(
        "{} does not keep the Gaussians of frame {last} (--keep), with which --frames would end it; leave --frames as it was, or \
         choose another --out",
        folder.0.display()
    )
}

#[cfg(test)]
mod tests;
