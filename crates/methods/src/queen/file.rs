//! A frame as a file: what differs from the last one, behind an adaptive range coder.
//!
//! Magic number, counts (u32: Gaussians before, Gaussians now), the decoders' weights (f32), all little-endian; then the coded part:
//! whether each old Gaussian stays; the parent of each new one; whether each is displaced and, if so, its displacement in whole quanta;
//! the latents, attribute by attribute.

use super::decoder::Decoder;
use super::residuals::{Coded, KINDS, Residuals, add_residuals, displaced};
use anyhow::{Context, Result, ensure};
use ffgs_core::Gaussians;
use ffgs_stream::entropy::{Coder, Flag, Number, RangeDecoder, RangeEncoder};

const MAGIC: [u8; 8] = *b"ffqueen1";

/// What the coded part holds.
struct Content {
    parents: Vec<u32>,
    quanta: Vec<[i32; 3]>,
    /// Per attribute, (N, latents).
    latents: [Vec<i32>; 4],
}

/// The bytes of a frame whose displacements are `quanta`.
pub(super) fn write(residuals: &Residuals, before: usize, quanta: &[[i32; 3]]) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    let count = residuals.parents.len();
    [before, count].iter().for_each(|count| out.extend((*count as u32).to_le_bytes()));
    for Coded { decoder, .. } in &residuals.coded {
        out.extend(decoder.weights.iter().flat_map(|weight| weight.to_le_bytes()));
    }
    let whole = |latents: &[f32]| latents.iter().map(|latent| latent.round_ties_even() as i32).collect();
    let latents = [0, 1, 2, 3].map(|k| whole(&residuals.coded[k].latents));
    let mut content = Content { parents: residuals.parents.clone(), quanta: quanta.to_vec(), latents };
    let mut coder = RangeEncoder::new();
    content.code(&mut coder, before, residuals.kept);
    out.extend(coder.finish());
    out
}

/// The Gaussians of a frame, from its file and those of the frame before.
///
/// # Errors
/// When the bytes are none of [`write`], or of another frame.
pub(super) fn read(bytes: &[u8], before: &Gaussians) -> Result<Gaussians> {
    let rest = bytes.strip_prefix(&MAGIC).context("no frame of QUEEN")?;
    let (words, mut rest) = rest.split_first_chunk::<8>().context("the frame ends early")?;
    let [there, count] = [0, 4].map(|at| u32::from_le_bytes([0, 1, 2, 3].map(|k| words[at + k])) as usize);
    ensure!(there == before.len(), "the frame follows one of {there} Gaussians, not of {}", before.len());
    let mut decoders = Vec::new();
    for kind in KINDS {
        let (weights, behind) =
            rest.split_at_checked(4 * Decoder::count(kind.shape())).context("the frame ends early")?;
        let weights = weights.as_chunks().0.iter().map(|word| f32::from_le_bytes(*word)).collect();
        decoders.push(Decoder { shape: kind.shape(), weights });
        rest = behind;
    }
    // A bit per Gaussian is less than any coder needs.
    ensure!(count <= 2 * before.len() + 64 * bytes.len(), "{count} Gaussians in {} bytes", bytes.len());
    let mut content = Content {
        parents: vec![0; count],
        quanta: vec![[0; 3]; count],
        latents: KINDS.map(|kind| vec![0; count * kind.shape().latents]),
    };
    content.code(&mut RangeDecoder::new(rest), before.len(), 0);
    content.gaussians(&decoders, before)
}

impl Content {
    /// Codes in the direction of `coder`; a decoder finds out how many are `kept`.
    fn code(&mut self, coder: &mut impl Coder, before: usize, kept: usize) {
        let mut stays = Flag::default();
        let mut at = 0;
        for old in 0..before {
            let stay = at < kept && self.parents[at] == old as u32;
            if stays.code(coder, stay) {
                // A damaged file may keep more than there are.
                if let Some(parent) = self.parents.get_mut(at) {
                    *parent = old as u32;
                }
                at += 1;
            }
        }
        let (mut step, mut last) = (Number::default(), 0);
        for parent in self.parents.iter_mut().skip(at) {
            last = step.code(coder, (*parent as i32).wrapping_sub(last)).wrapping_add(last);
            *parent = last as u32;
        }
        let (mut moves, mut numbers) = (Flag::default(), [(); 3].map(|()| Number::default()));
        for quanta in &mut self.quanta {
            if moves.code(coder, *quanta != [0; 3]) {
                let coded = quanta.iter_mut().zip(&mut numbers);
                coded.for_each(|(value, number)| *value = number.code(coder, *value));
            }
        }
        for (latents, kind) in self.latents.iter_mut().zip(KINDS) {
            let width = kind.shape().latents;
            let mut numbers = vec![Number::default(); width];
            for (i, latent) in latents.iter_mut().enumerate() {
                *latent = numbers[i % width].code(coder, *latent);
            }
        }
    }

    fn gaussians(self, decoders: &[Decoder], before: &Gaussians) -> Result<Gaussians> {
        ensure!(
            self.parents.iter().all(|&parent| (parent as usize) < before.len()),
            "a Gaussian comes from one that the last frame does not have"
        );
        let mut out = before.select(&self.parents.iter().map(|&i| i as usize).collect::<Vec<_>>());
        for (i, parent) in self.parents.iter().enumerate() {
            out.means[i] = displaced(before.means[*parent as usize], self.quanta[i]);
        }
        for ((kind, decoder), latents) in KINDS.into_iter().zip(decoders).zip(&self.latents) {
            let latents: Vec<f32> = latents.iter().map(|&latent| latent as f32).collect();
            add_residuals(kind, decoder, &latents, (before, &self.parents), &mut out);
        }
        Ok(out)
    }
}
