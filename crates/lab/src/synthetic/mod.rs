//! `ffgs-lab synthetic`: a capture of the paper's size and the run of its first frame, for `cargo xtask bench --paper`.

mod scene;

use crate::capture_writer::{CaptureWriter, correspondences};
use anyhow::Result;
use clap::Args;
use ffgs_core::{
    Camera, DenseMotion, Dynamic, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage, Scene,
    ViewMotion,
};
use ffgs_method::{Split, ViewAt};
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::cli::terminal;
use ffgs_pipeline::job::device::Device;
use ffgs_pipeline::job::manifest::Manifest;
use ffgs_pipeline::job::request::{FrameRange, RunRequest};
use ffgs_pipeline::outputs::folder::RunFolder;
use ffgs_pipeline::outputs::json::write_json;
use ffgs_pipeline::outputs::state;
use ffgs_pipeline::plugins::registry::open_capture;
use ffgs_pipeline::settings::config::Config;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, View};
use glam::{DMat3, DMat4, DVec2, DVec3};
use scene::{World, sh0};
use std::path::{Path, PathBuf};

/// Colour of the sky (0..1).
const SKY: [f32; 3] = [0.55, 0.7, 0.9];
/// The paper's views, image size and Gaussians of the static and the dynamic layer.
const VIEWS: f64 = 60.0;
const SIZE: [f64; 2] = [1920.0, 1080.0];
const GAUSSIANS: [f64; 2] = [1e6, 2e5];
/// Test views.
const TESTS: usize = 2;
/// Pixels between two points of the trackers that follow points.
const POINT_SPACING: [usize; 2] = [3, 12];
/// A step of this many pixels along an axis is the largest that the labels of a render can hold.
const LARGEST_STEP: f64 = 512.0;

/// `ffgs-lab synthetic`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Make a capture of the paper's size, or a smaller one, and the run of its first frame",
    long_about = "Makes a capture from Gaussians that this program's rasterizer renders: 60 views of 1920x1080 of a walled \
        yard with four moving bodies, 1 M static and 200 k dynamic Gaussians, exact masks, and three trackers without errors. \
        Beside it, the run of its first frame, from which `ffgs run --first-frame` goes on without training one. Equal \
        options give equal bytes.",
    after_help = "Example:\n  ffgs-lab synthetic --out out/paper --scale 0.1\n  \
        ffgs run out/paper/capture --first-frame out/paper/first --out out/paper/run"
)]
pub(crate) struct SyntheticArgs {
    /// Folder for `capture` and `first`
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Factor on the number of views, the width and the height; its square is that on the Gaussians
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = scale)]
    pub scale: f64,
    /// Frames
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub frames: usize,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

fn scale(text: &str) -> Result<f64, String> {
    let scale: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if (0.03..=4.0).contains(&scale) { Ok(scale) } else { Err("it must be within 0.03..=4".to_owned()) }
}

/// Writes capture and first frame.
///
/// # Errors
/// When a folder is not empty or cannot be written.
pub(crate) fn run(args: &SyntheticArgs) -> Result<()> {
    let counted = |n: f64| (n * args.scale * args.scale).round() as usize;
    let world = World::new(counted(GAUSSIANS[0]), counted(GAUSSIANS[1]));
    let writer = CaptureWriter::new(args.out.join("capture"))?;
    let views = ((VIEWS * args.scale).round() as usize).max(4);
    let foreground = write_capture(&writer, &world, &rig(views, args.scale)?, args.frames.max(1))?;
    write_first_frame(&writer.0, &RunFolder(args.out.join("first")), &world)?;
    terminal::print(format!(
        "{}: {views} views, {} static and {} dynamic Gaussians, {:.1} % foreground",
        writer.0.display(),
        world.static_layer.len(),
        world.dynamic.len(),
        100.0 * foreground
    ));
    Ok(())
}

