//! One linear least-squares problem per frame (docs/adr/0007): with geometry and opacity frozen, pixel =
//! sum of weight * (basis . SH), so the best colours are found by preconditioned conjugate gradients over all views
//! at once instead of hundreds of steps of one view each.
//!
//! What is minimised over the change x of the coefficients, with r the photograph minus the exact render, is
//! `|A x - r|^2 / noise^2` over the pixels outside the masks, plus `x^2 / variance` over the coefficients, with what the
//! frames so far leave open of each Gaussian's colour ([`ColourVariance`]): that keeps colours which few pixels of this
//! frame see where many pixels of earlier ones put them.
//!
//! What the masks hide in part is seen beside a moving thing: in its shadow, at an edge of the mask. What is found for
//! such Gaussians is returned as passing, for this frame alone (docs/adr/0069).

use super::compare::compare;
use super::trace::ViewTrace;
use crate::background::BackgroundConfig;
use crate::view::{Progress, Running};
use ffgs_core::{Gaussians, SkyCube, TrainingView, sh_coefficients};
use ffgs_rasterizer::sh_basis;
use glam::Vec3;
use rayon::prelude::*;

pub(super) fn solve(
    config: &BackgroundConfig,
    traces: &[ViewTrace],
    views: &[TrainingView],
    sky: &SkyCube,
    layer: &mut Gaussians,
    known: &mut Vec<ColourVariance>,
    report: &mut dyn FnMut(Progress),
) -> Vec<u32> {
    let seen = compare(config, traces, views, sky, layer);
    predict(config, layer.len(), known);
    let system = System::new(config, traces, &seen.counted, layer, known);
    let mut running = Running::default();
    let values = seen.counted.par_iter().flatten().filter(|c| **c).count().max(1) as f64 * 3.0;
    let told = system.squares(|v, pixel| system.counted[v][pixel]);
    let diagonal = system.diagonal(&told);
    let (right, squares) = (system.gather(&seen.back), seen.squares);
    drop(seen.back);
    let mut change = system.conjugate_gradients(
        &diagonal,
        right,
        squares,
        config.solve_iterations,
        |iteration, squares| {
            running.add(squares / values, squares / values);
            report(running.progress(iteration, config.solve_iterations, layer.len()));
        },
    );
    let partly_hidden = system.partly_hidden(config.solve_in_view, &told);
    system.learn(config, &diagonal, &partly_hidden, known);
    system.limit(layer, &mut change);
    let (stride, coefficients) = (layer.sh_stride(), system.coefficients);
    let rows = layer.sh.par_chunks_exact_mut(stride).zip(change.par_chunks_exact(coefficients));
    rows.for_each(|(sh, x)| {
        sh.iter_mut().zip(x).for_each(|(s, &d)| *s = (Vec3::from(*s) + d).to_array());
    });
    (0..).zip(partly_hidden).filter(|(_, hidden)| *hidden).map(|(i, _)| i).collect()
}

/// Variance of SH coefficient 0 of a static Gaussian, and of each of its other coefficients.
pub type ColourVariance = [f32; 2];

/// Brightest value of a channel, of 0 to 1, to which a change leads in a view: somewhat more than photographs have, as Gaussians are never quite
/// opaque.
const BRIGHTEST: f32 = 1.1;

/// What a frame's pixels tell counts for so much: neighbours that overlap share it.
const EVIDENCE: f32 = 0.1;

/// A frame later: nothing is known at first, and what is known fades.
fn predict(config: &BackgroundConfig, gaussians: usize, known: &mut Vec<ColourVariance>) {
    let square = |[a, b]: [f32; 2]| [a * a, b * b];
    let unknown = square([config.solve_sh0_change, config.solve_sh_rest_change]);
    let drift = square([config.solve_sh0_drift, config.solve_sh_rest_drift]);
    if known.len() != gaussians {
        *known = vec![unknown; gaussians];
        return;
    }
    for variance in known {
        *variance = std::array::from_fn(|k| (variance[k] + drift[k]).min(unknown[k]));
    }
}

