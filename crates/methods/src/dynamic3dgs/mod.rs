//! Dynamic 3D Gaussians: Tracking by Persistent Dynamic View Synthesis (Luiten et al., 3DV 2024).
//!
//! Every frame starts where the velocities of the last one lead. Places, rotations and colours of all Gaussians are trained on whole
//! photographs and on the masks as images, under terms that keep the neighbours in the foreground rigid, and the background where it was.
//! Losses, weights and rates are those of the official `train.py`.
//!
//! Deviations:
//! - The first frame is that of this program, for every method (docs/adr/0036); a sky that stays is behind all Gaussians, in place of
//!   black, and of the background's colour in the renders of the segmentation; renders are antialiased.
//! - Colours have spherical harmonics: coefficient 0 is trained, at the official rate of colours; the others stay as they were.
//! - What moves is what the masks mark in the first frame, with the marking of this program; the official code has labels of points.
//! - No exposure per camera: the official code trains it in the first frame only.
//! - The floor at y = 0 with y downwards holds for the official captures only: its weight is 0 by default (2 there).
//! - All moments of Adam start anew in each frame, with bias corrections; there those of the colours go on, and the corrections do.
//! - It runs on the CPU.

mod params;
mod segmentation;
mod terms;

use crate::deformation::{columns, unit};
use crate::neighbours::Neighbours;
use crate::one_layer;
use crate::photographs::{Photographs, view_order};
use crate::saved::{Reader, Writer};
use anyhow::{Result, ensure};
use ffgs_core::{Gaussians, SH_C0, Scene, StageLog};
use ffgs_method::{Finetuning, MotionMethod, Step};
use ffgs_rasterizer::{Gradients, RenderOptions};
use ffgs_trainer::{Adam, LearningRates, Schedule, Training, Update, camera_extent};
use glam::{DVec3, Quat, Vec3};
use segmentation::Segmentation;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Instant;
use terms::Poses;

/// Settings of Dynamic 3D Gaussians. Weights are those of the terms of the loss, beside 1 for the photographs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Dynamic3dgsConfig {
    /// Steps per frame, one view each.
    pub iterations: usize,
    /// Position rate, as a share of the radius of the cameras.
    pub position_rate: f32,
    /// Rate of quaternions.
    pub quat_rate: f32,
    /// Rate of colours (0 to 1).
    pub colour_rate: f32,
    /// Neighbours of a Gaussian in the foreground.
    pub neighbours: usize,
    /// Neighbours at distance d (m) weigh `exp(-decay d^2)` (1/m^2).
    pub neighbour_decay: f32,
    /// Weight of the masks as images.
    pub segmentation: f32,
    /// Weight of rigidity.
    pub rigidity: f32,
    /// Weight of equal rotations of neighbours.
    pub rotation: f32,
    /// Weight of the distances of the first frame.
    pub isometry: f32,
    /// Weight of the depth below the floor.
    pub floor: f32,
    /// Weight of the background's distance from the first frame.
    pub background: f32,
    /// Weight of the distance of colours from the last frame.
    pub colour: f32,
}

impl Default for Dynamic3dgsConfig {
    fn default() -> Self {
        Self {
            iterations: 2000,
            position_rate: 1.6e-4,
            quat_rate: 1e-3,
            colour_rate: 2.5e-3,
            neighbours: 20,
            neighbour_decay: 2000.0,
            segmentation: 3.0,
            rigidity: 4.0,
            rotation: 4.0,
            isometry: 2.0,
            floor: 0.0,
            background: 20.0,
            colour: 0.01,
        }
    }
}

/// The method, with what it keeps between frames.
pub struct Dynamic3dgs {
    config: Dynamic3dgsConfig,
    /// Gaussians that move: the first ones.
    foreground: usize,
    /// Poses of the first frame.
    first: Poses,
    /// Poses of the last frame but one; after a prediction, of the last.
    before: Poses,
}

impl Dynamic3dgs {
    /// Before the first frame.
    pub fn new(config: Dynamic3dgsConfig) -> Self {
        Self { config, foreground: 0, first: Poses::default(), before: Poses::default() }
    }

