//! Rounding of Gaussians to integers, and back.

use crate::harmonics::{HarmonicChannels, PRICE, choose};
use crate::row::{MAX_HARMONICS, Row};
use ffgs_core::{Gaussians, logit, sigmoid};
use serde::{Deserialize, Serialize};

/// Levels of the position's step: at most `2^MAX_LEVEL` of the smallest.
const MAX_LEVEL: i32 = 20;
/// Opacities come back at least this far from 0 and 1.
const OPACITY_MARGIN: f32 = 1e-3;

/// How coarse a stream is: fractions that do not depend on the capture's units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Precision {
    /// Steps of a position per largest standard deviation of its Gaussian.
    pub position: f64,
    /// Steps of a scale per factor of two.
    pub scales_per_octave: i32,
    /// Largest magnitude of a quaternion's three smaller components.
    pub rotation: i32,
    /// Steps of the opacity from 0 to 1.
    pub opacity: i32,
    /// Step of the constant SH coefficient.
    pub colour: f64,
    /// Step of the other SH coefficients.
    pub harmonic: f64,
}

impl Precision {
    /// This many times as fine.
    #[must_use]
    pub fn times(&self, factor: f64) -> Self {
        let finer = |steps: i32, most: i32| ((f64::from(steps) * factor).round() as i32).clamp(1, most);
        Self {
            position: self.position * factor,
            scales_per_octave: finer(self.scales_per_octave, 64),
            rotation: finer(self.rotation, 512),
            opacity: finer(self.opacity, 4095).max(2),
            colour: self.colour / factor,
            harmonic: self.harmonic / factor,
        }
    }
}

/// Steps of a layer, as `manifest.json` holds them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Steps {
    /// Smallest step of a position (the capture's unit).
    pub position: f64,
    /// Largest scale, as an integer, up to which positions have the smallest step; it doubles with each further octave.
    pub level_zero: i32,
    /// Steps of a scale per factor of two.
    pub scales_per_octave: i32,
    /// Largest magnitude of a quaternion's three smaller components: sqrt(1/2) there.
    pub rotation: i32,
    /// Steps of the opacity from 0 to 1.
    pub opacity: i32,
    /// Step of the constant SH coefficient.
    pub colour: f64,
    /// Step of the other SH coefficients.
    pub harmonic: f64,
    /// SH degree, 0 to 3.
    pub sh_degree: usize,
    /// What the three numbers of each coefficient above degree 0 stand for.
    #[serde(default)]
    pub harmonic_channels: HarmonicChannels,
}

impl Steps {
    /// Steps that suit a layer: the finest position step serves the smallest twentieth of its Gaussians.
    pub fn of(layer: &Gaussians, precision: &Precision) -> Self {
        let widest = |s: &[f32; 3]| f64::from(s[0].max(s[1]).max(s[2]));
        let mut widths: Vec<f64> = layer.log_scales.iter().map(widest).collect();
        widths.sort_unstable_by(f64::total_cmp);
        let small = widths.get(widths.len() / 20).copied().unwrap_or(0.0);
        let far = layer.means.as_flattened().iter().fold(0.0_f64, |m, &v| m.max(f64::from(v).abs()));
        // Positions are integers of 31 bits with room for motion.
        let least = (far / f64::from(1 << 28)).max(f64::MIN_POSITIVE);
        let position = (small.exp() / precision.position).max(least).log2().floor().exp2();
        let octave = (position * precision.position).log2() * f64::from(precision.scales_per_octave);
        Self {
            position,
            level_zero: octave.floor() as i32,
            scales_per_octave: precision.scales_per_octave,
            rotation: precision.rotation,
            opacity: precision.opacity,
            colour: precision.colour,
            harmonic: precision.harmonic,
            sh_degree: layer.sh_degree(),
            harmonic_channels: HarmonicChannels::Opponent,
        }
    }

    /// Whether the steps make sense; a hostile manifest's do not.
    pub(crate) fn are_valid(&self) -> bool {
        let positive = [self.position, self.colour, self.harmonic].iter().all(|s| s.is_finite() && *s > 0.0);
        positive
            && (1..=64).contains(&self.scales_per_octave)
            && (1..=512).contains(&self.rotation)
            && (2..=4095).contains(&self.opacity)
            && self.sh_degree <= 3
    }

    /// Number of SH values above degree 0.
    pub(crate) fn harmonics(&self) -> usize {
        3 * (ffgs_core::sh_coefficients(self.sh_degree) - 1)
    }

    /// What their channels are, and their number.
    pub(crate) fn coded_harmonics(&self) -> (HarmonicChannels, usize) {
        (self.harmonic_channels, self.harmonics())
    }

    /// Positions of a Gaussian with these scales are multiples of two to this power.
    pub(crate) fn level(&self, scales: [i32; 3]) -> u32 {
        let widest = scales[0].max(scales[1]).max(scales[2]);
        let octaves = widest.saturating_sub(self.level_zero).div_euclid(self.scales_per_octave);
        octaves.clamp(0, MAX_LEVEL) as u32
    }

    /// Bits of an opacity.
    pub(crate) fn opacity_bits(&self) -> u32 {
        self.opacity.max(1).ilog2() + 1
    }

    /// Bits of a rotation's component, counted from its smallest value.
    pub(crate) fn rotation_bits(&self) -> u32 {
        (2 * self.rotation).max(1).ilog2() + 1
    }

