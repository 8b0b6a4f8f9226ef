//! `ffgs-lab markers`: the ground truth of a rigid body from points that were measured on it, so that the motion of a
//! filmed capture can be scored.

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use ffgs_arrays::NpzWriter;
use ffgs_fusion::{RigidMotion, fit_rigid};
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::plugins::registry::open_capture;
use glam::{DMat3, DMat4, DVec3};
use serde_json::json;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// `ffgs-lab markers`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Make the ground truth of a filmed rigid body from points that were measured on it",
    long_about = "Writes truth/ of a capture from points that were measured on one rigid body, as the corners of a chessboard: the body's \
        shape is fitted to all frames, its pose to each. A Gaussian counts as part of the body where it lies near the points or a line between two \
        of them. The file has a header with sync_index (or frame), keypoint_id (or point_id), x_coord, y_coord and z_coord, as caliscope writes it, \
        in the units of the capture.",
    after_help = "Example:\n  ffgs-lab markers out/capture --points SESSION/calibration/extrinsic/CHARUCO/xyz_CHARUCO.csv\n  \
        ffgs-lab motion-eval out/capture --run RUN --places run"
)]
pub(crate) struct MarkersArgs {
    /// Folder of the capture
    pub capture: PathBuf,
    /// The measured points
    #[arg(long, value_name = "CSV")]
    pub points: PathBuf,
    /// The file's frame that is frame 0 of the capture [default: its first]
    #[arg(long, value_name = "N")]
    pub first: Option<u64>,
    /// Frames of the file from one frame of the capture to the next
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub every: u64,
    /// How near is near, as a share of the body's largest extent
    #[arg(long, value_name = "SHARE", default_value_t = 0.03)]
    pub reach: f64,
    /// Replace a truth/ that is there
    #[arg(long)]
    pub force: bool,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Fewest points of a frame that give it a pose.
const LEAST_POINTS: usize = 4;
/// Rounds of fitting the shape to the poses and the poses to the shape.
const ROUNDS: usize = 20;

/// Measured points of each frame of a file (m), by the point's name.
type Measured = BTreeMap<u64, BTreeMap<u64, DVec3>>;

/// Writes `truth/poses.json` and `truth/tracks.npz`, and prints how rigid the points are.
///
/// # Errors
/// When the capture or the points cannot be read, too few frames have enough points, or the files cannot be written.
pub(crate) fn run(args: &MarkersArgs) -> Result<()> {
    ensure!(args.reach > 0.0 && args.reach <= 1.0, "--reach is above 0 and at most 1");
    let folder = args.capture.join("truth");
    ensure!(args.force || !folder.exists(), "{} is there already; --force replaces it", folder.display());
    let frames = open_capture(&args.capture)?.frames();
    let measured = read(&args.points)?;
    let first = args.first.or_else(|| measured.keys().next().copied()).unwrap_or_default();
    let measured: Vec<BTreeMap<u64, DVec3>> = (0..frames as u64)
        .map(|frame| measured.get(&(first + frame * args.every)).cloned().unwrap_or_default())
        .collect();
    let body = Body::fit(&measured).with_context(|| {
        format!(
            "{}: fewer than two of the capture's frames share {LEAST_POINTS} points",
            args.points.display()
        )
    })?;
    let reach = args.reach * body.extent();
    write(&folder, &body, reach)?;
    println!("{}: a body of {} points", folder.display(), body.shape.len());
    println!("  frames with a pose   {} of {frames}", body.poses.iter().flatten().count());
    println!("  extent, reach        {:.4}, {reach:.4}", body.extent());
    println!("  points beside body   {:.5} rms, in each axis", body.noise);
    println!("  error of a step      {:.5} rms in 3D at the points, from that", body.step_error());
    Ok(())
}

/// A rigid body: the places of its points, and its pose in every frame.
struct Body {
    /// Places of its points in the body (m), by name.
    shape: BTreeMap<u64, DVec3>,
    /// From the body to the world, where a frame has enough points.
    poses: Vec<Option<RigidMotion>>,
    /// Standard deviation of the measured points about the body, in each axis (m).
    noise: f64,
}

impl Body {
    /// Generalised Procrustes analysis (Gower 1975) without scale: the shape is the mean of the frames' points, brought to
    /// it by their poses. `None` when fewer than two frames have a pose.
    fn fit(frames: &[BTreeMap<u64, DVec3>]) -> Option<Self> {
        let fullest = frames.iter().rev().max_by_key(|points| points.len())?;
        let centre = fullest.values().sum::<DVec3>() / fullest.len().max(1) as f64;
        let mut shape: BTreeMap<u64, DVec3> = fullest.iter().map(|(&id, &at)| (id, at - centre)).collect();
        let mut poses = Vec::new();
        for _ in 0..ROUNDS {
            poses = frames.iter().map(|points| pose(&shape, points)).collect();
            let mut sums: BTreeMap<u64, (DVec3, f64)> = BTreeMap::new();
            for (pose, points) in poses.iter().zip(frames).filter_map(|(pose, p)| Some((pose.as_ref()?, p))) {
                for (&id, &at) in points {
                    let sum = sums.entry(id).or_default();
                    *sum = (sum.0 + in_body(pose, at), sum.1 + 1.0);
                }
            }
            shape = sums.into_iter().map(|(id, (sum, count))| (id, sum / count)).collect();
        }
        let posed = poses.iter().flatten().count();
        let mut squares = 0.0;
        let mut numbers = 0;
        for (pose, points) in poses.iter().zip(frames).filter_map(|(pose, p)| Some((pose.as_ref()?, p))) {
            squares +=
                points.iter().map(|(id, &at)| (pose.apply(shape[id]) - at).length_squared()).sum::<f64>();
            numbers += 3 * points.len();
        }
        // Six numbers are fitted to a frame and three to a point; the six of the whole are counted twice.
        let free = (numbers + 6).checked_sub(6 * posed + 3 * shape.len()).filter(|&free| free > 0)?;
        (posed >= 2).then(|| Self { shape, poses, noise: (squares / free as f64).sqrt() })
    }

