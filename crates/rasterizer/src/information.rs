//! Information of a view on every parameter: the sums of squared derivatives of its pixels (Gauss-Newton), weighted by the
//! inverse variance of each pixel.
//!
//! For one Gaussian with `alpha = o exp(-sigma)`, all geometric parameters act through `ln alpha`. With `u` the derivative
//! of `sigma` by the pixel's place, `E = |d colour / d alpha|^2 alpha^2` and a row of the projected axes for each parameter,
//! their squared derivatives are sums of `E`, `E u u` and `E u u u u`: ten numbers per (tile, splat) hold everything.
//! The dependence of the colour on the viewing direction, and of the projection's Jacobian on the depth, are left out.

use crate::blend::{Contribution, TilePlane, Visitor, walk};
use crate::constants::{AREA, MAX_ALPHA, MIN_TRANSMITTANCE};
use crate::cpu::CpuRasterizer;
use crate::elementary::sigmoid;
use crate::pinhole::PinholeF32;
use crate::projection::{self, Ewa, Filtered, Ridge, Splat};
use crate::spherical_harmonics as sh;
use crate::tape::{RenderTape, TilePixels, for_each_pixel, gather};
use crate::tile_lists::{Entry, for_each_tile_slice};
use crate::view::View;
use ffgs_core::{Gaussians, PixelFilter, instructions, sh_coefficients};
use glam::{DMat3, DVec2, DVec3};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Sums per entry: `E`; `E u u` (xx, xy, yy); `E u u u u` (xxxx, xxxy, xxyy, xyyy, yyyy); squared blending weights.
const SUMS: usize = 10;

/// Information (inverse variance) of the parameters of N Gaussians, summed over views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Information {
    /// Of the positions (1/m^2).
    pub positions: Vec<DMat3>,
    /// Diagonals of the other parameters, shaped like the Gaussians. The column of means is not used; that of quaternions
    /// holds 0 and the information of turns about the body's axes (1/rad^2), which stays when the body turns.
    pub others: Gaussians,
}

