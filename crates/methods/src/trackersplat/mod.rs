//! TrackerSplat: Exploiting Point Tracking for Fast and Robust Dynamic 3D Gaussians Reconstruction (Yin et al., SIGGRAPH Asia 2025).
//!
//! Tracks of every pixel give each Gaussian an affine motion of its footprint in every view; from these a place (DLT) and a rotation (from
//! the images of its covariance) are solved. What stands still is fixed, translations are smoothed by the median of the neighbours, and
//! both spread to Gaussians that were not solved. Then all parameters are trained on whole photographs, without densification.
//! Thresholds and rates are those of the official code.
//!
//! Deviations:
//! - The first frame is that of this program, for every method (docs/adr/0036); a sky that stays is behind all Gaussians, in place of
//!   black, and renders are antialiased.
//! - Tracks are the capture's, from t-1 to t, so that a window holds one frame and frames run one after another; the official code tracks up to
//!   ten frames from one base frame with DOT. A tracker with a motion per pixel is taken where there is one, else tracks are densified by
//!   this program (`[voronoi]`) over the whole image.
//! - Sums under footprints are kept in f32 about the image's centre.
//! - A place is trusted by `(1 - error / 2) / (1 + s)`, s the smallest singular value: the official `1 - error` is negative from 1 on.
//! - Axes of a solved covariance have the sense of the old ones; the official code takes the signs that the eigenvectors happen to have.
//! - A round of spreading visits all neighbours; the official kernel visits as many Gaussians as are not solved.

mod footprints;
mod solve;
mod spread;

use crate::added::SH0_BY_REST;
use crate::deformation::{columns, unit};
use crate::neighbours::Neighbours;
use crate::one_layer;
use crate::photographs::frame_seed;
use anyhow::{Result, ensure};
use ffgs_core::{DenseMotion, Gaussians, Mask, Scene, SkyCube, StageLog, TrackSet, ViewMotion};
use ffgs_method::{Finetuning, MotionMethod, Step};
use ffgs_trainer::{Around, LayerTask, LearningRates, Schedule, TaskView, camera_extent, decay};
use ffgs_voronoi::{SourceFilter, VoronoiConfig, densify_view};
use footprints::{Footprint, footprints, is_fixed};
use glam::{DQuat, DVec3, Quat};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use solve::{Seen, Shape, Solved, solve};
use std::sync::Arc;
use std::time::Instant;

/// Neighbours of a Gaussian.
const NEIGHBOURS: usize = 8;

/// Settings of TrackerSplat: those of its training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackersplatConfig {
    /// Steps per frame, one view each.
    pub iterations: usize,
    /// Position rate at the first step, as a share of the radius of the cameras.
    pub position_rate: f32,
    /// The same at the last step.
    pub position_rate_end: f32,
    /// Rate of quaternions.
    pub quat_rate: f32,
    /// Rate of log scales.
    pub scale_rate: f32,
    /// Rate of opacity logits.
    pub opacity_rate: f32,
    /// Rate of SH coefficient 0; the others have a twentieth.
    pub sh0_rate: f32,
}

impl Default for TrackersplatConfig {
    fn default() -> Self {
        Self {
            iterations: 1000,
            position_rate: 1.6e-4,
            position_rate_end: 1.6e-6,
            quat_rate: 1e-3,
            scale_rate: 1e-6,
            opacity_rate: 0.05,
            sh0_rate: 2.5e-3,
        }
    }
}

impl TrackersplatConfig {
    fn rates(&self, step: usize, extent: f32) -> LearningRates {
        LearningRates {
            means: decay(self.position_rate, self.position_rate_end, step, self.iterations) * extent,
            quats: self.quat_rate,
            scales: self.scale_rate,
            opacities: self.opacity_rate,
            sh0: self.sh0_rate,
            sh_rest: self.sh0_rate / SH0_BY_REST,
        }
    }
}

/// Trains a layer on the device of the run; the seed fixes the order of views.
pub type TrainLayer<'a> = dyn Fn(LayerTask, &Schedule, u64) -> Result<()> + Send + 'a;

/// The method; it keeps nothing between frames.
pub struct Trackersplat<'a> {
    /// Settings of the training.
    pub config: TrackersplatConfig,
    /// How tracks become a motion per pixel.
    pub voronoi: VoronoiConfig,
    /// What trains.
    pub train: Box<TrainLayer<'a>>,
}