    /// Largest distance between two of its points (m).
    fn extent(&self) -> f64 {
        self.pairs().map(|(a, b)| a.distance(b)).fold(0.0, f64::max)
    }

    /// Standard deviation of the step from one frame to the next at a point (m): six of the fitted numbers are shared by
    /// all points of a frame, and a step has two poses.
    fn step_error(&self) -> f64 {
        self.noise * (2.0 * 6.0 / self.shape.len() as f64).sqrt()
    }

    fn pairs(&self) -> impl Iterator<Item = (DVec3, DVec3)> {
        let later = |&(id, a): &(u64, DVec3)| {
            let after = (std::ops::Bound::Excluded(id), std::ops::Bound::Unbounded);
            self.shape.range(after).map(move |(_, &b)| (a, b)).collect::<Vec<_>>()
        };
        self.shape
            .iter()
            .map(|(&id, &at)| (id, at))
            .collect::<Vec<_>>()
            .into_iter()
            .flat_map(move |p| later(&p))
    }

    /// Its points, and those of all lines between two of them, at most `spacing` apart (m).
    fn surface(&self, spacing: f64) -> Vec<DVec3> {
        let mut out: Vec<DVec3> = self.shape.values().copied().collect();
        for (a, b) in self.pairs() {
            let parts = (a.distance(b) / spacing).ceil().max(1.0) as usize;
            out.extend((1..parts).map(|k| a.lerp(b, k as f64 / parts as f64)));
        }
        out
    }
}

/// From the body to the world, where enough of a frame's points are known.
fn pose(shape: &BTreeMap<u64, DVec3>, points: &BTreeMap<u64, DVec3>) -> Option<RigidMotion> {
    let pairs = points.iter().filter_map(|(id, &at)| Some((*shape.get(id)?, at)));
    let (from, to): (Vec<_>, Vec<_>) = pairs.unzip();
    let enough = from.len() >= LEAST_POINTS;
    enough.then(|| fit_rigid(&from, &to, &vec![1.0; from.len()])).flatten()
}

/// A place of the world in the body's frame.
fn in_body(pose: &RigidMotion, at: DVec3) -> DVec3 {
    pose.rotation.inverse() * (at - pose.centre - pose.step) + pose.centre
}

/// The measured points of a file.
fn read(file: &Path) -> Result<Measured> {
    let text = fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let (_, header) = lines.next().with_context(|| format!("{} is empty", file.display()))?;
    let header: Vec<&str> = header.split(',').map(str::trim).collect();
    let column = |names: [&str; 2]| {
        let found = header.iter().position(|title| names.contains(title));
        found.with_context(|| format!("{} has no column {}", file.display(), names[0]))
    };
    let [frame, id] = [column(["sync_index", "frame"])?, column(["keypoint_id", "point_id"])?];
    let axes = [column(["x_coord", "x"])?, column(["y_coord", "y"])?, column(["z_coord", "z"])?];
    let mut out = Measured::new();
    for (row, line) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let whole = |at: usize| cells.get(at).and_then(|cell| cell.parse::<u64>().ok());
        let number =
            |at: usize| cells.get(at).and_then(|cell| cell.parse::<f64>().ok()).filter(|v| v.is_finite());
        let place = axes.map(number);
        let (Some(frame), Some(id), [Some(x), Some(y), Some(z)]) = (whole(frame), whole(id), place) else {
            bail!("{}, line {}: '{line}' is no measured point", file.display(), row + 1);
        };
        let twice = out.entry(frame).or_default().insert(id, DVec3::new(x, y, z)).is_some();
        ensure!(!twice, "{}, line {}: point {id} of frame {frame} is there twice", file.display(), row + 1);
    }
    Ok(out)
}