impl Information {
    /// None, about `n` Gaussians of `sh_degree`.
    pub fn none(n: usize, sh_degree: usize) -> Self {
        Self { positions: vec![DMat3::ZERO; n], others: Gaussians::zeros(n, sh_degree) }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// What is known of the Gaussians at `indices`.
    #[must_use]
    pub fn select(&self, indices: &[usize]) -> Self {
        Self {
            positions: indices.iter().map(|&i| self.positions[i]).collect(),
            others: self.others.select(indices),
        }
    }
}

impl CpuRasterizer {
    /// Adds to `out` the information that a view holds on the last of the `layers` that `render_layers` drew into `tape`,
    /// when an error of pixel p in each channel has the inverse variance `weights[p]` (H * W). The other layers occlude and
    /// are seen through; tiles without any Gaussian of the last layer cost nothing.
    ///
    /// # Panics
    /// When `out` has another number of Gaussians than the last layer, or another SH degree.
    pub fn add_information(
        &self,
        layers: &[&Gaussians],
        view: &View,
        tape: &RenderTape,
        weights: &[f32],
        out: &mut Information,
    ) {
        let [before @ .., gaussians] = layers else { return };
        let same_degree = out.others.sh_degree() == gaussians.sh_degree();
        assert!(out.len() == gaussians.len() && same_degree, "shapes differ");
        let first: usize = before.iter().map(|layer| layer.len()).sum();
        let entries = square_tiles(view, tape, weights, first);
        let parameters = Parameters {
            gaussians,
            camera: PinholeF32::from(view.camera),
            degree: projection::active_degree(gaussians, self.options),
        };
        // Splats are in the order of the Gaussians.
        let slots = tape.splats.partition_point(|splat| (splat.index as usize) < first)..tape.splats.len();
        let index = |slot: usize| tape.splats[slot].index as usize - first;
        let of_slot = |slot: usize| {
            parameters.information(index(slot), &tape.splats[slot], &sums_of(tape, &entries, slot))
        };
        let found: Vec<SplatInformation> = slots.clone().into_par_iter().map(of_slot).collect();
        slots.zip(&found).for_each(|(slot, found)| found.add_to(index(slot), out));
    }
}

fn sums_of(tape: &RenderTape, entries: &[[f32; SUMS]], slot: usize) -> [f64; SUMS] {
    let lists = &tape.lists;
    let mut sums = [0.0; SUMS];
    for &entry in &lists.entries[lists.entry_starts[slot] as usize..lists.entry_starts[slot + 1] as usize] {
        sums.iter_mut().zip(&entries[entry as usize]).for_each(|(sum, &v)| *sum += f64::from(v));
    }
    sums
}

/// Sums per entry, in the tiles that a Gaussian from `first` on touches.
fn square_tiles(view: &View, tape: &RenderTape, weights: &[f32], first: usize) -> Vec<[f32; SUMS]> {
    let arch = instructions();
    let RenderTape { pixels, lists, splats, grid, .. } = tape;
    let mut entries = vec![[0.0; SUMS]; lists.len()];
    for_each_tile_slice(&lists.starts, &mut entries, &|tile, entries| {
        let start = lists.starts[tile] as usize;
        let slots = &lists.slots[start..start + entries.len()];
        if slots.iter().any(|entry| splats[entry.slot()].index as usize >= first) {
            let behind = shown(view, *grid, tile, &pixels[tile]);
            let sure = gather(view.camera.size(), *grid, tile, weights);
            arch.dispatch(SquareTile { origin: grid.origin(tile), splats, slots, behind, sure, entries });
        }
    });
    entries
}

/// All that the pixels of a tile show, background included.
fn shown(view: &View, grid: crate::tiles::TileGrid, tile: usize, pixels: &TilePixels) -> [TilePlane; 3] {
    let mut out = pixels.rgb;
    for_each_pixel(view.camera.size(), grid, tile, |pixel, local| {
        let background = view.background.pixel(pixel);
        let through = pixels.transmittance.0[local];
        out.iter_mut().zip(background).for_each(|(plane, b)| plane.0[local] += through * b);
    });
    out
}

struct SquareTile<'a> {
    origin: [usize; 2],
    splats: &'a [Splat],
    slots: &'a [Entry],
    behind: [TilePlane; 3],
    sure: TilePlane,
    entries: &'a mut [[f32; SUMS]],
}

impl WithSimd for SquareTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { origin, splats, slots, mut behind, sure, entries } = self;
        let zero = simd.splat_f32s(0.0);
        let [r, g, b] = &mut behind;
        let mut visitor = Square::<S> {
            behind: [r, g, b].map(|plane| S::as_mut_simd_f32s(&mut plane.0).0),
            sure: S::as_simd_f32s(&sure.0).0,
            colour: [zero; 3],
            opacity: zero,
            ridge: [zero; 3],
            sums: [zero; SUMS],
            entries,
        };
        let mut transmittance = TilePlane([1.0; AREA]);
        walk(simd, origin, splats, slots, MIN_TRANSMITTANCE, &mut transmittance, &mut visitor);
    }
}

/// Front to back: `behind` starts as everything the pixel shows and loses each contribution in turn.
struct Square<'a, S: Simd> {
    behind: [&'a mut [S::f32s]; 3],
    sure: &'a [S::f32s],
    colour: [S::f32s; 3],
    opacity: S::f32s,
    /// As [`Ridge`]: a, minus slope, inverse yy.
    ridge: [S::f32s; 3],
    sums: [S::f32s; SUMS],
    entries: &'a mut [[f32; SUMS]],
}