/// Cameras around the yard, at four heights, that look at its middle: the training views, then the test views.
fn rig(views: usize, scale: f64) -> Result<Vec<Camera>> {
    let [width, height] = SIZE.map(|side| (side * scale).round() as usize);
    let focal = 0.6 * width as f64;
    let camera = |angle: f64, rise: f64| {
        let eye = DVec3::new(14.0 * angle.cos(), 14.0 * angle.sin(), 1.5 + 1.5 * rise);
        let forward = (DVec3::new(0.0, 0.0, 0.8) - eye).normalize();
        let right = forward.cross(DVec3::Z).normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = (-(rotation * eye)).extend(1.0);
        let centre = [width, height].map(|side| side as f64 / 2.0);
        let lens = Intrinsics { fx: focal, fy: focal, cx: centre[0], cy: centre[1] };
        Ok(Camera::new(lens, pose, ImageSize { width, height })?)
    };
    let turn = std::f64::consts::TAU / views as f64;
    let training = (0..views).map(|v| camera(turn * v as f64, (v % 4) as f64));
    let tests = (0..TESTS).map(|v| camera(turn * (0.5 + (v * views / TESTS) as f64), 1.5));
    training.chain(tests).collect()
}

/// Writes everything of a capture; returns the share of the foreground.
fn write_capture(writer: &CaptureWriter, world: &World, rig: &[Camera], frames: usize) -> Result<f64> {
    let training = rig.len() - TESTS;
    let name =
        |v: usize| if v < training { format!("cam{v:03}") } else { format!("test{:03}", v - training) };
    let names: Vec<String> = (0..rig.len()).map(name).collect();
    for (split, range) in [(Split::Train, 0..training), (Split::Test, training..rig.len())] {
        writer.cameras(split, &names[range.clone()], &vec![rig[range].to_vec(); frames])?;
    }
    let trackers: Vec<(String, bool)> =
        POINT_SPACING.iter().map(|s| (format!("points_{s}"), false)).collect();
    writer.trackers(&[trackers.clone(), vec![("dense".to_owned(), true)]].concat())?;
    writer.points(&world.points(1))?;
    let (mut foreground, mut tape) = (0, RenderTape::default());
    for frame in 0..frames {
        let (now, next) = (world.dynamic_at(frame), world.dynamic_at(frame + 1));
        for (view, (camera, name)) in rig.iter().zip(&names).enumerate() {
            let image = ImageRgb8::from(picture(&[&world.static_layer, &now], camera, SKY, &mut tape));
            let labels = Labels::new(world, &now, &next, camera, &mut tape);
            foreground += labels.mask.count();
            writer.view(name, frame, &image, &labels.mask)?;
            if view < training && frame + 1 < frames {
                for (spacing, (tracker, _)) in POINT_SPACING.iter().zip(&trackers) {
                    writer.motion(tracker, name, frame + 1, &labels.points(*spacing))?;
                }
                writer.motion("dense", name, frame + 1, &ViewMotion::Dense(labels.flow))?;
            }
        }
        tracing::info!("frame {frame} of {frames} is written");
    }
    Ok(foreground as f64 / (frames * rig.iter().map(|c| c.size().pixels()).sum::<usize>()) as f64)
}

fn picture<'a>(
    layers: &[&Gaussians],
    camera: &Camera,
    behind: [f32; 3],
    tape: &'a mut RenderTape,
) -> &'a PlanarImage {
    let view = View { camera, background: Background::Colour(behind), tiles: None };
    let options = RenderOptions { sh_degree: Some(0), ..RenderOptions::default() };
    CpuRasterizer::new(options).render_layers(layers, &view, tape);
    tape.image()
}

/// Mask of a view, and the motion of its pixels to the next frame.
struct Labels {
    mask: Mask,
    flow: DenseMotion,
}

impl Labels {
    /// Renders the dynamic Gaussians in the colour of their motion: red and green hold the step, blue says that something
    /// moves.
    fn new(world: &World, now: &Gaussians, next: &Gaussians, camera: &Camera, tape: &mut RenderTape) -> Self {
        let labelled = |layer: &Gaussians, colour: &dyn Fn(usize) -> DVec3| {
            let mut out = Gaussians::zeros(layer.len(), 0);
            out.means.clone_from(&layer.means);
            out.quats.clone_from(&layer.quats);
            out.log_scales.clone_from(&layer.log_scales);
            out.opacity_logits.clone_from(&layer.opacity_logits);
            out.sh = (0..layer.len()).map(|i| sh0(colour(i))).collect();
            out
        };
        let at = |layer: &Gaussians, i: usize| {
            camera.project(DVec3::from(layer.means[i].map(f64::from))).map(|p| p.pixel)
        };
        let step = |i: usize| at(next, i).zip(at(now, i)).map_or(DVec2::ZERO, |(next, now)| next - now);
        let coloured = |i: usize| (step(i) / LARGEST_STEP + 0.5).clamp(DVec2::ZERO, DVec2::ONE).extend(1.0);
        let layers = [labelled(&world.static_layer, &|_| DVec3::ZERO), labelled(now, &coloured)];
        let labels = picture(&[&layers[0], &layers[1]], camera, [0.0; 3], tape);
        let size = camera.size();
        let mut flow = DenseMotion::unknown(size);
        let mut moving = vec![0; size.pixels()];
        for p in 0..size.pixels() {
            let [u, v, share] = labels.pixel(p).map(f64::from);
            if share > 0.5 {
                moving[p] = 1;
                let step = (DVec2::new(u, v) / share - 0.5) * LARGEST_STEP;
                flow.flow[p] = step.as_vec2().to_array();
                (flow.visibility[p], flow.confidence[p]) = (1.0, 1.0);
            }
        }
        Self { mask: Mask::new(size, moving).unwrap_or_else(|| Mask::filled(size, false)), flow }
    }