/// Writes the truth of a capture that has one body, part 1.
fn write(folder: &Path, body: &Body, reach: f64) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let matrix = |pose: &RigidMotion| {
        let rotation = DMat3::from_quat(pose.rotation);
        let translation = pose.centre + pose.step - rotation * pose.centre;
        let whole = DMat4::from_mat3_translation(rotation, translation).transpose();
        whole.to_cols_array_2d()
    };
    let mut poses = BTreeMap::new();
    for (frame, pose) in body.poses.iter().enumerate() {
        let of_frame: BTreeMap<u32, _> = pose.iter().map(|pose| (1, matrix(pose))).collect();
        poses.insert(frame.to_string(), of_frame);
    }
    let text = json!({ "parts": { "1": ["measured", "body"] }, "world_from_part": poses, "reach": reach });
    let file = folder.join("poses.json");
    fs::write(&file, format!("{text:#}\n")).with_context(|| format!("cannot write {}", file.display()))?;

    let surface = body.surface(reach);
    let far = DVec3::splat(f64::from(f32::MAX));
    let frame = |pose: &Option<RigidMotion>| {
        surface.iter().map(|&p| pose.map_or(far, |pose| pose.apply(p))).collect()
    };
    let places: Vec<Vec<DVec3>> = body.poses.iter().map(frame).collect();
    let xyz: Vec<f64> = places.iter().flatten().flat_map(DVec3::to_array).collect();
    NpzWriter::new()
        .u8("part_id", &[surface.len()], &vec![1; surface.len()])
        .f64("xyz", &[places.len(), surface.len(), 3], &xyz)
        .write(&folder.join("tracks.npz"))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_motion_eval::{Kind, Truth};
    use glam::{DAffine3, DQuat};

    /// Poses of a body that turns while it moves.
    fn pose_at(frame: usize) -> DAffine3 {
        let t = frame as f64;
        DAffine3::from_rotation_translation(
            DQuat::from_euler(glam::EulerRot::XYZ, 0.2 * t, -0.1 * t, 0.3),
            DVec3::new(0.4 * t, -0.2, 0.1 * t),
        )
    }

    /// Twelve corners of a board in each of five frames, some missing; frame 3 has three of them.
    fn frames() -> Vec<BTreeMap<u64, DVec3>> {
        let corner = |id: u64| DVec3::new((id % 4) as f64 * 0.05, (id / 4) as f64 * 0.05, 0.0);
        let seen =
            |frame: usize, id: u64| if frame == 3 { id < 3 } else { !(id + frame as u64).is_multiple_of(6) };
        let points = |frame: usize| {
            let here = (0..12).filter(|&id| seen(frame, id));
            here.map(|id| (id, pose_at(frame).transform_point3(corner(id)))).collect()
        };
        (0..5).map(points).collect()
    }

    #[test]
    fn the_motion_of_a_body_is_found_from_its_points() {
        let body = Body::fit(&frames()).unwrap();
        assert!(body.noise < 1e-9 && body.shape.len() == 12);
        assert!((body.extent() - 0.15f64.hypot(0.1)).abs() < 1e-9, "{}", body.extent());
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("truth"), &body, 0.01).unwrap();
        let truth = Truth::read(folder.path()).unwrap();
        assert_eq!(truth.kind(1), Kind::Body);
        let motion = truth.motion(1, 1, 2).unwrap();
        let wanted = pose_at(2) * pose_at(1).inverse();
        let at = pose_at(1).transform_point3(DVec3::new(0.07, 0.03, 0.02));
        assert!(motion.transform_point3(at).distance(wanted.transform_point3(at)) < 1e-9);
        assert!(truth.motion(1, 2, 3).is_none(), "three points are no pose");
        // On the board, beside it by more than the reach, and where a frame has no pose.
        let near = pose_at(1).transform_point3(DVec3::new(0.075, 0.05, 0.003));
        let beside = pose_at(1).transform_point3(DVec3::new(0.075, 0.05, 0.02));
        assert_eq!(truth.parts_at(1, &[near, beside]).unwrap(), [Some(1), None]);
        assert_eq!(truth.parts_at(3, &[near]).unwrap(), [None]);
    }

    #[test]
    fn the_noise_of_the_points_is_told() {
        let mut frames = frames();
        let shift = |frame: usize, id: u64| 1e-3 * ((2 * frame + 3 * id as usize) % 5) as f64;
        for (frame, points) in frames.iter_mut().enumerate() {
            points.iter_mut().for_each(|(&id, at)| at.x += shift(frame, id));
        }
        let noise = Body::fit(&frames).unwrap().noise;
        // 1.41 mm in one axis of three, less what the poses take up.
        assert!((4e-4..1.2e-3).contains(&noise), "{noise}");
    }

    #[test]
    fn what_is_no_measured_point_names_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("xyz.csv");
        let fault = |text: &str| {
            fs::write(&file, text).unwrap();
            format!("{:#}", read(&file).unwrap_err())
        };
        assert!(fault("").contains("is empty"));
        assert!(fault("sync_index,x_coord,y_coord,z_coord\n").contains("no column keypoint_id"));
        let header = "sync_index,object_id,keypoint_id,x_coord,y_coord,z_coord\n";
        assert!(fault(&format!("{header}35,0,0,0.5,0.3,0.1\n35,0,1,NaN,0.3,0.1\n")).contains("line 3"));
        assert!(fault(&format!("{header}35,0,0,1,2,3\n35,0,0,1,2,3\n")).contains("twice"));
        assert!(Body::fit(&frames()[..1]).is_none(), "one frame shows no motion");
    }
}
