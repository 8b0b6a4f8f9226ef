//! Frames of a run fitted to plain viewers: what stands still once, the rest in each frame.

use crate::outputs::finished_run::FinishedRun;
use anyhow::Result;
use ffgs_bake::{FitConfig, conserve_weight, fit};
use ffgs_core::{Gaussians, PixelFilter, Scene};
use ffgs_trainer::{CpuBackend, Progress};
use std::collections::HashMap;

/// The share of the first frame's steps that a later frame takes: only what changed is fitted there.
const LATER_SHARE: usize = 3;

/// Bakes frames, the first one first. What the static layer gets in a frame it keeps; an export that goes on after an interruption
/// fits what changed since the first frame once more.
pub(crate) struct Baker<'a> {
    run: &'a FinishedRun,
    first: usize,
    iterations: usize,
    show: &'a dyn Fn(String),
    still: Option<Still>,
}

impl<'a> Baker<'a> {
    /// The static layer is baked in frame `first`, in so many steps. `show` is told how far a frame is.
    pub(crate) fn new(
        run: &'a FinishedRun,
        first: usize,
        iterations: usize,
        show: &'a dyn Fn(String),
    ) -> Self {
        Self { run, first, iterations, show, still: None }
    }

    /// Static and dynamic Gaussians of a frame, in this order, for viewers without compensation.
    pub(crate) fn bake(&mut self, scene: &Scene, frame: usize) -> Result<Gaussians> {
        let joint = scene.joint();
        if joint.filter == PixelFilter::Plain {
            return Ok(joint);
        }
        if self.still.is_none() {
            let first = self.run.scene(self.first)?;
            self.still = Some(self.bake_first(&first)?);
        }
        let Some(still) = &self.still else { return Ok(joint) };
        let statics = scene.static_layer.len();
        let is_kept = |&i: &usize| i < statics && still.place_of(&joint, i).is_some();
        let (kept, fitted): (Vec<usize>, Vec<usize>) = (0..joint.len()).partition(is_kept);
        let order = [&kept[..], &fitted].concat();
        let trained = joint.select(&order);
        let mut baked = still.now(&joint.select(&kept));
        baked.extend(&plain(&joint.select(&fitted)));
        self.fit(&mut baked, &trained, kept.len(), scene, frame)?;
        let new: Vec<usize> = (kept.len()..statics).collect();
        if let Some(still) = &mut self.still {
            still.learn(&trained.select(&new), &baked.select(&new));
        }
        Ok(baked.select(&inverse(&order)))
    }

    /// All of the first frame together, of which the static layer is kept.
    fn bake_first(&self, scene: &Scene) -> Result<Still> {
        let trained = scene.joint();
        let mut baked = plain(&trained);
        if !scene.static_layer.is_empty() {
            self.fit(&mut baked, &trained, 0, scene, self.first)?;
        }
        let statics: Vec<usize> = (0..scene.static_layer.len()).collect();
        let mut still = Still::new(baked.select(&[]));
        still.learn(&scene.static_layer, &baked.select(&statics));
        Ok(still)
    }

    /// Fits the Gaussians from number `first` on; `trained` are the same Gaussians as the run has them.
    fn fit(
        &self,
        baked: &mut Gaussians,
        trained: &Gaussians,
        first: usize,
        scene: &Scene,
        frame: usize,
    ) -> Result<()> {
        let cameras = self.run.trained_cameras(frame)?;
        conserve_weight(baked, trained, first..trained.len(), &cameras);
        let iterations = if first == 0 { self.iterations } else { self.iterations / LATER_SHARE };
        let config = FitConfig { iterations, seed: frame as u64, ..FitConfig::default() };
        let mut report =
            |p: Progress| (self.show)(format!("frame {frame}: step {} of {}", p.iteration, p.iterations));
        let Ok(()) = fit(&CpuBackend, baked, first, scene, &cameras, &config, &mut report);
        Ok(())
    }
}

/// All Gaussians that the static layer has had so far, as baked.
struct Still {
    /// Where the Gaussian with this shape lies among them.
    places: HashMap<[u32; 11], usize>,
    baked: Gaussians,
    /// What baking added to the colours.
    colour_change: Vec<[f32; 3]>,
}

impl Still {
    /// Without any, with the SH degree and filter of `none`.
    fn new(none: Gaussians) -> Self {
        Self { places: HashMap::new(), baked: none, colour_change: Vec::new() }
    }