impl<S: Simd> Visitor<S> for Square<'_, S> {
    #[inline(always)]
    fn begin(&mut self, simd: S, splat: &Splat) {
        // Plain loops: a closure handed to `map` would be compiled without the dispatched instruction set.
        for k in 0..3 {
            self.colour[k] = simd.splat_f32s(splat.colour[k]);
        }
        self.opacity = simd.splat_f32s(splat.opacity);
        let Ridge { a, slope, inverse_yy } = Ridge::of(splat);
        self.ridge = [simd.splat_f32s(a), simd.splat_f32s(-slope), simd.splat_f32s(inverse_yy)];
        self.sums = [simd.splat_f32s(0.0); SUMS];
    }

    #[inline(always)]
    fn visit(&mut self, simd: S, c: &Contribution<S>) {
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let reveal = simd.div_f32s(one, simd.sub_f32s(one, c.alpha));
        let mut square = zero;
        for k in 0..3 {
            let behind = simd.sub_f32s(self.behind[k][c.vector], simd.mul_f32s(c.weight, self.colour[k]));
            self.behind[k][c.vector] = behind;
            let hidden = simd.mul_f32s(behind, reveal);
            let by_alpha = simd.sub_f32s(simd.mul_f32s(c.transmittance, self.colour[k]), hidden);
            square = simd.mul_add_e_f32s(by_alpha, by_alpha, square);
        }
        // Far from the splat the exponential's polynomial overflows: 0 times that would be NaN.
        let alpha = simd.mul_f32s(self.opacity, simd.select_f32s(c.counts, c.falloff, zero));
        let free = simd.and_m32s(c.counts, simd.less_than_f32s(alpha, simd.splat_f32s(MAX_ALPHA)));
        let sure = self.sure[c.vector];
        let square = simd.mul_f32s(simd.mul_f32s(square, sure), simd.mul_f32s(alpha, alpha));
        let e = simd.select_f32s(free, square, zero);
        let ux = simd.mul_f32s(self.ridge[0], c.from_ridge);
        let uy = simd.mul_add_e_f32s(self.ridge[1], ux, simd.mul_f32s(self.ridge[2], c.dy));
        let (xx, xy, yy) = (simd.mul_f32s(ux, ux), simd.mul_f32s(ux, uy), simd.mul_f32s(uy, uy));
        let (ex, ey) = (simd.mul_f32s(e, xx), simd.mul_f32s(e, yy));
        let weight = simd.mul_f32s(c.weight, c.weight);
        self.sums[0] = simd.add_f32s(self.sums[0], e);
        self.sums[1] = simd.add_f32s(self.sums[1], ex);
        self.sums[2] = simd.mul_add_e_f32s(e, xy, self.sums[2]);
        self.sums[3] = simd.add_f32s(self.sums[3], ey);
        self.sums[4] = simd.mul_add_e_f32s(ex, xx, self.sums[4]);
        self.sums[5] = simd.mul_add_e_f32s(ex, xy, self.sums[5]);
        self.sums[6] = simd.mul_add_e_f32s(ex, yy, self.sums[6]);
        self.sums[7] = simd.mul_add_e_f32s(ey, xy, self.sums[7]);
        self.sums[8] = simd.mul_add_e_f32s(ey, yy, self.sums[8]);
        self.sums[9] = simd.mul_add_e_f32s(weight, sure, self.sums[9]);
    }

    #[inline(always)]
    fn end(&mut self, simd: S, place: usize) {
        let mut s = [0.0; SUMS];
        for k in 0..SUMS {
            s[k] = simd.reduce_sum_f32s(self.sums[k]);
        }
        self.entries[place] = s;
    }
}

/// Information of one Gaussian's parameters in one view.
struct SplatInformation {
    position: DMat3,
    turns: [f32; 3],
    log_scales: [f32; 3],
    opacity: f32,
    /// Of the colour that is shown, channel by channel.
    colour: [f32; 3],
    basis: [f32; 16],
    coefficients: usize,
}

impl SplatInformation {
    fn add_to(&self, i: usize, out: &mut Information) {
        out.positions[i] += self.position;
        let stride = out.others.sh_stride();
        let others = &mut out.others;
        others.quats[i][1..].iter_mut().zip(self.turns).for_each(|(sum, v)| *sum += v);
        others.log_scales[i].iter_mut().zip(self.log_scales).for_each(|(sum, v)| *sum += v);
        others.opacity_logits[i] += self.opacity;
        let sh = &mut others.sh[i * stride..i * stride + self.coefficients];
        for (sum, basis) in sh.iter_mut().zip(self.basis) {
            sum.iter_mut().zip(self.colour).for_each(|(sum, v)| *sum += basis * basis * v);
        }
    }
}