    /// Adds all terms but the photographs' to the gradient.
    fn add_terms(&self, edges: &Neighbours, start: &Gaussians, now: &Gaussians, out: &mut Gaussians) -> f64 {
        let (config, count) = (&self.config, self.foreground);
        let poses = poses(now);
        let moving = Poses { places: poses.places[..count].to_vec(), turns: poses.turns[..count].to_vec() };
        let term = terms::neighbourhood(config, edges, &self.before, &moving);
        for (i, by_place) in term.by_places.iter().enumerate() {
            out.means[i] = (Vec3::from(out.means[i]) + *by_place).to_array();
        }
        let floor = terms::floor(config.floor, &moving.places, &mut out.means[..count]);
        let first = |turns: &[Quat]| turns[count..].iter().map(|t| columns(*t)).collect::<Vec<_>>();
        let places: Vec<[f32; 3]> = self.first.places[count..].iter().map(Vec3::to_array).collect();
        let weight = config.background;
        let mut by_turns: Vec<[f32; 4]> = term.by_turns.iter().map(|t| columns(*t)).collect();
        by_turns.resize(now.len(), [0.0; 4]);
        let stays = terms::stay(weight, &now.means[count..], &places, &mut out.means[count..])
            + terms::stay(weight, &first(&poses.turns), &first(&self.first.turns), &mut by_turns[count..]);
        for (i, [w, x, y, z]) in by_turns.into_iter().enumerate() {
            let length = now.quats[i].iter().map(|q| q * q).sum::<f32>().sqrt();
            let own = terms::through_normalisation(Quat::from_xyzw(x, y, z, w), poses.turns[i], length);
            out.quats[i].iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
        }
        term.value + floor + stays + self.add_colours(start, now, out)
    }

    fn add_colours(&self, start: &Gaussians, now: &Gaussians, out: &mut Gaussians) -> f64 {
        let stride = now.sh_stride();
        let own = |g: &Gaussians| g.sh.iter().step_by(stride).copied().collect::<Vec<_>>();
        let mut gradient = own(out);
        let value = terms::stay(SH_C0 * self.config.colour, &own(now), &own(start), &mut gradient);
        out.sh.iter_mut().step_by(stride).zip(gradient).for_each(|(out, gradient)| *out = gradient);
        value
    }

    fn rates(&self, extent: f32) -> LearningRates {
        let (means, quats) = (self.config.position_rate * extent, self.config.quat_rate);
        let sh0 = self.config.colour_rate / SH_C0;
        LearningRates { means, quats, sh0, scales: 0.0, opacities: 0.0, sh_rest: 0.0 }
    }
}

impl MotionMethod for Dynamic3dgs {
    fn trains_on_cpu(&self) -> bool {
        true
    }

    fn begin(&mut self, first: &Scene) -> Result<()> {
        let mut all = first.clone();
        self.foreground = first.dynamic.gaussians.len();
        one_layer::join(&mut all);
        self.first = poses(&all.dynamic.gaussians);
        self.before = self.first.clone();
        Ok(())
    }