/// The normal equations, never formed: `(A^T A + ridge) x = A^T r`. Vectors are (N, coefficients) of RGB.
struct System<'a> {
    traces: &'a [ViewTrace],
    /// (views, pixels) those outside the masks.
    counted: &'a [Vec<bool>],
    gaussians: usize,
    coefficients: usize,
    /// Where each view's seen Gaussians start in columns over (view, seen).
    offsets: Vec<usize>,
    /// (N + 1), and for each Gaussian the places in these columns.
    places: (Vec<u32>, Vec<u32>),
    /// Derivative of the clamp of colours, over (view, seen): 0 where clamped, else 1.
    clamp_slopes: Vec<Vec3>,
    /// (N) noise over variance, of coefficient 0 and of the others.
    ridge: Vec<[f32; 2]>,
}

impl<'a> System<'a> {
    fn new(
        config: &BackgroundConfig,
        traces: &'a [ViewTrace],
        counted: &'a [Vec<bool>],
        layer: &Gaussians,
        known: &[ColourVariance],
    ) -> Self {
        let coefficients = sh_coefficients(config.solve_degree.min(layer.sh_degree()));
        let mut offsets = vec![0];
        traces.iter().for_each(|t| offsets.push(offsets[offsets.len() - 1] + t.seen.len()));
        let ridge = known.iter().map(|v| v.map(|v| config.solve_noise.powi(2) / v)).collect();
        let places = invert(traces, layer.len());
        let clamp_slopes = traces.par_iter().flat_map_iter(|t| clamp_slopes(t, layer)).collect();
        Self { traces, counted, gaussians: layer.len(), coefficients, offsets, places, clamp_slopes, ridge }
    }

    /// Runs `visit(view, pixel, colour sums)` over all pixels to get what is sent back, and returns `A^T` of it.
    fn transpose(&self, colours: &[Vec3], send: impl Fn(usize, usize, Vec3) -> Vec3 + Sync) -> Vec<Vec3> {
        let mut back = vec![Vec3::ZERO; *self.offsets.last().unwrap_or(&0)];
        let mut parts = Vec::with_capacity(self.traces.len());
        let mut rest = back.as_mut_slice();
        for trace in self.traces {
            let (part, others) = rest.split_at_mut(trace.seen.len());
            parts.push(part);
            rest = others;
        }
        parts.into_par_iter().enumerate().for_each(|(v, part)| {
            let trace = &self.traces[v];
            let colours = &colours[self.offsets[v]..self.offsets[v + 1]];
            for pixel in 0..trace.pixels() {
                let contributions = trace.of(pixel);
                let sum =
                    contributions.iter().fold(Vec3::ZERO, |sum, &(at, w)| sum + w * colours[at as usize]);
                let sent = send(v, pixel, sum);
                if sent != Vec3::ZERO {
                    contributions.iter().for_each(|&(at, w)| part[at as usize] += w * sent);
                }
            }
        });
        self.gather(&back)
    }

    /// Sums over the views that see a Gaussian: basis times what came back.
    fn gather(&self, back: &[Vec3]) -> Vec<Vec3> {
        let k = self.coefficients;
        let mut out = vec![Vec3::ZERO; self.gaussians * k];
        out.par_chunks_exact_mut(k).enumerate().for_each(|(i, out)| {
            for &place in self.places_of(i) {
                let sent = back[place as usize] * self.clamp_slopes[place as usize];
                out.iter_mut().zip(&self.basis(place as usize)).for_each(|(o, &b)| *o += b * sent);
            }
        });
        out
    }

    fn places_of(&self, i: usize) -> &[u32] {
        &self.places.1[self.places.0[i] as usize..self.places.0[i + 1] as usize]
    }

    fn basis(&self, place: usize) -> [f32; 16] {
        let view = self.offsets.partition_point(|&o| o <= place) - 1;
        self.traces[view].basis(place - self.offsets[view])
    }

    /// Colours over (view, seen) of coefficients `x`.
    fn colours(&self, x: &[Vec3]) -> Vec<Vec3> {
        let k = self.coefficients;
        let of_view = |(v, trace): (usize, &ViewTrace)| {
            let start = self.offsets[v];
            let colour = move |(at, &i): (usize, &u32)| {
                let x = &x[i as usize * k..(i as usize + 1) * k];
                let sum = x.iter().zip(&trace.basis(at)).fold(Vec3::ZERO, |sum, (&x, &b)| sum + b * x);
                sum * self.clamp_slopes[start + at]
            };
            trace.seen.iter().enumerate().map(colour).collect::<Vec<_>>()
        };
        self.traces.par_iter().enumerate().map(of_view).collect::<Vec<_>>().concat()
    }

