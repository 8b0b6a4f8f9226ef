//! Groups that their trackers have lost. What moves by a quarter of the image between two frames is found by no tracker, and
//! from so far away no Gauss-Newton step leads to it; in the first frame after frame 0, or of a newborn, no last motion tells
//! it either. But things that are filmed together often move alike, as the cars of a race do.
//!
//! A group is lost when much of it lies outside the masks. It takes the motion of another group, about its own centre, if that
//! keeps it in the masks and the photographs agree: the whole layer is compared, as each motion shows other parts of the group.

use super::photograph::{Patch, pixel_m};
use super::starts::{BETTER, Start, UNLIKE};
use super::surface::{brightness, surface_points};
use super::{AlignmentConfig, LEAST_PIXELS, LEAST_VIEWS, correction, moved_layer};
use crate::Rotate;
use ffgs_core::{Gaussians, PlanarImage, TrainingView};
use ffgs_fusion::{Groups, RigidMotion};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use glam::DVec3;
use rayon::prelude::*;

/// Share of a group's Gaussians outside the masks, over all views, up to which it is not lost.
const STRAYED: f64 = 0.05;
/// Another motion is tried if it leaves so much less of the group outside.
const FEWER: f64 = 0.7;
/// Two states of the layer are alike in a pixel whose differences from the photograph are no further apart.
const ALIKE: f64 = 0.5 / 255.0;

/// Gives the lost ones among the groups of `layer` (where it was at t-1) the motions of others, aligned with the `views` at t;
/// `aligned` says which groups the photographs have aligned.
pub(super) fn find_lost(
    config: &AlignmentConfig,
    rotate: Rotate,
    views: &[&TrainingView],
    layer: &Gaussians,
    aligned: &[bool],
    groups: &mut Groups,
) {
    let motions: Vec<RigidMotion> = groups.found.iter().map(|group| group.motion).collect();
    for g in 0..motions.len() {
        let Some(motion) = kept_in_masks(views, layer, groups, g, &motions, aligned) else { continue };
        let Some(candidate) = like_another(config, rotate, views, layer, groups, g, motion) else { continue };
        let layers = [&*groups, &candidate].map(|groups| moved_layer(layer, groups, rotate));
        let [now, then] = differences(views, layers.each_ref());
        tracing::debug!(
            "a lost group may move like another: {now:.1} -> {then:.1} of the photographs are left"
        );
        if then < BETTER * now {
            *groups = candidate;
        }
    }
}

/// Of the aligned motions of other groups, about this one's centre, that which leaves least of it outside the masks, if the group is
/// lost and much less of it is outside then.
fn kept_in_masks(
    views: &[&TrainingView],
    layer: &Gaussians,
    groups: &Groups,
    g: usize,
    motions: &[RigidMotion],
    aligned: &[bool],
) -> Option<RigidMotion> {
    let members = groups.of.iter().zip(&layer.means).filter(|(of, _)| **of == Some(g));
    let places: Vec<DVec3> = members.map(|(_, mean)| DVec3::from(mean.map(f64::from))).collect();
    let own = strayed(views, &places, &motions[g]);
    if own <= STRAYED {
        return None;
    }
    let others = (0..motions.len()).filter(|&other| other != g && aligned[other]);
    let about = others.map(|other| RigidMotion { centre: motions[g].centre, ..motions[other] });
    let judged = about.map(|motion| (strayed(views, &places, &motion), motion));
    let (least, motion) = judged.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (least < FEWER * own).then_some(motion)
}

/// Share of places that a motion brings into images, but outside the masks.
fn strayed(views: &[&TrainingView], places: &[DVec3], motion: &RigidMotion) -> f64 {
    let of_view = |view: &&TrainingView| {
        let shown = places.iter().filter_map(|&place| view.camera.pixel_of(motion.apply(place)));
        shown.fold([0usize; 2], |[outside, all], (x, y)| {
            [outside + usize::from(!view.mask.contains(x, y)), all + 1]
        })
    };
    let [outside, all] = views.par_iter().map(of_view).reduce(|| [0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    outside as f64 / all.max(1) as f64
}

/// The groups with one of them moved by `motion`, once aligned with the photographs.
fn like_another(
    config: &AlignmentConfig,
    rotate: Rotate,
    views: &[&TrainingView],
    layer: &Gaussians,
    groups: &Groups,
    g: usize,
    motion: RigidMotion,
) -> Option<Groups> {
    let mut candidate = groups.clone();
    candidate.found[g].motion = motion;
    let moved = moved_layer(layer, &candidate, rotate);
    let seen: Vec<_> = (views.par_iter())
        .map(|view| surface_points(view, &moved, &candidate, config.pixels).swap_remove(g))
        .collect();
    let patches = views.iter().zip(&seen).map(|(view, points)| Patch { view, points });
    let patches: Vec<Patch> = patches.filter(|p| p.points.len() >= LEAST_PIXELS).collect();
    let group = &mut candidate.found[g];
    let centre = group.motion.centre + group.motion.step;
    let pixel_m = views.iter().map(|view| pixel_m(&view.camera, centre)).fold(f64::INFINITY, f64::min);
    let start = Start::of_forecast(&motion, group, pixel_m);
    let aligned = (patches.len() >= LEAST_VIEWS).then(|| correction(config, &start, pixel_m, &patches));
    aligned.flatten().or_else(|| start.alone())?.apply(group);
    group.lost = true;
    Some(candidate)
}

/// What two states of the layer leave of the photographs: sums of the difference of brightness over the pixels in which they
/// differ.
fn differences(views: &[&TrainingView], layers: [&Gaussians; 2]) -> [f64; 2] {
    let of_view = |view: &&TrainingView| {
        let photograph = PlanarImage::from(&view.image);
        let [one, other] = layers.map(|layer| pixel_differences(view, &photograph, layer));
        let differ = one.iter().zip(&other).filter(|(a, b)| (**a - **b).abs() > ALIKE);
        differ.fold([0.0; 2], |sum, (a, b)| [sum[0] + a, sum[1] + b])
    };
    let sums: Vec<[f64; 2]> = views.par_iter().map(of_view).collect();
    sums.iter().fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]])
}

/// What the layer leaves of each pixel of a photograph: the difference of brightness in the mask; [`UNLIKE`] where it shows nothing there,
/// or something outside it.
fn pixel_differences(view: &TrainingView, photograph: &PlanarImage, layer: &Gaussians) -> Vec<f64> {
    let shown = View { camera: &view.camera, background: Background::Image(photograph), tiles: None };
    let mut tape = RenderTape::default();
    CpuRasterizer::default().render(layer, &shown, &mut tape);
    let through = tape.transmittance().iter().map(|&through| f64::from(through));
    let of_pixel = |(pixel, through): (usize, f64)| {
        if view.mask.data()[pixel] == 0 {
            return UNLIKE * (1.0 - through);
        }
        // The photograph stands behind the layer, so that only what covers it differs.
        let [rendered, seen] = [tape.image().pixel(pixel), photograph.pixel(pixel)].map(brightness);
        (rendered - seen).abs().min(UNLIKE) + UNLIKE * through
    };
    through.enumerate().map(of_pixel).collect()
}