/// From sums per splat to the Gaussian's parameters.
struct Parameters<'a> {
    gaussians: &'a Gaussians,
    camera: PinholeF32,
    degree: usize,
}

impl Parameters<'_> {
    fn information(&self, i: usize, splat: &Splat, sums: &[f64; SUMS]) -> SplatInformation {
        let g = self.gaussians;
        let offset = projection::offset(g.means[i], self.camera.center);
        let ewa = projection::ewa(offset, g.quats[i], g.log_scales[i], &self.camera);
        let filtered = projection::filter(&ewa, &self.camera, self.gaussians.filter);
        let shape = Shape::new(&ewa, &filtered, self.gaussians.filter, sums);
        let bare = f64::from(sigmoid(g.opacity_logits[i]));
        let shown = splat.colour.map(|c| if c > 0.0 { sums[9] as f32 } else { 0.0 });
        SplatInformation {
            position: shape.position(&ewa),
            turns: shape.turns().map(|v| v as f32),
            log_scales: [0, 1, 2].map(|k| shape.stretch(k) as f32),
            opacity: (sums[0] * (1.0 - bare).powi(2)) as f32,
            colour: shown,
            basis: sh::basis(self.degree, offset.normalize_or_zero()),
            coefficients: sh_coefficients(self.degree),
        }
    }
}

/// A projected shape, with the sums to contract it with.
struct Shape<'a> {
    sums: &'a [f64; SUMS],
    /// Body axes in the image (px / m).
    axes: [DVec2; 3],
    /// Standard deviations (m).
    scales: [f64; 3],
    /// Derivative of the antialiasing compensation: inverse of the bare covariance minus that of the filtered one (1/px^2).
    compensation_slope: [f64; 3],
}

impl<'a> Shape<'a> {
    fn new(ewa: &Ewa, filtered: &Filtered, kind: PixelFilter, sums: &'a [f64; SUMS]) -> Self {
        let scales = ewa.scales.to_array().map(f64::from);
        let axis = |k: usize| DVec2::new(f64::from(ewa.axes[0][k]), f64::from(ewa.axes[1][k])) / scales[k];
        let free = kind == PixelFilter::Compensated && projection::compensation_is_free(filtered);
        let inverse = |[xx, xy, yy]: [f32; 3], determinant: f32| {
            [yy, -xy, xx].map(|v| f64::from(v) / f64::from(determinant))
        };
        let [bare, wide] = [
            inverse(ewa.covariance, filtered.determinants[0]),
            inverse(filtered.covariance, filtered.determinants[1]),
        ];
        let compensation_slope = [0, 1, 2].map(|k| if free { bare[k] - wide[k] } else { 0.0 });
        Self { sums, axes: [0, 1, 2].map(axis), scales, compensation_slope }
    }

    /// `sum E (factor (a.u)(b.u) + bias)^2`.
    fn squared(&self, a: DVec2, b: DVec2, factor: f64) -> f64 {
        let [zero, xx, xy, yy, fourth @ .., _] = self.sums;
        // (a.u)(b.u) = p x^2 + q x y + r y^2.
        let [p, q, r] = [a.x * b.x, a.x * b.y + a.y * b.x, a.y * b.y];
        let fourth = p * p * fourth[0]
            + 2.0 * p * q * fourth[1]
            + (q * q + 2.0 * p * r) * fourth[2]
            + 2.0 * q * r * fourth[3]
            + r * r * fourth[4];
        let second = p * xx + q * xy + r * yy;
        let bias =
            p * self.compensation_slope[0] + q * self.compensation_slope[1] + r * self.compensation_slope[2];
        (factor * factor * (fourth + 2.0 * bias * second + bias * bias * zero)).max(0.0)
    }

    /// Of a log scale: `d ln alpha = (v.u)^2` with v the projected axis.
    fn stretch(&self, k: usize) -> f64 {
        self.squared(self.axes[k], self.axes[k], self.scales[k].powi(2))
    }