impl MotionMethod for Trackersplat<'_> {
    fn predict(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<()> {
        one_layer::join(scene);
        let dynamic = &mut scene.dynamic;
        if dynamic.gaussians.is_empty() {
            return Ok(());
        }
        let start = Instant::now();
        let views = self.observe(step, &dynamic.gaussians, log)?;
        log.since("footprints", start);
        let start = Instant::now();
        let (moved, turned) = motions(step, &dynamic.gaussians, &views, log)?;
        for (i, (step, turn)) in moved.iter().zip(turned).enumerate() {
            let gaussians = &mut dynamic.gaussians;
            gaussians.means[i] =
                (DVec3::from_array(gaussians.means[i].map(f64::from)) + *step).as_vec3().to_array();
            let turn: Quat = DQuat::from_scaled_axis(turn).as_quat();
            gaussians.quats[i] = columns(turn * unit(gaussians.quats[i]));
        }
        dynamic.steps = moved;
        log.since("solve", start);
        Ok(())
    }

    fn finetune(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<Finetuning> {
        let Scene { dynamic, sky, .. } = scene;
        if !dynamic.gaussians.is_empty() {
            let start = Instant::now();
            let gaussians = std::mem::take(&mut dynamic.gaussians);
            dynamic.gaussians = self.trained(step, gaussians, sky)?;
            log.since("training", start);
        }
        Ok(Finetuning::Done)
    }

    fn restore(&mut self, state: &[u8], _: &Scene) -> Result<()> {
        ensure!(state.is_empty(), "{} bytes of state: TrackerSplat keeps none", state.len());
        Ok(())
    }
}

impl Trackersplat<'_> {
    /// Footprints of all Gaussians, per view.
    fn observe(&self, step: &Step, gaussians: &Gaussians, log: &mut StageLog) -> Result<Vec<Vec<Footprint>>> {
        let mut views = Vec::new();
        for (i, view) in step.before.iter().enumerate() {
            let motion = self.motion(step, i)?;
            log.skip("views without a track", usize::from(motion.is_none()));
            let motion = motion.unwrap_or_else(|| DenseMotion::unknown(view.camera.size()));
            views.push(footprints(gaussians, &view.camera, &motion));
        }
        Ok(views)
    }

    /// A motion per pixel of the `i`-th view: of the first tracker that has one, else from the most tracks.
    fn motion(&self, step: &Step, i: usize) -> Result<Option<DenseMotion>> {
        let mut most = None;
        for source in step.tracks {
            match source.motion(&step.of_view(i))?.map(|tracked| tracked.motion) {
                Some(ViewMotion::Dense(dense)) => return Ok(Some(dense)),
                Some(ViewMotion::Tracks(set))
                    if most.as_ref().is_none_or(|m: &TrackSet| m.src.len() < set.src.len()) =>
                {
                    most = Some(set);
                }
                _ => {}
            }
        }
        let Some(set) = most.filter(|set| !set.src.is_empty()) else { return Ok(None) };
        let everywhere = Mask::filled(step.before[i].camera.size(), true);
        let config = VoronoiConfig { source_filter: SourceFilter::All, ..self.voronoi };
        Ok(Some(densify_view(&config, &set, &everywhere)?))
    }

    fn trained(&self, step: &Step, gaussians: Gaussians, sky: &SkyCube) -> Result<Gaussians> {
        let mut layer = Arc::new(gaussians);
        let views = step.now.iter().map(|view| TaskView { view, region: None, tiles: None }).collect();
        let task = LayerTask::new(&mut layer, views, Around::Sky(sky));
        let extent = camera_extent(step.now);
        let schedule = Schedule {
            iterations: self.config.iterations,
            rates: &|done| self.config.rates(done, extent),
            ..Schedule::default()
        };
        (self.train)(task, &schedule, frame_seed(step))?;
        let trained = Arc::unwrap_or_clone(layer);
        ensure!(
            trained.is_finite(),
            "the training diverged; lower the rates of the method's table in --config"
        );
        Ok(trained)
    }
}

/// Translations (m) and turns (rotation vectors) of all Gaussians.
fn motions(
    step: &Step,
    gaussians: &Gaussians,
    views: &[Vec<Footprint>],
    log: &mut StageLog,
) -> Result<(Vec<DVec3>, Vec<DVec3>)> {
    let of = |i: usize| {
        let seen: Vec<Footprint> = views.iter().map(|view| view[i]).collect();
        if is_fixed(&seen) {
            return (true, Solved::default());
        }
        let cameras = step.before.iter().zip(step.now).map(|(before, now)| [&before.camera, &now.camera]);
        let moving = seen.into_iter().zip(cameras).filter(|(footprint, _)| footprint.affine.is_some());
        let seen: Vec<Seen> = moving.map(|(footprint, cameras)| Seen { cameras, footprint }).collect();
        (false, solve(&shape(gaussians, i), &seen))
    };
    let (fixed, solved): (Vec<bool>, Vec<Solved>) = (0..gaussians.len()).into_par_iter().map(of).unzip();
    let edges = Neighbours::new(&gaussians.means, NEIGHBOURS, spread::weights)?;
    let moved: Vec<_> = solved.iter().map(|solved| solved.moved).collect();
    let turned: Vec<_> =
        solved.iter().map(|s| s.turned.map(|(turn, trust)| (turn.to_scaled_axis(), trust))).collect();
    let fixed = spread::spread_fixed(&edges, &fixed);
    let unsolved = fixed.iter().zip(&moved).filter(|(fixed, moved)| !**fixed && moved.is_none()).count();
    log.skip("Gaussians not solved, which follow their neighbours", unsolved);
    let moved = spread::spread(&edges, &spread::median(&edges, &moved));
    let turned = spread::spread(&edges, &turned);
    let unless_fixed = |values: Vec<DVec3>| {
        values
            .into_iter()
            .zip(&fixed)
            .map(|(value, fixed)| if *fixed { DVec3::ZERO } else { value })
            .collect()
    };
    Ok((unless_fixed(moved), unless_fixed(turned)))
}

fn shape(gaussians: &Gaussians, i: usize) -> Shape {
    Shape {
        place: DVec3::from_array(gaussians.means[i].map(f64::from)),
        turn: unit(gaussians.quats[i]).as_dquat().normalize(),
        axes: DVec3::from_array(gaussians.log_scales[i].map(|s| f64::from(s).exp())),
    }
}

#[cfg(test)]
mod tests;
