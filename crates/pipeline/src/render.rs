//! `ffgs render`: pictures of a finished run.

use crate::args::RenderArgs;
use crate::devices::Devices;
use crate::finished_run::FinishedRun;
use crate::folder::RunFolder;
use crate::scoring::{render as render_scene, write_png};
use crate::terminal::{self, progress};
use anyhow::{Context, Result, bail};
use ffgs_core::{Camera, ImageRgb8, Scene};
use ffgs_method::{Capture, Split, ViewAt};
use glam::{DMat3, DMat4, DVec3};
use std::f64::consts::TAU;
use std::path::Path;
use std::process::{Command, Stdio};

/// Pictures held at a time.
const VIEWS_AT_ONCE: usize = 8;
/// Views of an orbit: two seconds of video.
const ORBIT_VIEWS: usize = 60;
/// Room left around the circled object: its outline is about two median distances from its middle.
const ORBIT_MARGIN: f64 = 2.5;
/// Least elevation of an orbit, as a share of its radius.
const ORBIT_ELEVATION: f64 = 0.3;

/// Renders a camera or an orbit of one frame into PNGs, an orbit into an mp4 as well.
///
/// # Errors
/// When the run or its capture cannot be read, or a picture cannot be written.
pub(crate) fn render(args: &RenderArgs) -> Result<()> {
    let run = FinishedRun::open(&args.run)?;
    let frame = run.choose(args.frame)?;
    let scene = run.scene(frame)?;
    let stem = format!("orbit_{frame:06}");
    let views = match (&args.camera, args.orbit) {
        (Some(name), false) => {
            vec![(format!("{name}_{frame:06}.png"), named_camera(&*run.capture, name, frame)?)]
        }
        (None, true) => {
            let cameras = orbit(&*run.capture, &scene, frame)?.into_iter().enumerate();
            cameras.map(|(v, camera)| (format!("{stem}_{v:03}.png"), camera)).collect()
        }
        _ => bail!("choose one view: --camera NAME for a camera of the capture, or --orbit for a circle"),
    };
    let out = args.out.clone().map_or_else(|| RunFolder(args.run.clone()).inside(&["renders"]), Ok)?;
    let gpus = args.device.open()?;
    let bar = progress(args.log.quiet, "views", views.len());
    for group in views.chunks(VIEWS_AT_ONCE) {
        let cameras: Vec<Camera> = group.iter().map(|(_, camera)| *camera).collect();
        let pictures = render_scene(&scene, &cameras, Devices(&gpus))?;
        for ((name, _), picture) in group.iter().zip(&pictures) {
            write_png(&out.join(name), &ImageRgb8::from(picture))?;
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    terminal::print(out.display());
    if args.orbit { write_video(&out, &stem) } else { Ok(()) }
}

/// The pose of a camera at a frame, whatever its split.
fn named_camera(capture: &dyn Capture, name: &str, frame: usize) -> Result<Camera> {
    for split in Split::ALL {
        if let Some(view) = capture.views(split).iter().position(|view| view == name) {
            // Views of the init split have one pose.
            let frame = if split == Split::Init { 0 } else { frame };
            return Ok(capture.camera(ViewAt { split, view, frame })?);
        }
    }
    let names = Split::ALL.iter().flat_map(|&s| capture.views(s)).map(String::as_str);
    bail!("--camera {name}: the capture has {}", names.collect::<Vec<_>>().join(", "))
}

/// Median; 0 of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// Cameras on a circle around one moving object.
fn orbit(capture: &dyn Capture, scene: &Scene, frame: usize) -> Result<Vec<Camera>> {
    let moving = scene.dynamic.gaussians.positions();
    if moving.is_empty() {
        bail!("frame {frame} has no moving Gaussian to circle; choose a --camera");
    }
    let mut cameras = Vec::new();
    for split in [Split::Test, Split::Train] {
        for view in 0..capture.views(split).len() {
            cameras.push(capture.camera(ViewAt { split, view, frame })?);
        }
    }
    let lens = cameras.first().context("the capture has no camera")?;
    let (target, extent) = one_object(&moving);
    circle(&cameras, target, extent)
        .into_iter()
        .map(|pose| Ok(Camera::new(lens.intrinsics(), pose, lens.size())?))
        .collect()
}

/// Middle and median distance (m) of one object: among several, medians over what lies near the present middle
/// settle on one.
fn one_object(points: &[DVec3]) -> (DVec3, f64) {
    let (mut near, mut middle, mut extent) = (points.to_vec(), DVec3::ZERO, 0.0);
    for _ in 0..20 {
        middle = DVec3::from_array([0, 1, 2].map(|a| median(near.iter().map(|p| p[a]))));
        extent = median(near.iter().map(|p| p.distance(middle)));
        let inside = points.iter().copied().filter(|p| p.distance(middle) <= 2.0 * extent);
        let next: Vec<DVec3> = inside.collect();
        if next.is_empty() || next == near {
            break;
        }
        near = next;
    }
    (middle, extent)
}

/// Poses (camera from world) that look at `target`, an object of median radius `extent` (m).
fn circle(cameras: &[Camera], target: DVec3, extent: f64) -> Vec<DMat4> {
    let up = cameras.iter().map(|c| -c.rotation().row(1)).sum::<DVec3>().normalize_or(DVec3::Z);
    // The object and its margin fill the longer side of the image.
    let zoom = cameras
        .first()
        .map_or(1.0, |c| 2.0 * c.intrinsics().focal() / c.size().width.max(c.size().height) as f64);
    let radius = ORBIT_MARGIN * extent.max(1e-3) * (1.0 + zoom);
    let height = median(cameras.iter().map(|c| (c.center() - target).dot(up)));
    let height = height.clamp(ORBIT_ELEVATION * radius, radius);
    let (east, north) = up.any_orthonormal_pair();
    let pose = |v: usize| {
        let (sin, cos) = (TAU * v as f64 / ORBIT_VIEWS as f64).sin_cos();
        let eye = target + radius * (cos * east + sin * north) + height * up;
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = (-(rotation * eye)).extend(1.0);
        pose
    };
    (0..ORBIT_VIEWS).map(pose).collect()
}

/// Joins the pictures of an orbit into an mp4 when there is an ffmpeg; without one the pictures remain.
fn write_video(folder: &Path, stem: &str) -> Result<()> {
    let part = format!("{stem}.mp4.{}.part", std::process::id());
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.current_dir(folder).stdin(Stdio::null());
    ffmpeg.args(["-y", "-loglevel", "error", "-framerate", "30", "-i", &format!("{stem}_%03d.png")]);
    // 4:2:0 wants even sizes.
    ffmpeg.args(["-frames:v", &ORBIT_VIEWS.to_string(), "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"]);
    ffmpeg.args(["-c:v", "libx264", "-pix_fmt", "yuv420p", "-f", "mp4", &part]);
    let output = match ffmpeg.output() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            tracing::info!("no ffmpeg on PATH: pictures only, no mp4");
            return Ok(());
        }
        output => output.context("cannot start ffmpeg")?,
    };
    let (part, video) = (folder.join(part), folder.join(format!("{stem}.mp4")));
    if !output.status.success() {
        // It may never have been created.
        let _ = std::fs::remove_file(&part);
        let reason = String::from_utf8_lossy(&output.stderr);
        bail!("the pictures are written, but ffmpeg made no mp4 of them: {}", reason.trim());
    }
    std::fs::rename(&part, &video).with_context(|| format!("cannot write {}", video.display()))?;
    terminal::print(video.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};

    #[test]
    fn an_orbit_looks_at_its_target_with_the_cameras_up() {
        let lens = Intrinsics { fx: 50.0, fy: 50.0, cx: 32.0, cy: 24.0 };
        let size = ImageSize { width: 64, height: 48 };
        // At (0, -8, 2), forward +y, up +z.
        let rotation = DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y).transpose();
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = (-(rotation * DVec3::new(0.0, -8.0, 2.0))).extend(1.0);
        let camera = Camera::new(lens, pose, size).unwrap();
        let poses = circle(&[camera], DVec3::ZERO, 1.0);
        assert_eq!(poses.len(), ORBIT_VIEWS);
        for pose in poses {
            let camera = Camera::new(lens, pose, size).unwrap();
            let seen = camera.project(DVec3::ZERO).unwrap().pixel;
            assert!((seen - glam::DVec2::new(32.0, 24.0)).length() < 1e-9);
            assert!((2.0 - 1e-9..6.0).contains(&camera.center().z));
            assert!(camera.project(DVec3::Z).unwrap().pixel.y < 24.0);
        }
    }

    #[test]
    fn of_two_objects_one_is_circled() {
        let ball = |center: DVec3| {
            (0..200).map(move |i| center + DVec3::new((i as f64).sin(), (i as f64 * 1.7).cos(), 0.0))
        };
        let points: Vec<DVec3> =
            ball(DVec3::ZERO).chain(ball(DVec3::new(12.0, 0.0, 0.0)).take(150)).collect();
        let (middle, extent) = one_object(&points);
        assert!(middle.length() < 0.3 && extent < 1.5, "{middle} {extent}");
        assert_eq!(one_object(&points[..1]), (points[0], 0.0));
    }
}