    /// Of a turn about each body axis: the other two exchange `s_m^2 - s_n^2`.
    fn turns(&self) -> [f64; 3] {
        [(1, 2), (2, 0), (0, 1)].map(|(m, n)| {
            let exchanged = self.scales[m].powi(2) - self.scales[n].powi(2);
            self.squared(self.axes[m], self.axes[n], exchanged)
        })
    }

    /// Of the position (1/m^2), through the projected mean.
    fn position(&self, ewa: &Ewa) -> DMat3 {
        let [_, xx, xy, yy, ..] = *self.sums;
        let [x, y] = ewa.to_pixels.map(glam::Vec3::as_dvec3);
        let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
        outer(x, x) * xx + (outer(x, y) + outer(y, x)) * xy + outer(y, y) * yy
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::Background;
    use ffgs_core::{Camera, ImageSize, Intrinsics};

    const SIZE: ImageSize = ImageSize { width: 48, height: 32 };

    fn scene(filter: PixelFilter) -> (Gaussians, Camera) {
        let mut g = Gaussians::zeros(12, 1).with_filter(filter);
        for i in 0..g.len() {
            let spread = |k: usize| ((i * k) % 17) as f32 / 17.0 - 0.5;
            g.means[i] = [2.0 * spread(5), 1.4 * spread(7), 4.0 + spread(3)];
            g.quats[i] = [1.3, spread(11), spread(13), spread(2)];
            g.log_scales[i] = [-1.6 + spread(9), -1.2 + spread(4), -1.9];
            g.opacity_logits[i] = 2.0 * spread(6) - 0.3;
            (0..4).for_each(|k| g.sh[4 * i + k] = [0.4 + spread(8 + k), 0.3, 0.5 + spread(12 + k)]);
        }
        let intrinsics = Intrinsics { fx: 40.0, fy: 42.0, cx: 24.0, cy: 16.0 };
        let pose = glam::DMat4::from_rotation_y(0.1) * glam::DMat4::from_rotation_x(-0.05);
        (g, Camera::new(intrinsics, pose, SIZE).unwrap())
    }

    fn image(g: &Gaussians, camera: &Camera) -> Vec<f64> {
        let view = View { camera, background: Background::Colour([0.2, 0.4, 0.6]), tiles: None };
        let mut tape = RenderTape::default();
        CpuRasterizer::default().render(g, &view, &mut tape);
        tape.image().data().iter().map(|v| f64::from(*v)).collect()
    }

    /// Pixel p counts `1 + p % 3`.
    fn weights() -> Vec<f32> {
        (0..SIZE.pixels()).map(|p| 1.0 + (p % 3) as f32).collect()
    }

    /// Derivatives of all pixels by central differences of a parameter.
    fn derivative(camera: &Camera, filter: PixelFilter, change: impl Fn(&mut Gaussians, f32)) -> Vec<f64> {
        const STEP: f32 = 2e-2;
        let at = |side: f32| {
            let mut g = scene(filter).0;
            change(&mut g, side * STEP);
            image(&g, camera)
        };
        let (above, below) = (at(1.0), at(-1.0));
        above.iter().zip(below).map(|(a, b)| (a - b) / (2.0 * f64::from(STEP))).collect()
    }

    fn inner(a: &[f64], b: &[f64]) -> f64 {
        let weights = weights();
        a.iter().zip(b).enumerate().map(|(p, (a, b))| a * b * f64::from(weights[p % SIZE.pixels()])).sum()
    }

    fn information(filter: PixelFilter) -> Information {
        let (g, camera) = scene(filter);
        let view = View { camera: &camera, background: Background::Colour([0.2, 0.4, 0.6]), tiles: None };
        let rasterizer = CpuRasterizer::default();
        let mut tape = RenderTape::default();
        rasterizer.render(&g, &view, &mut tape);
        let mut out = Information::none(g.len(), 1);
        rasterizer.add_information(&[&g], &view, &tape, &weights(), &mut out);
        out
    }

    /// Layers render as all Gaussians in one, and the information on the last is the same, bit by bit.
    #[test]
    fn layers_are_rendered_as_one() {
        let (g, camera) = scene(PixelFilter::Compensated);
        let view = View { camera: &camera, background: Background::Colour([0.2, 0.4, 0.6]), tiles: None };
        let rasterizer = CpuRasterizer::default();
        let mut tape = RenderTape::default();
        rasterizer.render(&g, &view, &mut tape);
        let (image, all) = (tape.image().clone(), information(PixelFilter::Compensated));
        for first in 0..=g.len() {
            let [before, rest] = [0..first, first..g.len()].map(Iterator::collect::<Vec<usize>>);
            let layers = [&g.select(&before), &g.select(&rest)];
            rasterizer.render_layers(&layers, &view, &mut tape);
            assert!(*tape.image() == image, "from {first}");
            let mut part = Information::none(rest.len(), 1);
            rasterizer.add_information(&layers, &view, &tape, &weights(), &mut part);
            assert!(part == all.select(&rest), "from {first}");
        }
    }

    /// Contributions under 1/255 begin and end at pixels, which differences see and derivatives do not: a pixel that does so
    /// between two steps adds up to (1/255 / 0.04)^2 times its weight of 3, in three channels.
    fn assert_close(found: f64, want: f64, what: &str) {
        assert!((found - want).abs() <= 0.05 * want.abs() + 0.1, "{what}: {found}, differences {want}");
    }

    /// After a turn by `angle` about a body axis.
    fn turned(q: [f32; 4], axis: usize, angle: f32) -> [f32; 4] {
        let q = glam::Quat::from_xyzw(q[1], q[2], q[3], q[0]).normalize();
        let q = q * glam::Quat::from_axis_angle(glam::Vec3::AXES[axis], angle);
        [q.w, q.x, q.y, q.z]
    }

    #[test]
    fn information_matches_finite_differences() {
        let (g, camera) = scene(PixelFilter::Compensated);
        for filter in [PixelFilter::Plain, PixelFilter::Compensated] {
            let information = information(filter);
            let by = |change: &dyn Fn(&mut Gaussians, f32)| derivative(&camera, filter, change);
            for i in 0..g.len() {
                for k in 0..3 {
                    let d = by(&|g, h| g.log_scales[i][k] += h);
                    let found = f64::from(information.others.log_scales[i][k]);
                    assert_close(found, inner(&d, &d), &format!("scale {k} of {i}"));
                }
                for k in 0..3 {
                    let d = by(&|g, h| g.quats[i] = turned(g.quats[i], k, h));
                    let found = f64::from(information.others.quats[i][k + 1]);
                    assert_close(found, inner(&d, &d), &format!("turn {k} of {i}"));
                }
                for k in 0..4 {
                    let d = by(&|g, h| g.sh[4 * i + k][0] += h);
                    let found = f64::from(information.others.sh[4 * i + k][0]);
                    assert_close(found, inner(&d, &d), &format!("colour {k} of {i}"));
                }
                let d = by(&|g, h| g.opacity_logits[i] += h);
                assert_close(f64::from(information.others.opacity_logits[i]), inner(&d, &d), "opacity");
            }
        }
    }

    /// Across the viewing direction the mean acts through its projection; along it, and where shape and colour follow the
    /// direction, other paths exist that are left out.
    #[test]
    fn positions_match_finite_differences_across_the_ray() {
        let (g, camera) = scene(PixelFilter::Plain);
        let information = information(PixelFilter::Plain);
        let [right, down] = [camera.rotation().transpose().x_axis, camera.rotation().transpose().y_axis];
        for i in 0..g.len() {
            let moved = |along: DVec3| {
                derivative(&camera, PixelFilter::Plain, move |g, h| {
                    let place = DVec3::from(g.means[i].map(f64::from)) + along * f64::from(h);
                    g.means[i] = place.as_vec3().to_array();
                })
            };
            let (x, y) = (moved(right), moved(down));
            for (a, b, along, other) in [(&x, &x, right, right), (&y, &y, down, down), (&x, &y, right, down)]
            {
                let (found, want) = (along.dot(information.positions[i] * other), inner(a, b));
                let size = (inner(a, a) * inner(b, b)).sqrt();
                assert!((found - want).abs() < 0.1 * size, "{i}: {found}, differences {want} of {size}");
            }
        }
    }
}
