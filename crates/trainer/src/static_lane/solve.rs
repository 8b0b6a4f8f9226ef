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
    let change = system.conjugate_gradients(
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
    let (stride, coefficients) = (layer.sh_stride(), system.coefficients);
    let rows = layer.sh.par_chunks_exact_mut(stride).zip(change.par_chunks_exact(coefficients));
    rows.for_each(|(sh, x)| {
        sh.iter_mut().zip(x).for_each(|(s, &d)| *s = (Vec3::from(*s) + d).to_array());
    });
    (0..).zip(partly_hidden).filter(|(_, hidden)| *hidden).map(|(i, _)| i).collect()
}

/// Variance of SH coefficient 0 of a static Gaussian, and of each of its other coefficients.
pub type ColourVariance = [f32; 2];

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
mod tests {
    use super::super::compare::residual;
    use super::super::trace::Tracer;
    use super::*;
    use crate::background::{SkyBehind, outside};
    use crate::static_lane::Tracing;
    use crate::{CpuBackend, StaticColours, StaticLane, StaticTargets, from_points};
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};
    use ffgs_rasterizer::RenderTape;
    use std::sync::Arc;

    fn residual_of(view: &TrainingView, layer: &Gaussians, sky: &SkyCube) -> Vec<Vec3> {
        let counted = outside(view, 0).data().iter().map(|&counts| counts != 0).collect();
        residual(view, layer, SkyBehind::new().render(sky, &view.camera), counted, &mut RenderTape::default())
            .values
    }

    const SIZE: ImageSize = ImageSize { width: 48, height: 32 };

    /// A wall of discs before three cameras, photographed in its own colours.
    fn wall() -> (Gaussians, SkyCube, Vec<TrainingView>) {
        let points: Vec<[f32; 3]> =
            (0..600).map(|i| [(i % 30) as f32 * 0.1 - 1.45, (i / 30) as f32 * 0.1 - 0.95, 4.0]).collect();
        let colour = |i: usize| [0.3 + 0.4 * ((i * 7 % 11) as f32 / 11.0), 0.5, 0.2 + 0.05 * (i % 9) as f32];
        let colours: Vec<_> = (0..points.len()).map(colour).collect();
        let layer = from_points(&points, &colours, 1, 0.9);
        let sky = SkyCube::filled(8, [0.2, 0.4, 0.6]);
        let intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 24.0, cy: 16.0 };
        let view = |x: f64| {
            let pose = glam::DMat4::from_translation(glam::DVec3::new(x, 0.0, 0.0));
            let camera = Camera::new(intrinsics, pose, SIZE).unwrap();
            let mask = Mask::filled(SIZE, false);
            let blank = ImageRgb8::new(SIZE, vec![0; SIZE.pixels() * 3]).unwrap();
            let mut view = TrainingView { camera, image: blank, mask };
            view.image = photograph(&view, &layer, &sky);
            view
        };
        let views = [-0.5, 0.0, 0.6].map(view).to_vec();
        (layer, sky, views)
    }

    fn photograph(view: &TrainingView, layer: &Gaussians, sky: &SkyCube) -> ImageRgb8 {
        // Black photograph: the residual is minus the render.
        let shown = residual_of(view, layer, sky);
        let bytes = shown.iter().flat_map(|r| (*r * -255.0).to_array().map(|v| v.round() as u8)).collect();
        ImageRgb8::new(SIZE, bytes).unwrap()
    }

    fn squared_error(views: &[TrainingView], layer: &Gaussians, sky: &SkyCube) -> f32 {
        let of =
            |v: &TrainingView| residual_of(v, layer, sky).iter().map(|r| r.length_squared()).sum::<f32>();
        views.iter().map(of).sum()
    }

    fn solved(views: &[TrainingView], layer: &Gaussians, sky: &SkyCube) -> Gaussians {
        let mut out = Arc::new(layer.clone());
        let config =
            BackgroundConfig { solve_iterations: 40, solve_noise: 0.005, ..BackgroundConfig::default() };
        let targets = StaticTargets { views, sky };
        let lane = &mut StaticLane::default();
        let mut known = Vec::new();
        lane.train(
            &CpuBackend,
            &config,
            targets,
            StaticColours { layer: &mut out, variances: &mut known, passing: &mut Vec::new() },
            1,
            &mut |_| {},
        )
        .unwrap();
        Arc::unwrap_or_clone(out)
    }

    #[test]
    fn a_change_of_light_is_found_and_geometry_stays() {
        let (layer, sky, views) = wall();
        let mut dimmed = layer.clone();
        dimmed.sh.iter_mut().for_each(|c| *c = c.map(|v| v * 0.6 - 0.1));
        let before = squared_error(&views, &dimmed, &sky);
        let found = solved(&views, &dimmed, &sky);
        let after = squared_error(&views, &found, &sky);
        assert!(after < 5e-3 * before, "{before} to {after}");
        assert_eq!(
            (&found.means, &found.log_scales, &found.opacity_logits),
            (&dimmed.means, &dimmed.log_scales, &dimmed.opacity_logits)
        );
    }

    #[test]
    fn a_lattice_of_pixels_finds_nearly_the_same_light() {
        let (layer, sky, views) = wall();
        let mut dimmed = layer.clone();
        dimmed.sh.iter_mut().for_each(|c| *c = c.map(|v| v * 0.6 - 0.1));
        let error_with = |stride: usize| {
            let tracing = Tracing { contributors: 16, stride, degree: 1 };
            let traces: Vec<ViewTrace> = views
                .iter()
                .map(|v| ViewTrace::new(&v.camera, &dimmed, tracing, &mut Tracer::default()))
                .collect();
            let config = BackgroundConfig {
                solve_iterations: 40,
                solve_noise: 0.005 / stride as f32,
                ..BackgroundConfig::default()
            };
            let mut found = dimmed.clone();
            solve(&config, &traces, &views, &sky, &mut found, &mut Vec::new(), &mut |_| {});
            squared_error(&views, &found, &sky)
        };
        let before = squared_error(&views, &dimmed, &sky);
        let [every, lattice] = [1, 2].map(error_with);
        assert!(every < 5e-3 * before && lattice < 0.1 * before, "{before} to {every}, {lattice}");
    }

    #[test]
    fn views_of_any_size_are_solved_within_the_memory() {
        let config = BackgroundConfig::default();
        let hd = 1920 * 1080;
        let traced = |views: usize, pixels: usize| {
            config.tracing(views * pixels, usize::MAX).map(|t| (t.stride, t.contributors))
        };
        assert_eq!(traced(24, 320 * 180), Some((1, 16)));
        assert_eq!(traced(60, hd), Some((1, 4)));
        assert_eq!(traced(70, hd), Some((2, 14)));
        assert_eq!(traced(20, 4 * hd), Some((2, 12)));
        for pixels in [60 * hd, 70 * hd, 60 * 4 * hd, 300 * 4 * hd] {
            let bytes = config.contributor_bytes(pixels);
            assert!((1 << 30..=4 << 30).contains(&bytes), "{pixels}: {bytes}");
        }
        assert!(BackgroundConfig { solve_memory_mib: 0, ..config }.tracing(hd, 1).is_none());
    }

    #[test]
    fn more_pixels_than_the_gaussians_need_are_left_out() {
        let config = BackgroundConfig { solve_pixels: 30, ..BackgroundConfig::default() };
        let stride = |pixels: usize| config.tracing(pixels, 1000).map(|t| (t.stride, t.contributors));
        assert_eq!(stride(30_000), Some((1, 16)));
        assert_eq!(stride(119_999), Some((1, 16)));
        assert_eq!(stride(120_000), Some((2, 16)));
        assert_eq!(stride(270_000), Some((3, 16)));
        assert_eq!(stride(1 << 30), Some((8, 16)), "the largest stride");
        let all = BackgroundConfig { solve_pixels: 0, ..config };
        assert_eq!(all.tracing(270_000, 1000).map(|t| t.stride), Some(1));
    }

    /// Frames of the true light, then one that a single view sees, with a shadow: a Gaussian that was seen more often changes less.
    #[test]
    fn what_many_frames_showed_is_not_given_up_for_one() {
        let (layer, sky, views) = wall();
        let shadow = |view: &TrainingView| {
            let dark = view.image.data().iter().map(|v| v / 2).collect();
            TrainingView { image: ImageRgb8::new(SIZE, dark).unwrap(), ..view.clone() }
        };
        let config = BackgroundConfig::default();
        let change_after = |frames: usize| {
            let (mut out, mut known) = (Arc::new(layer.clone()), Vec::new());
            let mut lane = StaticLane::default();
            let mut frame = |views: &[TrainingView], out: &mut Arc<Gaussians>| {
                let targets = StaticTargets { views, sky: &sky };
                lane.train(
                    &CpuBackend,
                    &config,
                    targets,
                    StaticColours { layer: out, variances: &mut known, passing: &mut Vec::new() },
                    1,
                    &mut |_| {},
                )
                .unwrap();
            };
            (0..frames).for_each(|_| frame(&views, &mut out));
            let before = out.clone();
            frame(&[shadow(&views[0])], &mut out);
            assert!(known.iter().flatten().all(|v| v.is_finite() && *v > 0.0));
            let change = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f32>();
            before.sh.iter().zip(&out.sh).map(change).sum::<f32>()
        };
        let [unknown, known] = [0, 5].map(change_after);
        assert!(known > 0.0 && known < 0.95 * unknown, "{unknown} without, {known} with five frames before");
    }

    #[test]
    fn what_the_masks_hide_in_part_changes_for_this_frame_alone() {
        let (layer, sky, mut views) = wall();
        let edge = SIZE.width / 2;
        let left: Vec<u8> = (0..SIZE.pixels()).map(|p| u8::from(p % SIZE.width < edge)).collect();
        views.iter_mut().for_each(|view| view.mask = Mask::new(SIZE, left.clone()).unwrap());
        let frame = |solve_in_view: f32, views: &[TrainingView]| {
            let config = BackgroundConfig { solve_in_view, ..BackgroundConfig::default() };
            let (mut out, mut known, mut passing) = (Arc::new(layer.clone()), Vec::new(), vec![7]);
            let colours = StaticColours { layer: &mut out, variances: &mut known, passing: &mut passing };
            let targets = StaticTargets { views, sky: &sky };
            StaticLane::default().train(&CpuBackend, &config, targets, colours, 1, &mut |_| {}).unwrap();
            (known, passing)
        };
        let mut unknown = Vec::new();
        predict(&BackgroundConfig::default(), layer.len(), &mut unknown);
        let (known, passing) = frame(0.7, &views);
        assert!(passing.is_sorted());
        let mut counts = [0, 0];
        for (i, place) in layer.positions().into_iter().enumerate() {
            let column = |view: &TrainingView| view.camera.project(place).unwrap().pixel.x - edge as f64;
            let nearest = views.iter().map(column).fold(f64::INFINITY, f64::min);
            let passes = passing.binary_search(&(i as u32)).is_ok();
            if nearest < -2.0 {
                assert!(passes && known[i] == unknown[i], "{i} is behind the mask of a view");
                counts[0] += 1;
            } else if nearest > 4.0 {
                assert!(!passes && known[i][0] < unknown[i][0], "{i} is beside all masks");
                counts[1] += 1;
            }
        }
        assert!(counts.iter().all(|&count| count > 50), "{counts:?}");
        assert_eq!(frame(0.0, &views).1, [0; 0], "all keep what they get");
        views.iter_mut().for_each(|view| view.mask = Mask::filled(SIZE, false));
        assert_eq!(frame(0.7, &views).1, [0; 0], "no mask hides anything");
    }

    #[test]
    fn what_lies_under_the_masks_is_not_learnt() {
        let (layer, sky, mut views) = wall();
        for view in &mut views {
            view.mask = Mask::filled(SIZE, true);
            view.image = ImageRgb8::new(SIZE, vec![255; SIZE.pixels() * 3]).unwrap();
        }
        assert_eq!(solved(&views, &layer, &sky), layer);
    }

    #[test]
    fn colours_below_the_clamp_do_not_break_it() {
        let (mut layer, sky, views) = wall();
        layer.sh.iter_mut().for_each(|c| *c = [-9.0; 3]);
        let found = solved(&views, &layer, &sky);
        assert!(found.is_finite());
        assert!(squared_error(&views, &found, &sky) <= squared_error(&views, &layer, &sky));
    }

    #[test]
    fn the_diagonal_is_that_of_the_normal_equations() {
        let (layer, _, views) = wall();
        let config = BackgroundConfig::default();
        let every_pixel = Tracing { contributors: 16, stride: 1, degree: 1 };
        let mut tracer = Tracer::default();
        let traces: Vec<ViewTrace> =
            views.iter().map(|v| ViewTrace::new(&v.camera, &layer, every_pixel, &mut tracer)).collect();
        // Nothing is off and every pixel counts: the system must not depend on the errors.
        let exact: Vec<Vec<bool>> = views.iter().map(|v| vec![true; v.camera.size().pixels()]).collect();
        let mut known = Vec::new();
        predict(&config, layer.len(), &mut known);
        let system = System::new(&config, &traces, &exact, &layer, &known);
        let diagonal = system.diagonal(&system.squares(|_, _| true));
        for entry in [0, 1, 4 * 300, 4 * 301 + 2, 4 * 599 + 3] {
            let mut unit = vec![Vec3::ZERO; diagonal.len()];
            unit[entry] = Vec3::ONE;
            let column = system.apply(&unit)[entry];
            assert!((column - diagonal[entry]).length() < 1e-4 * diagonal[entry].length(), "{entry}");
        }
    }
}