    /// What a tracker of points finds that starts one every `spacing` pixels.
    fn points(&self, spacing: usize) -> ViewMotion {
        let ImageSize { width, height } = self.flow.size;
        let places =
            (0..height).step_by(spacing).flat_map(|y| (0..width).step_by(spacing).map(move |x| (x, y)));
        let moving = places.filter(|&(x, y)| self.mask.contains(x, y));
        ViewMotion::Tracks(correspondences(moving.map(|(x, y)| {
            let from = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let [u, v] = self.flow.flow[y * width + x].map(f64::from);
            (from, from + DVec2::new(u, v))
        })))
    }
}

/// The truth at frame 0 as the finished first frame of a run.
fn write_first_frame(capture: &Path, run: &RunFolder, world: &World) -> Result<()> {
    let mut dynamic = Dynamic {
        covariances: vec![DMat3::from_diagonal(DVec3::splat(1e-6)); world.dynamic.len()],
        growth_limit: world.dynamic.len(),
        gaussians: world.dynamic.clone(),
        ..Dynamic::default()
    };
    dynamic.number_new();
    let scene = Scene::new(world.static_layer.clone(), dynamic, World::sky());
    state::save(&run.state(0), 0, &scene)?;
    let opened = open_capture(capture)?;
    opened.camera(ViewAt { split: Split::Train, view: 0, frame: 0 })?;
    let request = RunRequest {
        capture: capture.to_owned(),
        out: run.0.clone(),
        resume: false,
        method: None,
        frames: Some(FrameRange { start: 0, end: Some(1) }),
        train_views: None,
        first_frame: None,
        refine_first: None,
        keep: None,
        memory: None,
        device: Device::Cpu,
        quiet: true,
        config: Config::default(),
    };
    let method = ffgs_pipeline::plugins::choice::MethodChoice::default();
    let manifest = Manifest::new(&request, &method, &*opened, &(0..1), "CPU".to_owned())?;
    write_json(&run.manifest(), &manifest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is written opens as a capture without a fault, moves as the bodies do, and a run goes on from its first frame.
    #[test]
    fn a_run_goes_on_from_a_tiny_one() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("paper");
        let args = SyntheticArgs { out: out.clone(), scale: 0.05, frames: 2, log: LogArgs::default() };
        run(&args).unwrap();
        assert!(run(&args).unwrap_err().to_string().contains("not empty"));
        let mut config = Config::default();
        config.dynamic.iterations = 20;
        let report = ffgs_pipeline::job::run::run(&RunRequest {
            capture: out.join("capture"),
            out: out.join("run"),
            resume: false,
            method: None,
            frames: None,
            train_views: None,
            first_frame: Some(out.join("first")),
            refine_first: None,
            keep: None,
            memory: None,
            device: Device::Cpu,
            quiet: true,
            config,
        })
        .unwrap();
        assert!(report.is_file());
        let (before, after) = (
            state::load(&RunFolder(out.join("first")).state(0), 0).unwrap(),
            state::load(&RunFolder(out.join("run")).state(1), 1).unwrap(),
        );
        let mean = |scene: &Scene| {
            let moved =
                scene.dynamic.gaussians.means.iter().zip(&scene.dynamic.ids).filter(|(_, id)| *id % 4 == 0);
            let (sum, n) = moved.fold((0.0, 0), |(sum, n), (mean, _)| (sum + f64::from(mean[0]), n + 1));
            sum / f64::from(n)
        };
        let step = mean(&after) - mean(&before);
        assert!((step - 0.5).abs() < 0.1, "bodies drive 0.5 m per frame, found {step}");
    }
}