    /// Keeps what became of static Gaussians.
    fn learn(&mut self, trained: &Gaussians, baked: &Gaussians) {
        let first = self.baked.len();
        self.places.extend((0..trained.len()).map(|i| (shape_of(trained, i), first + i)));
        self.baked.extend(baked);
        let colours = baked.sh.iter().zip(&trained.sh);
        self.colour_change.extend(colours.map(|(new, old)| [0, 1, 2].map(|c| new[c] - old[c])));
    }

    /// Which one this Gaussian is, if nothing but its colours changed: one that joined the static layer, was learnt anew or is left out
    /// in this frame is none of an earlier one.
    fn place_of(&self, gaussians: &Gaussians, i: usize) -> Option<usize> {
        self.places.get(&shape_of(gaussians, i)).copied()
    }

    /// Gaussians of a later frame that have a place: shapes and opacities as baked, colours with what baking added.
    fn now(&self, trained: &Gaussians) -> Gaussians {
        let places: Vec<usize> = (0..trained.len()).filter_map(|i| self.place_of(trained, i)).collect();
        let mut out = self.baked.select(&places);
        let changes = places.iter().flat_map(|&place| {
            let stride = self.baked.sh_stride();
            &self.colour_change[place * stride..(place + 1) * stride]
        });
        let colours = trained.sh.iter().zip(changes);
        out.sh = colours.map(|(sh, change)| [0, 1, 2].map(|c| sh[c] + change[c])).collect();
        out
    }
}

/// Everything but the colours, to the bit.
fn shape_of(gaussians: &Gaussians, i: usize) -> [u32; 11] {
    let ([x, y, z], [a, b, c, d]) = (gaussians.means[i], gaussians.quats[i]);
    let [sx, sy, sz] = gaussians.log_scales[i];
    [x, y, z, a, b, c, d, sx, sy, sz, gaussians.opacity_logits[i]].map(f32::to_bits)
}

/// Where each number lies in an order of all numbers.
fn inverse(order: &[usize]) -> Vec<usize> {
    let mut places = vec![0; order.len()];
    order.iter().enumerate().for_each(|(place, &i)| places[i] = place);
    places
}

fn plain(gaussians: &Gaussians) -> Gaussians {
    gaussians.clone().with_filter(PixelFilter::Plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gaussians of SH degree 1, told apart by their positions, in one colour.
    fn at(places: &[f32], colour: f32) -> Gaussians {
        let mut out = Gaussians::zeros(places.len(), 1);
        out.means = places.iter().map(|&x| [x, 0.0, 0.0]).collect();
        out.sh.fill([colour; 3]);
        out
    }

    #[test]
    fn what_was_baked_is_found_again_by_its_shape_and_follows_the_colours_of_now() {
        let mut baked = at(&[0.5, 1.5, 2.5], 2.0).with_filter(PixelFilter::Plain);
        baked.sh[4..8].fill([3.0; 3]);
        let mut still = Still::new(baked.select(&[]));
        still.learn(&at(&[0.0, 1.0, 2.0], 1.0), &baked);
        // The first was removed, the last but one is new, and the last became transparent.
        let mut later = at(&[1.0, 2.0, 9.0, 0.0], 10.0);
        later.opacity_logits[3] = -10.0;
        let places: Vec<_> = (0..4).map(|i| still.place_of(&later, i)).collect();
        assert_eq!(places, [Some(1), Some(2), None, None]);
        let now = still.now(&later.select(&[0, 1]));
        assert_eq!((now.means, now.filter), (vec![[1.5, 0.0, 0.0], [2.5, 0.0, 0.0]], PixelFilter::Plain));
        assert_eq!(now.sh, [[[12.0; 3]; 4], [[11.0; 3]; 4]].concat());
        assert!(still.now(&later.select(&[])).is_empty());
        still.learn(&later.select(&[2]), &at(&[9.5], 11.0).with_filter(PixelFilter::Plain));
        assert_eq!(still.place_of(&later, 2), Some(3));
        assert_eq!(still.now(&at(&[9.0], 20.0)).sh, [[21.0; 3]; 4]);
    }

    #[test]
    fn an_order_and_its_inverse_cancel() {
        let all = at(&[0.0, 1.0, 2.0, 3.0], 0.0);
        let order = [2, 0, 3, 1];
        assert_eq!(all.select(&order).select(&inverse(&order)), all);
    }
}
