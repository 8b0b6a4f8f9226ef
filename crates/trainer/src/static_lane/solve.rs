//! One linear least-squares problem a frame (docs/adr/0007): with geometry and opacity frozen, pixel =
//! sum of weight * (basis . SH), so the best colours are found by preconditioned conjugate gradients over all views
//! at once instead of hundreds of steps of one view each.
//!
//! Minimised over the change x of the coefficients: sum over pixels outside the masks of (A x - r)^2 / noise^2
//! + sum of (x / expected change)^2, with r the photograph minus the exact render. The second term keeps colours
//! that few pixels see where they are.

use super::trace::ViewTrace;
use crate::SkyCube;
use crate::background::{BackgroundConfig, outside, render_sky};
use crate::view::{Progress, Running, TrainingView};
use ffgs_core::{Gaussians, PlanarImage, sh_coefficients};
use ffgs_rasterizer::{Background, CpuRasterizer, Rasterizer, RenderOptions, RenderTape, View, sh_basis};
use glam::Vec3;
use rayon::prelude::*;

pub(super) fn solve(
    config: &BackgroundConfig,
    traces: &[ViewTrace],
    views: &[TrainingView],
    sky: &SkyCube,
    layer: &mut Gaussians,
    report: &mut dyn FnMut(Progress),
) {
    let residuals: Vec<Vec<Vec3>> =
        views.iter().map(|v| residual(v, layer, sky, config.mask_dilation)).collect();
    let system = System::new(config, traces, &residuals, layer);
    let mut running = Running::default();
    let counted = residuals.iter().flatten().filter(|r| **r != Vec3::ZERO).count().max(1) as f64 * 3.0;
    let change = system.conjugate_gradients(config.solve_iterations, |iteration, squares| {
        running.add(squares / counted, squares / counted);
        report(running.progress(iteration, config.solve_iterations, layer.len()));
    });
    let (stride, coefficients) = (layer.sh_stride(), system.coefficients);
    for (sh, x) in layer.sh.chunks_exact_mut(stride).zip(change.chunks_exact(coefficients)) {
        sh.iter_mut().zip(x).for_each(|(s, &d)| *s = (Vec3::from(*s) + d).to_array());
    }
}

/// Photograph minus render per pixel; zero at and around the foreground.
fn residual(view: &TrainingView, layer: &Gaussians, sky: &SkyCube, dilation: usize) -> Vec<Vec3> {
    let background = render_sky(sky, view);
    let mut tape = RenderTape::default();
    let frame = View { camera: &view.camera, background: Background::Image(&background), tiles: None };
    CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None }).render(layer, &frame, &mut tape);
    let (photo, region) = (PlanarImage::from(&view.image), outside(view, dilation));
    let difference = |p: usize| Vec3::from(photo.pixel(p)) - Vec3::from(tape.image().pixel(p));
    let counted = |p: usize| if region.data()[p] == 0 { Vec3::ZERO } else { difference(p) };
    (0..photo.size().pixels()).map(counted).collect()
}

/// The normal equations, never formed: `(A^T A + ridge) x = A^T r`. Vectors are (N, coefficients) of RGB.
struct System<'a> {
    traces: &'a [ViewTrace],
    residuals: &'a [Vec<Vec3>],
    gaussians: usize,
    coefficients: usize,
    /// Where each view's seen Gaussians start in columns over (view, seen).
    offsets: Vec<usize>,
    /// (N + 1), and for each Gaussian the places in these columns.
    places: (Vec<u32>, Vec<u32>),
    /// Colours at the clamp do not answer to small changes: 0 there, else 1, over (view, seen).
    answers: Vec<Vec3>,
    ridge: Vec<f32>,
}

