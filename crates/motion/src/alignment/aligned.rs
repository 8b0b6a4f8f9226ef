//! The rigid groups aligned with the photographs of t-1 and t, on behalf of the fusion.

use super::align;
use super::continuation::continued;
use super::departures::departures;
use super::surface::{SurfacePoint, surface_points};
use crate::MotionInput;
use ffgs_core::{Gaussians, StageLog, TrainingView};
use ffgs_fusion::{Groups, Photographs};
use glam::DVec3;
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// The photographs of t-1 and t, asked about the rigid groups of a layer.
pub(crate) struct Aligned<'a> {
    input: &'a MotionInput<'a>,
    /// Where it was at t-1.
    layer: &'a Gaussians,
    /// How far its Gaussians came from t-2 to t-1 (m), if that is known.
    steps: Option<&'a [DVec3]>,
    seconds: Duration,
    unaligned: usize,
}

impl<'a> Aligned<'a> {
    pub(crate) fn new(input: &'a MotionInput<'a>, layer: &'a Gaussians, steps: Option<&'a [DVec3]>) -> Self {
        Self { input, layer, steps, seconds: Duration::ZERO, unaligned: 0 }
    }

    /// The time belongs to the alignment, which the fusion asks for.
    pub(crate) fn log(&self, log: &mut StageLog) {
        if self.input.config.alignment.steps > 0 {
            log.skip("rigid groups that the photographs could not align", self.unaligned);
        }
        log.add_seconds("alignment", self.seconds.as_secs_f64());
        log.add_seconds("fusion", -self.seconds.as_secs_f64());
    }
}

impl Photographs for Aligned<'_> {
    fn align(&mut self, groups: &mut Groups) {
        let start = Instant::now();
        let (config, rotate) = (&self.input.config.alignment, self.input.config.association.rotate);
        let last = match self.steps {
            Some(steps) => continued(groups, self.input.previous, steps),
            None => vec![None; groups.found.len()],
        };
        let aligned = align(config, rotate, self.input.step.now, self.layer, &last, groups);
        self.unaligned = groups.found.len() - aligned;
        self.seconds += start.elapsed();
    }

    fn departures(&mut self, groups: &Groups, offsets: &[Option<DVec3>]) -> Vec<f64> {
        if self.input.config.alignment.steps == 0 {
            return vec![0.0; offsets.len()];
        }
        let start = Instant::now();
        let (before, now) = (self.input.step.before, self.input.step.now);
        let pairs =
            before.iter().zip(now).filter(|(before, now)| before.mask.count() > 0 && now.mask.count() > 0);
        let views: Vec<(&TrainingView, &TrainingView)> = pairs.collect();
        let pixels = self.input.config.alignment.pixels;
        let seen: Vec<Vec<Vec<SurfacePoint>>> =
            views.par_iter().map(|(before, _)| surface_points(before, self.layer, groups, pixels)).collect();
        let odds = departures(&views, &seen, groups, offsets);
        self.seconds += start.elapsed();
        odds
    }
}
