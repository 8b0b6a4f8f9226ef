//! QUEEN: QUantized Efficient ENcoding of Dynamic Gaussians for Streaming Free-viewpoint Videos (Girish et al., NeurIPS 2024).
//!
//! A frame is what differs from the last one: displacements behind hard concrete gates, most of which shut, and for colours, scales,
//! rotations and opacities a few integers per Gaussian, which tiny trained linear decoders turn into residuals. Gates start by how much
//! the photographs changed where the Gaussian is seen; in the first steps only pixels count where that is much. Losses, rates,
//! schedules and dimensions are those of the official code and its configuration `dynerf.yaml`.
//!
//! As in the official code, where the paper says otherwise or nothing: gates are not sampled in training; the "MSE" whose gradients are
//! compared is the mean distance of the colours; a Gaussian's gradients are summed over the views, not averaged; places before the gates
//! go on from frame to frame; density control goes on to the last step, so that what its last round adds is not trained.
//!
//! Deviations:
//! - The first frame is that of this program, for every method (docs/adr/0036); a sky that stays is behind all Gaussians, in place of
//!   black, and renders are antialiased.
//! - SH coefficients above 0 stay as they were. There they are decoded from latents that the first frame trains, which move by two
//!   hundredths of a whole number per frame at their rate of 1.25e-4.
//! - At the end of a frame displacements are rounded to 1e-4 m, as in the official files, so that a file decodes to what is rendered; the
//!   official code renders them unrounded.
//! - Integers are coded by an adaptive range coder (docs/adr/0045), not by static tables with lists of rare values; decoders are raw f32.
//! - Gradient sums count the views in which a Gaussian received a gradient. Of the added Gaussians those that fade or grow too large are
//!   removed before large ones are split, not after; the official limit of 20 px has no effect there and is left out, as in HiCoM.
//! - New Gaussians count their own steps of Adam; there they take over the count. A step of density control trains no decoder.
//! - It runs on the CPU.

mod changes;
mod decoder;
mod file;
mod gates;
mod residuals;
mod training;

use crate::one_layer;
use crate::photographs::Photographs;
use crate::saved::{Reader, Writer};
use anyhow::{Context, Result, ensure};
use decoder::Decoder;
use ffgs_core::{Gaussians, Scene, StageLog, write_atomically};
use ffgs_method::{Finetuning, MotionMethod, Step};
use ffgs_trainer::DensityConfig;
use gates::Gates;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use residuals::{KINDS, Residuals};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;
use training::Frame;

/// Settings of QUEEN.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QueenConfig {
    /// Rounds of all views per frame, one step each.
    pub epochs: usize,
    /// Share of the epochs, the first ones, in which only pixels count where much changed.
    pub masked: f32,
    /// Change of a Gaussian from which its pixels count in these epochs (normalised device coordinates).
    pub mask_gradient: f32,
    /// Edge of the cells of which these pixels are made (px).
    pub mask_cell: usize,
    /// Rate of the gates' log odds.
    pub gate_rate: f32,
    /// Weight of the mean probability of a gate that is not shut.
    pub gate_weight: f32,
    /// Position rate at the first step, as a share of the radius of the cameras.
    pub position_rate: f32,
    /// The same after 30 000 steps.
    pub position_rate_end: f32,
    /// Rate of the latents of SH coefficient 0.
    pub colour_rate: f32,
    /// Rate of their decoder.
    pub colour_decoder_rate: f32,
    /// Rate of the latents of log scales.
    pub scale_rate: f32,
    /// Rate of their decoder.
    pub scale_decoder_rate: f32,
    /// Rate of the latents of quaternions.
    pub rotation_rate: f32,
    /// Rate of their decoder.
    pub rotation_decoder_rate: f32,
    /// Rate of the latents of opacity logits.
    pub opacity_rate: f32,
    /// Rate of their decoder.
    pub opacity_decoder_rate: f32,
    /// Epoch after which density control begins; gradients are summed from two epochs earlier on.
    pub densify_from: usize,
    /// Epochs between two rounds of it; 0 = none.
    pub densify_every: usize,
    /// Mean gradient of the projected position from which a Gaussian is copied or split.
    pub grow_gradient: f32,
    /// Opacity below which an added Gaussian is removed.
    pub prune_opacity: f32,
}

impl Default for QueenConfig {
    fn default() -> Self {
        Self {
            epochs: 10,
            masked: 0.3,
            mask_gradient: 1e-3,
            mask_cell: 48,
            gate_rate: 0.1,
            gate_weight: 0.01,
            position_rate: 5e-4,
            position_rate_end: 1.6e-6,
            colour_rate: 0.0125,
            colour_decoder_rate: 1e-3,
            scale_rate: 0.01,
            scale_decoder_rate: 1e-4,
            rotation_rate: 0.025,
            rotation_decoder_rate: 1e-3,
            opacity_rate: 0.05,
            opacity_decoder_rate: 1e-4,
            densify_from: 6,
            densify_every: 2,
            grow_gradient: 1.25e-3,
            prune_opacity: 0.01,
        }
    }
}