    /// `(A^T A + ridge) x`.
    fn apply(&self, x: &[Vec3]) -> Vec<Vec3> {
        let counted = |v: usize, pixel: usize, sum: Vec3| {
            if self.counted[v][pixel] { sum } else { Vec3::ZERO }
        };
        let mut out = self.transpose(&self.colours(x), counted);
        let rows = out.par_chunks_exact_mut(self.coefficients).zip(x.par_chunks_exact(self.coefficients));
        rows.zip(&self.ridge).for_each(|((out, x), ridge)| {
            (0..self.coefficients).for_each(|c| out[c] += ridge[c.min(1)] * x[c]);
        });
        out
    }

    /// Shortens what would make a channel of a Gaussian brighter than [`BRIGHTEST`] in a view that sees it. What hardly shows, behind others, is
    /// told by few pixels to answer for their errors, by a little more in each frame; uncovered after a hundred frames, it glows.
    fn limit(&self, layer: &Gaussians, change: &mut [Vec3]) {
        change.par_chunks_exact_mut(self.coefficients).enumerate().for_each(|(i, change)| {
            let mut shares = Vec3::ONE;
            for &place in self.places_of(i) {
                let basis = self.basis(place as usize);
                let now = colour(&basis, layer.sh_of(i).iter().map(|&c| Vec3::from(c))) + 0.5;
                let step = colour(&basis, change.iter().copied());
                let beyond = step.cmpgt(Vec3::ZERO) & (now + step).cmpgt(Vec3::splat(BRIGHTEST));
                let share = ((BRIGHTEST - now) / step).max(Vec3::ZERO);
                shares = Vec3::select(beyond, shares.min(share), shares);
            }
            change.iter_mut().for_each(|c| *c *= shares);
        });
    }

    /// (N) whether less than a share of what a Gaussian colours is outside the masks, by the squared weights there (`told`).
    fn partly_hidden(&self, share: f32, told: &[f32]) -> Vec<bool> {
        let all = self.squares(|_, _| true);
        let sum =
            |squares: &[f32], i: usize| self.places_of(i).iter().map(|&p| squares[p as usize]).sum::<f32>();
        (0..self.gaussians).into_par_iter().map(|i| sum(told, i) < share * sum(&all, i)).collect()
    }

    /// What this frame's pixels tell of the colours; of those that are hidden in part, nothing that is to last.
    fn learn(
        &self,
        config: &BackgroundConfig,
        diagonal: &[Vec3],
        partly_hidden: &[bool],
        known: &mut [ColourVariance],
    ) {
        let told = EVIDENCE / config.solve_noise.powi(2);
        let others = (self.coefficients - 1).max(1) as f32;
        let rows = diagonal.chunks_exact(self.coefficients).zip(&self.ridge);
        let in_view = known.iter_mut().zip(rows).zip(partly_hidden).filter(|(_, hidden)| !**hidden);
        for ((variance, (row, ridge)), _) in in_view {
            let seen = |c: &Vec3, ridge: f32| (c.element_sum() / 3.0 - ridge).max(0.0);
            let rest = row[1..].iter().map(|c| seen(c, ridge[1])).sum::<f32>() / others;
            let information = [seen(&row[0], ridge[0]), rest].map(|i| i * told);
            *variance = std::array::from_fn(|k| 1.0 / (1.0 / variance[k] + information[k]));
        }
    }

    /// Over (view, seen): sum of the squared weights over the pixels for which `counts(view, pixel)`.
    fn squares(&self, counts: impl Fn(usize, usize) -> bool + Sync) -> Vec<f32> {
        let of_view = |(v, trace): (usize, &ViewTrace)| {
            let mut part = vec![0.0; trace.seen.len()];
            for pixel in (0..trace.pixels()).filter(|&p| counts(v, p)) {
                trace.of(pixel).iter().for_each(|&(at, w)| part[at as usize] += w * w);
            }
            part
        };
        self.traces.par_iter().enumerate().map(of_view).collect::<Vec<_>>().concat()
    }