    /// Everything goes on as in the last frame.
    fn predict(&mut self, _: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<()> {
        one_layer::join(scene);
        let dynamic = &mut scene.dynamic;
        let now = poses(&dynamic.gaussians);
        ensure!(
            now.places.len() == self.before.places.len(),
            "the number of Gaussians changed between frames"
        );
        if self.foreground == 0 && !now.places.is_empty() {
            log.warn("the masks hold no Gaussian: all is background, which stays");
        }
        for (i, (place, before)) in now.places.iter().zip(&self.before.places).enumerate() {
            let step = *place - *before;
            dynamic.gaussians.means[i] = (*place + step).to_array();
            dynamic.steps.push(DVec3::from(step));
        }
        for (i, (turn, before)) in now.turns.iter().zip(&self.before.turns).enumerate() {
            dynamic.gaussians.quats[i] = columns(unit(columns(*turn + (*turn - *before))));
        }
        self.before = now;
        Ok(())
    }

    fn finetune(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<Finetuning> {
        let Scene { dynamic, sky, .. } = scene;
        let gaussians = &mut dynamic.gaussians;
        if gaussians.is_empty() {
            return Ok(Finetuning::Done);
        }
        let timer = Instant::now();
        let start: Vec<[f32; 3]> = self.first.places[..self.foreground].iter().map(Vec3::to_array).collect();
        let edges =
            Neighbours::new(&start, self.config.neighbours, terms::fall(self.config.neighbour_decay))?;
        let mut training = Frame {
            method: self,
            edges,
            start: gaussians.clone(),
            segmentation: Segmentation::new(step.now, gaussians, self.foreground),
            photographs: Photographs::new(step, sky),
            adam: Adam::new(gaussians.len(), gaussians.sh_degree()),
            gradients: Gradients::default(),
            gaussians,
        };
        let rates = self.rates(camera_extent(step.now));
        let schedule =
            Schedule { iterations: self.config.iterations, rates: &|_| rates, ..Schedule::default() };
        schedule.run(&mut training, &mut view_order(step), |_, _| Ok(()), &mut |_| ())?;
        log.since("training", timer);
        Ok(Finetuning::Done)
    }

    /// `params.npz` with what a frame changes: 40 bytes per Gaussian, before they are deflated.
    fn store(&self, scene: &Scene, folder: &Path) -> Result<Vec<PathBuf>> {
        if !scene.static_layer.is_empty() {
            return Ok(Vec::new());
        }
        let file = folder.join("params.npz");
        params::write(&file, &scene.dynamic.gaussians)?;
        Ok(vec![file])
    }

    fn save(&self) -> Vec<u8> {
        let poses = |out: Writer, poses: &Poses| {
            let places: Vec<f32> = poses.places.iter().flat_map(Vec3::to_array).collect();
            let turns: Vec<f32> = poses.turns.iter().flat_map(|turn| columns(*turn)).collect();
            out.column(&places).column(&turns)
        };
        let out = Writer::default().count(self.foreground);
        poses(poses(out, &self.first), &self.before).finish()
    }

    fn restore(&mut self, state: &[u8], scene: &Scene) -> Result<()> {
        let mut state = Reader(state);
        self.foreground = state.count()?;
        for poses in [&mut self.first, &mut self.before] {
            let (places, turns) = (state.column()?, state.column()?);
            poses.places = places.as_chunks::<3>().0.iter().map(|place| Vec3::from(*place)).collect();
            poses.turns = turns.as_chunks::<4>().0.iter().map(|turn| quat(*turn)).collect();
            let count = scene.static_layer.len() + scene.dynamic.gaussians.len();
            ensure!(
                poses.places.len() == count && poses.turns.len() == count && self.foreground <= count,
                "the state is of {} Gaussians, the scene has {count}",
                poses.places.len()
            );
        }
        state.end()
    }
}

/// A frame under training.
struct Frame<'a> {
    method: &'a Dynamic3dgs,
    edges: Neighbours,
    /// As the prediction left them.
    start: Gaussians,
    segmentation: Segmentation<'a>,
    photographs: Photographs<'a>,
    adam: Adam,
    gradients: Gradients,
    gaussians: &'a mut Gaussians,
}

impl Training for Frame<'_> {
    type Error = anyhow::Error;

    fn forward(&mut self, view: usize, _: RenderOptions) -> Result<()> {
        self.photographs.forward(view, self.gaussians).map(|_| ())
    }

    fn backward(&mut self) -> Result<()> {
        self.photographs.backward(self.gaussians, &mut self.gradients);
        let (view, weight) = (self.photographs.at, self.method.config.segmentation);
        let sum = &mut self.gradients.gaussians;
        self.segmentation.add(weight, view, self.gaussians, sum)?;
        self.method.add_terms(&self.edges, &self.start, self.gaussians, sum);
        Ok(())
    }

    fn step(&mut self, rates: &LearningRates) -> Result<()> {
        self.adam.step(self.gaussians, &self.gradients.gaussians, rates, Update::Dense);
        Ok(())
    }
}

fn quat([w, x, y, z]: [f32; 4]) -> Quat {
    Quat::from_xyzw(x, y, z, w)
}

fn poses(gaussians: &Gaussians) -> Poses {
    Poses {
        places: gaussians.means.iter().map(|mean| Vec3::from(*mean)).collect(),
        turns: gaussians.quats.iter().map(|quat| unit(*quat)).collect(),
    }
}

#[cfg(test)]
mod tests;