    /// Log scales per step.
    fn scale_step(&self) -> f64 {
        std::f64::consts::LN_2 / f64::from(self.scales_per_octave)
    }

    /// Scales, opacity, colour and harmonics of Gaussian `i` in steps, not rounded.
    pub(crate) fn measures(&self, g: &Gaussians, i: usize) -> Measures {
        let sh = g.sh_of(i);
        let mut harmonics = [0.0; MAX_HARMONICS];
        for (out, rgb) in harmonics.as_chunks_mut::<3>().0.iter_mut().zip(&sh[1..]) {
            *out = self.harmonic_channels.of_rgb(rgb.map(|v| f64::from(v) / self.harmonic));
        }
        Measures {
            position: g.means[i].map(|v| f64::from(v) / self.position),
            quat: unit(g.quats[i].map(f64::from)),
            scales: g.log_scales[i].map(|v| f64::from(v) / self.scale_step()),
            opacity: f64::from(sigmoid(g.opacity_logits[i])) * f64::from(self.opacity),
            colour: sh[0].map(|v| f64::from(v) / self.colour),
            harmonics,
            price: PRICE,
        }
    }

    /// The Gaussian of a row, appended to `out`.
    pub(crate) fn push(&self, row: &Row, out: &mut Gaussians) {
        out.means.push(row.position.map(|v| (f64::from(v) * self.position) as f32));
        out.quats.push(self.quat(row).map(|v| v as f32));
        out.log_scales.push(row.scales.map(|v| (f64::from(v) * self.scale_step()) as f32));
        let opacity = f64::from(row.opacity) / f64::from(self.opacity);
        out.opacity_logits.push(logit((opacity as f32).clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN)));
        out.sh.push(row.colour.map(|v| (f64::from(v) * self.colour) as f32));
        let rest = &row.harmonics[..self.harmonics()];
        let rgb = |of: &[i16; 3]| {
            self.harmonic_channels.to_rgb(of.map(|v| f64::from(v) * self.harmonic)).map(|v| v as f32)
        };
        out.sh.extend(rest.as_chunks::<3>().0.iter().map(rgb));
    }

    /// Quaternion (w, x, y, z) of a row, of unit length up to rounding.
    pub(crate) fn quat(&self, row: &Row) -> [f64; 4] {
        let unit = std::f64::consts::FRAC_1_SQRT_2 / f64::from(self.rotation);
        let rest = row.rotation.map(|v| f64::from(v) * unit);
        let squares = rest[0] * rest[0] + rest[1] * rest[1] + rest[2] * rest[2];
        let mut out = [0.0; 4];
        out[usize::from(row.largest)] = (1.0 - squares).max(0.0).sqrt();
        let others = (0..4).filter(|&k| k != usize::from(row.largest));
        others.zip(rest).for_each(|(k, v)| out[k] = v);
        out
    }

    /// The three components of a quaternion besides `largest`, in steps, not rounded; the largest is made positive.
    pub(crate) fn rotation_measures(&self, quat: [f64; 4], largest: u8) -> [f64; 3] {
        let sign = if quat[usize::from(largest)] < 0.0 { -1.0 } else { 1.0 };
        let scale = sign * f64::from(self.rotation) * std::f64::consts::SQRT_2;
        let mut others = (0..4).filter(|&k| k != usize::from(largest));
        [(); 3].map(|()| others.next().map_or(0.0, |k| quat[k] * scale))
    }
}

/// A Gaussian in steps, not rounded.
#[derive(Clone, Copy)]
pub(crate) struct Measures {
    pub(crate) position: [f64; 3],
    /// Unit quaternion (w, x, y, z).
    pub(crate) quat: [f64; 4],
    pub(crate) scales: [f64; 3],
    pub(crate) opacity: f64,
    pub(crate) colour: [f64; 3],
    /// In the channels of the steps.
    pub(crate) harmonics: [f64; MAX_HARMONICS],
    /// What a bit must gain in it (squared steps).
    pub(crate) price: f64,
}

/// The quaternion at unit length; the identity for one of length 0.
pub(crate) fn unit(q: [f64; 4]) -> [f64; 4] {
    let length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    if length > 0.0 { q.map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Index of the component with the largest magnitude, the first of equal ones.
pub(crate) fn largest(q: [f64; 4]) -> u8 {
    (1..4).fold(0, |best, k| if q[k].abs() > q[usize::from(best)].abs() { k as u8 } else { best })
}

/// The nearest integer, halves upwards: what `Math.floor(x + 0.5)` gives.
pub(crate) fn round(x: f64) -> i32 {
    (x + 0.5).floor() as i32
}

impl Row {
    /// Rounds a Gaussian.
    pub(crate) fn rounded(m: &Measures, steps: &Steps, group: u8) -> Self {
        let m = m.canonical();
        let scales = m.scales.map(round);
        let level = steps.level(scales);
        let unit = f64::from(1_u32 << level);
        let largest = largest(m.quat);
        Self {
            position: m.position.map(|v| round(v / unit) << level),
            largest,
            rotation: steps.rotation_measures(m.quat, largest).map(round),
            scales,
            opacity: round(m.opacity).clamp(0, steps.opacity),
            colour: m.colour.map(round),
            harmonics: choose(&m.harmonics, steps.harmonics(), m.price),
            group,
        }
    }
}