    /// Diagonal of the normal equations, the preconditioner, given the squared weights of the pixels that count.
    fn diagonal(&self, squares: &[f32]) -> Vec<Vec3> {
        let k = self.coefficients;
        let mut out = vec![Vec3::ZERO; self.gaussians * k];
        out.par_chunks_exact_mut(k).enumerate().for_each(|(i, out)| {
            out.iter_mut().enumerate().for_each(|(c, o)| *o = Vec3::splat(self.ridge[i][c.min(1)]));
            for &place in self.places_of(i) {
                let s = squares[place as usize] * self.clamp_slopes[place as usize];
                out.iter_mut().zip(&self.basis(place as usize)).for_each(|(o, &b)| *o += b * b * s);
            }
        });
        out
    }

    /// Preconditioned conjugate gradients from zero (Hestenes and Stiefel 1952). `report(iteration, sum of squared
    /// residuals by the model)`.
    fn conjugate_gradients(
        &self,
        diagonal: &[Vec3],
        right: Vec<Vec3>,
        mut squares: f64,
        iterations: usize,
        mut report: impl FnMut(usize, f64),
    ) -> Vec<Vec3> {
        let mut x = vec![Vec3::ZERO; right.len()];
        let mut r = right;
        let mut direction: Vec<Vec3> = r.par_iter().zip(diagonal).map(|(&r, &d)| r / d).collect();
        let mut rz = dot(&r, &direction);
        for iteration in 1..=iterations {
            let applied = self.apply(&direction);
            let curvature = dot(&direction, &applied);
            if !(rz > 0.0 && curvature > 0.0) {
                break;
            }
            let step = (rz / curvature) as f32;
            x.par_iter_mut().zip(&direction).for_each(|(x, &d)| *x += step * d);
            r.par_iter_mut().zip(&applied).for_each(|(r, &a)| *r -= step * a);
            squares -= rz * f64::from(step);
            // The preconditioned residual is never stored; here it takes the place of the old product.
            let mut z = applied;
            z.par_iter_mut().zip(&r).zip(diagonal).for_each(|((z, &r), &d)| *z = r / d);
            let next = dot(&r, &z);
            let beta = (next / rz) as f32;
            rz = next;
            direction.par_iter_mut().zip(&z).for_each(|(d, &z)| *d = z + beta * *d);
            report(iteration, squares);
        }
        x
    }
}

/// Colour of SH coefficients, less a half.
fn colour(basis: &[f32; 16], coefficients: impl Iterator<Item = Vec3>) -> Vec3 {
    coefficients.zip(basis).fold(Vec3::ZERO, |sum, (c, &b)| sum + b * c)
}

/// Sum in f64 over fixed blocks, so that the threads do not matter.
fn dot(a: &[Vec3], b: &[Vec3]) -> f64 {
    const BLOCK: usize = 4096;
    let block = |(a, b): (&[Vec3], &[Vec3])| a.iter().zip(b).map(|(a, b)| f64::from(a.dot(*b))).sum::<f64>();
    a.par_chunks(BLOCK).zip(b.par_chunks(BLOCK)).map(block).collect::<Vec<_>>().iter().sum()
}

/// For each Gaussian its places in the columns over (view, seen), by counting sort.
fn invert(traces: &[ViewTrace], n: usize) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0_u32; n + 1];
    traces.iter().flat_map(|t| &t.seen).for_each(|&i| starts[i as usize + 1] += 1);
    (0..n).for_each(|i| starts[i + 1] += starts[i]);
    let mut next = starts.clone();
    let mut places = vec![0; starts[n] as usize];
    for (place, &i) in traces.iter().flat_map(|t| &t.seen).enumerate() {
        places[next[i as usize] as usize] = place as u32;
        next[i as usize] += 1;
    }
    (starts, places)
}

/// Per channel of each seen Gaussian: 0 where its present colour lies below the clamp at 0, else 1.
fn clamp_slopes(trace: &ViewTrace, layer: &Gaussians) -> Vec<Vec3> {
    let center = trace.camera.center().as_vec3();
    let of = |&i: &u32| {
        let i = i as usize;
        let basis = sh_basis(layer.sh_degree(), (Vec3::from(layer.means[i]) - center).normalize_or_zero());
        let colour =
            layer.sh_of(i).iter().zip(basis).fold(Vec3::splat(0.5), |c, (&s, b)| c + b * Vec3::from(s));
        Vec3::select(colour.cmpge(Vec3::ZERO), Vec3::ONE, Vec3::ZERO)
    };
    trace.seen.iter().map(of).collect()
}

#[cfg(test)]
mod tests;