impl<'a> System<'a> {
    fn new(
        config: &BackgroundConfig,
        traces: &'a [ViewTrace],
        residuals: &'a [Vec<Vec3>],
        layer: &Gaussians,
    ) -> Self {
        let coefficients = sh_coefficients(config.solve_degree.min(layer.sh_degree()));
        let mut offsets = vec![0];
        traces.iter().for_each(|t| offsets.push(offsets[offsets.len() - 1] + t.seen.len()));
        let share = |change: f32| (config.solve_noise / change).powi(2);
        let mut ridge = vec![share(config.solve_sh_rest_change); coefficients];
        ridge[0] = share(config.solve_sh0_change);
        let places = invert(traces, layer.len());
        let answers = traces.iter().flat_map(|t| answers(t, layer)).collect();
        Self { traces, residuals, gaussians: layer.len(), coefficients, offsets, places, answers, ridge }
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
                let sent = back[place as usize] * self.answers[place as usize];
                out.iter_mut().zip(self.basis(place as usize)).for_each(|(o, &b)| *o += b * sent);
            }
        });
        out
    }

    fn places_of(&self, i: usize) -> &[u32] {
        &self.places.1[self.places.0[i] as usize..self.places.0[i + 1] as usize]
    }

    fn basis(&self, place: usize) -> &[f32] {
        let view = self.offsets.partition_point(|&o| o <= place) - 1;
        let at = place - self.offsets[view];
        &self.traces[view].basis[at * self.coefficients..(at + 1) * self.coefficients]
    }

    /// Colours over (view, seen) of coefficients `x`.
    fn colours(&self, x: &[Vec3]) -> Vec<Vec3> {
        let k = self.coefficients;
        let of_view = |(v, trace): (usize, &ViewTrace)| {
            let start = self.offsets[v];
            let colour = move |(at, &i): (usize, &u32)| {
                let x = &x[i as usize * k..(i as usize + 1) * k];
                let basis = &trace.basis[at * k..(at + 1) * k];
                let sum = x.iter().zip(basis).fold(Vec3::ZERO, |sum, (&x, &b)| sum + b * x);
                sum * self.answers[start + at]
            };
            trace.seen.iter().enumerate().map(colour).collect::<Vec<_>>()
        };
        self.traces.par_iter().enumerate().map(of_view).collect::<Vec<_>>().concat()
    }

    /// `(A^T A + ridge) x`.
    fn apply(&self, x: &[Vec3]) -> Vec<Vec3> {
        let counted = |v: usize, pixel: usize, sum: Vec3| {
            if self.residuals[v][pixel] == Vec3::ZERO { Vec3::ZERO } else { sum }
        };
        let mut out = self.transpose(&self.colours(x), counted);
        for (out, x) in out.chunks_exact_mut(self.coefficients).zip(x.chunks_exact(self.coefficients)) {
            (0..self.coefficients).for_each(|c| out[c] += self.ridge[c] * x[c]);
        }
        out
    }

    /// Diagonal of the normal equations, the preconditioner.
    fn diagonal(&self) -> Vec<Vec3> {
        let k = self.coefficients;
        let mut squares: Vec<f32> = Vec::with_capacity(self.answers.len());
        for (v, trace) in self.traces.iter().enumerate() {
            let mut part = vec![0.0; trace.seen.len()];
            for pixel in (0..trace.pixels()).filter(|&p| self.residuals[v][p] != Vec3::ZERO) {
                trace.of(pixel).iter().for_each(|&(at, w)| part[at as usize] += w * w);
            }
            squares.extend(part);
        }
        let mut out = vec![Vec3::ZERO; self.gaussians * k];
        out.par_chunks_exact_mut(k).enumerate().for_each(|(i, out)| {
            out.iter_mut().zip(&self.ridge).for_each(|(o, &ridge)| *o = Vec3::splat(ridge));
            for &place in self.places_of(i) {
                let s = squares[place as usize] * self.answers[place as usize];
                out.iter_mut().zip(self.basis(place as usize)).for_each(|(o, &b)| *o += b * b * s);
            }
        });
        out
    }

    /// Preconditioned conjugate gradients from zero (Hestenes and Stiefel 1952). `report(iteration, sum of squared
    /// residuals by the model)`.
    fn conjugate_gradients(&self, iterations: usize, mut report: impl FnMut(usize, f64)) -> Vec<Vec3> {
        let zero = vec![Vec3::ZERO; self.answers.len()];
        let right = self.transpose(&zero, |v, pixel, _| self.residuals[v][pixel]);
        let diagonal = self.diagonal();
        let precondition =
            |r: &[Vec3]| r.par_iter().zip(&diagonal).map(|(&r, &d)| r / d).collect::<Vec<_>>();
        let mut squares: f64 =
            self.residuals.iter().map(|v| v.iter().map(|r| f64::from(r.length_squared())).sum::<f64>()).sum();
        let mut x = vec![Vec3::ZERO; right.len()];
        let mut r = right;
        let mut z = precondition(&r);
        let mut direction = z.clone();
        let mut rz = dot(&r, &z);
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
            z = precondition(&r);
            let next = dot(&r, &z);
            let beta = (next / rz) as f32;
            rz = next;
            direction.par_iter_mut().zip(&z).for_each(|(d, &z)| *d = z + beta * *d);
            report(iteration, squares);
        }
        x
    }
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
fn answers(trace: &ViewTrace, layer: &Gaussians) -> Vec<Vec3> {
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
