//! What is trained of a frame: residuals to the Gaussians of the last one.

use super::QueenConfig;
use super::decoder::{Decoder, Shape};
use super::gates::{Gates, carried, gate};
use ffgs_core::Gaussians;
use ffgs_trainer::{AdamVec, DensityPlan, IndexMap, Update};
use rayon::prelude::*;

/// Of Adam.
const EPSILON: f32 = 1e-15;
/// Steps over which the position rate would decay; a frame takes only the first of them.
pub(super) const DECAY_STEPS: usize = 30_000;
/// Displacements are whole numbers of these (m) where a frame ends.
pub(super) const QUANTUM: f32 = 1e-4;
pub(super) const KINDS: [Kind; 4] = [Kind::Colour, Kind::Scale, Kind::Rotation, Kind::Opacity];

/// Attributes whose residuals are decoded from integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// SH coefficient 0.
    Colour,
    /// Log scales.
    Scale,
    /// Quaternions.
    Rotation,
    /// Opacity logits.
    Opacity,
}

impl Kind {
    pub(super) fn shape(self) -> Shape {
        let shape = |width, latents, deviation, shared| Shape { width, latents, deviation, shared };
        match self {
            Self::Colour => shape(3, 8, 1e-4, false),
            Self::Scale => shape(3, 8, 1e-3, false),
            Self::Rotation => shape(4, 6, 1e-2, false),
            Self::Opacity => shape(1, 3, 1e-4, true),
        }
    }

    /// Rates of latents and decoder.
    fn rates(self, config: &QueenConfig) -> [f32; 2] {
        match self {
            Self::Colour => [config.colour_rate, config.colour_decoder_rate],
            Self::Scale => [config.scale_rate, config.scale_decoder_rate],
            Self::Rotation => [config.rotation_rate, config.rotation_decoder_rate],
            Self::Opacity => [config.opacity_rate, config.opacity_decoder_rate],
        }
    }

    /// The attribute of Gaussian `i`.
    pub(super) fn of(self, gaussians: &Gaussians, i: usize) -> &[f32] {
        match self {
            Self::Colour => &gaussians.sh[i * gaussians.sh_stride()],
            Self::Scale => &gaussians.log_scales[i],
            Self::Rotation => &gaussians.quats[i],
            Self::Opacity => std::slice::from_ref(&gaussians.opacity_logits[i]),
        }
    }

    fn of_mut(self, gaussians: &mut Gaussians, i: usize) -> &mut [f32] {
        let stride = gaussians.sh_stride();
        match self {
            Self::Colour => &mut gaussians.sh[i * stride],
            Self::Scale => &mut gaussians.log_scales[i],
            Self::Rotation => &mut gaussians.quats[i],
            Self::Opacity => std::slice::from_mut(&mut gaussians.opacity_logits[i]),
        }
    }
}

/// Sets one attribute of all Gaussians to `before` (rows `parents`) and the decoded residuals.
pub(super) fn add_residuals(
    kind: Kind,
    decoder: &Decoder,
    latents: &[f32],
    (before, parents): (&Gaussians, &[u32]),
    out: &mut Gaussians,
) {
    let Shape { width, latents: count, .. } = decoder.shape;
    let mut residuals = vec![0.0; parents.len() * width];
    residuals
        .par_chunks_mut(width)
        .zip(latents.par_chunks(count))
        .for_each(|(out, latents)| decoder.decode(latents, out));
    for (i, (residual, parent)) in residuals.chunks(width).zip(parents).enumerate() {
        let before = kind.of(before, *parent as usize);
        let now = kind.of_mut(out, i).iter_mut();
        now.zip(before).zip(residual).for_each(|((now, before), residual)| *now = before + residual);
    }
}

/// A place, so many [`QUANTUM`] from where it was (m).
pub(super) fn displaced(before: [f32; 3], quanta: [i32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|a| before[a] + QUANTUM * quanta[a] as f32)
}

/// One coded attribute.
pub(super) struct Coded {
    pub kind: Kind,
    pub decoder: Decoder,
    /// (N, latents of the decoder).
    pub latents: Vec<f32>,
    adam: AdamVec,
    decoder_adam: AdamVec,
}

impl Coded {
    fn new(kind: Kind, decoder: Decoder, count: usize) -> Self {
        let (width, weights) = (decoder.shape.latents, decoder.weights.len());
        Self {
            kind,
            decoder,
            latents: vec![0.0; count * width],
            adam: AdamVec::new(count, width),
            decoder_adam: AdamVec::new(1, weights),
        }
    }

    fn step(&mut self, gradient: &Gaussians, config: &QueenConfig) {
        let count = self.latents.len() / self.decoder.shape.latents;
        let by: Vec<f32> = (0..count).flat_map(|i| self.kind.of(gradient, i)).copied().collect();
        let (by_latents, by_weights) = self.decoder.backward(&self.latents, &by);
        let [rate, decoder_rate] = self.kind.rates(config);
        self.adam.step(&mut self.latents, &by_latents, (rate, EPSILON), Update::Dense);
        let weights = &mut self.decoder.weights;
        self.decoder_adam.step(weights, &by_weights, (decoder_rate, EPSILON), Update::Dense);
    }

    fn carry(&mut self, sources: &[usize], kept: usize) {
        let width = self.decoder.shape.latents;
        let row = |&i: &usize| &self.latents[i * width..(i + 1) * width];
        self.latents = sources.iter().flat_map(row).copied().collect();
        self.adam = carried(&self.adam, width, sources, kept);
    }
}