impl QueenConfig {
    fn density(&self) -> DensityConfig {
        let (grow_gradient, prune_opacity) = (self.grow_gradient, self.prune_opacity);
        DensityConfig { grow_gradient, prune_opacity, max_gaussians: usize::MAX, ..DensityConfig::default() }
    }
}

/// What goes on from frame to frame beside the Gaussians.
struct Kept {
    decoders: [Decoder; 4],
    /// Places before the gates (m), (N, 3).
    free: Vec<f32>,
    gates: Gates,
}

impl Kept {
    fn new(gaussians: &Gaussians, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        Self {
            decoders: KINDS.map(|kind| Decoder::new(kind.shape(), &mut rng)),
            free: gaussians.means.as_flattened().to_vec(),
            gates: Gates::new(gaussians.len()),
        }
    }
}

/// The method, with what it keeps between frames.
pub struct Queen {
    config: QueenConfig,
    /// None before the first frame that is trained.
    kept: Option<Kept>,
    /// The last frame's file; none where no frame was trained since the run was begun or resumed.
    file: Vec<u8>,
}

impl Queen {
    /// Nothing has moved yet.
    pub fn new(config: QueenConfig) -> Self {
        Self { config, kept: None, file: Vec::new() }
    }
}

impl MotionMethod for Queen {
    fn trains_on_cpu(&self) -> bool {
        true
    }

    /// Moves nothing: the last frame is where the training starts.
    fn predict(&mut self, _: &Step, scene: &mut Scene, _: &mut StageLog) -> Result<()> {
        one_layer::join(scene);
        Ok(())
    }

    fn finetune(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<Finetuning> {
        let Scene { dynamic, sky, .. } = scene;
        if dynamic.gaussians.is_empty() {
            return Ok(Finetuning::Done);
        }
        let start = Instant::now();
        let before = std::mem::take(&mut dynamic.gaussians);
        let mut kept = self.kept.take().unwrap_or_else(|| Kept::new(&before, step.seed));
        let changes = changes::changes(step, &before, sky);
        kept.gates.start(&changes);
        let mut photographs = Photographs::new(step, sky);
        photographs.masks = changes::masks(step.now, &before, &changes, &self.config);
        log.since("gates", start);
        let start = Instant::now();
        let mut residuals = Residuals::new(&before, kept.free, kept.gates, kept.decoders);
        Frame::new(&self.config, step, &mut residuals, photographs).train(step)?;
        log.since("training", start);
        let start = Instant::now();
        let quanta = residuals.quanta();
        let gaussians = residuals.rounded(&quanta);
        ensure!(
            gaussians.is_finite(),
            "the training diverged; lower the rates of the method's table in --config"
        );
        self.file = file::write(&residuals, before.len(), &quanta);
        let first: Vec<usize> = residuals.parents[..residuals.kept].iter().map(|&i| i as usize).collect();
        let Residuals { free, gates, coded, .. } = residuals;
        self.kept = Some(Kept { decoders: coded.map(|coded| coded.decoder), free, gates });
        one_layer::replace(dynamic, gaussians, &first);
        log.since("coding", start);
        Ok(Finetuning::Done)
    }

    fn store(&self, _: &Scene, folder: &Path) -> Result<Vec<PathBuf>> {
        if self.file.is_empty() {
            return Ok(Vec::new());
        }
        let path = folder.join("frame.queen");
        write_atomically(&path, |out| out.write_all(&self.file))
            .with_context(|| format!("cannot write {}", path.display()))?;
        Ok(vec![path])
    }

    fn save(&self) -> Vec<u8> {
        let Some(Kept { decoders, free, gates }) = &self.kept else { return Vec::new() };
        let out =
            decoders.iter().fold(Writer::default(), |out, decoder| out.column(&decoder.weights)).column(free);
        gates.save(out).finish()
    }

    fn restore(&mut self, state: &[u8], scene: &Scene) -> Result<()> {
        if state.is_empty() {
            return Ok(());
        }
        let mut state = Reader(state);
        let mut weights = || state.column();
        let weights = [weights()?, weights()?, weights()?, weights()?];
        let counts = KINDS.map(|kind| Decoder::count(kind.shape()));
        ensure!(weights.each_ref().map(Vec::len) == counts, "decoders of other attributes");
        let mut kinds = KINDS.into_iter();
        let decoders = weights.map(|weights| {
            let kind = kinds.next().expect("as many decoders as kinds");
            Decoder { shape: kind.shape(), weights }
        });
        let (free, gates) = (state.column()?, Gates::restore(&mut state)?);
        let count = scene.dynamic.gaussians.len();
        ensure!(
            free.len() == 3 * count && gates.log_odds.len() == count,
            "the state is of {} Gaussians, the scene has {count}",
            gates.log_odds.len()
        );
        self.kept = Some(Kept { decoders, free, gates });
        state.end()
    }
}

/// The Gaussians of a frame, from the bytes of its file `frame.queen` and the Gaussians of the frame before (for the first of them the
/// dynamic layer of the first frame, then its static layer).
///
/// # Errors
/// When the bytes are none of such a file, or it follows another frame.
pub fn read_queen_frame(bytes: &[u8], before: &Gaussians) -> Result<Gaussians> {
    file::read(bytes, before)
}

#[cfg(test)]
mod tests;