/// The parameters of a frame.
pub(super) struct Residuals<'a> {
    before: &'a Gaussians,
    /// Row of `before` that each Gaussian comes from.
    pub parents: Vec<u32>,
    /// How many of the first Gaussians are those of `before` themselves.
    pub kept: usize,
    /// Places (m) before the gates, (N, 3).
    pub free: Vec<f32>,
    adam: AdamVec,
    pub gates: Gates,
    pub coded: [Coded; 4],
}

impl<'a> Residuals<'a> {
    /// Nothing differs from `before` but the places `free`, where the gates let it.
    pub(super) fn new(before: &'a Gaussians, free: Vec<f32>, gates: Gates, decoders: [Decoder; 4]) -> Self {
        let count = before.len();
        let mut kinds = KINDS.into_iter();
        let coded = decoders
            .map(|decoder| Coded::new(kinds.next().expect("as many decoders as kinds"), decoder, count));
        let (parents, adam) = ((0..count as u32).collect(), AdamVec::new(count, 3));
        Self { before, parents, kept: count, free, adam, gates, coded }
    }

    /// Writes the Gaussians into `out`, which holds as many.
    pub(super) fn apply(&self, out: &mut Gaussians) {
        for (i, parent) in self.parents.iter().enumerate() {
            let before = self.before.means[*parent as usize];
            let (open, _) = gate(self.gates.log_odds[i]);
            out.means[i] = [0, 1, 2].map(|a| before[a] + open * (self.free[3 * i + a] - before[a]));
        }
        self.apply_coded(out);
    }

    fn apply_coded(&self, out: &mut Gaussians) {
        for Coded { kind, decoder, latents, .. } in &self.coded {
            add_residuals(*kind, decoder, latents, (self.before, &self.parents), out);
        }
    }

    /// Displacements in [`QUANTUM`]; zero where the gate is shut.
    pub(super) fn quanta(&self) -> Vec<[i32; 3]> {
        let of = |(i, parent): (usize, &u32)| {
            let (open, _) = gate(self.gates.log_odds[i]);
            let before = self.before.means[*parent as usize];
            [0, 1, 2].map(|a| (open * (self.free[3 * i + a] - before[a]) / QUANTUM).round() as i32)
        };
        self.parents.iter().enumerate().map(of).collect()
    }

    /// The Gaussians as a file tells them: displacements in whole [`QUANTUM`].
    pub(super) fn rounded(&self, quanta: &[[i32; 3]]) -> Gaussians {
        let mut out = self.derived();
        for (i, parent) in self.parents.iter().enumerate() {
            out.means[i] = displaced(self.before.means[*parent as usize], quanta[i]);
        }
        self.apply_coded(&mut out);
        out
    }

    /// Copies of the parents.
    pub(super) fn derived(&self) -> Gaussians {
        self.before.select(&self.parents.iter().map(|&i| i as usize).collect::<Vec<_>>())
    }

    /// One step of Adam, given the derivatives by the Gaussians and the rate of positions (m).
    pub(super) fn step(&mut self, gradient: &Gaussians, config: &QueenConfig, rate: f32) {
        let mut by_free = gradient.means.as_flattened().to_vec();
        let mut by_gates = vec![0.0; self.parents.len()];
        for (i, parent) in self.parents.iter().enumerate() {
            let (open, slope) = gate(self.gates.log_odds[i]);
            let (before, by) = (self.before.means[*parent as usize], &mut by_free[3 * i..][..3]);
            for (a, by) in by.iter_mut().enumerate() {
                by_gates[i] += slope * *by * (self.free[3 * i + a] - before[a]);
                *by *= open;
            }
        }
        self.gates.regularise(config.gate_weight, &mut by_gates);
        self.adam.step(&mut self.free, &by_free, (rate, EPSILON), Update::Dense);
        self.gates.step(&by_gates, config.gate_rate);
        self.coded.iter_mut().for_each(|coded| coded.step(gradient, config));
    }

    /// After density control: `grown` are the Gaussians that `map` made of those of [`apply`](Self::apply) by `plan`.
    pub(super) fn follow(&mut self, plan: &DensityPlan, map: &IndexMap, grown: &Gaussians) {
        let (sources, same) = (&map.sources, map.kept());
        self.kept = sources[..same].iter().filter(|&&i| i < self.kept).count();
        self.parents = map.carry(&self.parents);
        self.free = sources.iter().flat_map(|&i| [0, 1, 2].map(|a| self.free[3 * i + a])).collect();
        self.adam = carried(&self.adam, 3, sources, same);
        self.gates = self.gates.carry(sources, same);
        self.coded.iter_mut().for_each(|coded| coded.carry(sources, same));
        let children = map.len() - 2 * plan.split.len()..map.len();
        for i in children {
            self.free[3 * i..][..3].copy_from_slice(&grown.means[i]);
            let parent = self.parents[i] as usize;
            let scale = self.coded.iter_mut().find(|coded| coded.kind == Kind::Scale);
            let Some(Coded { decoder, latents, .. }) = scale else { continue };
            let (before, now) = (self.before.log_scales[parent], grown.log_scales[i]);
            let solved = decoder.invert(&[0, 1, 2].map(|a| now[a] - before[a]));
            latents[i * solved.len()..][..solved.len()].copy_from_slice(&solved);
        }
    }
}
