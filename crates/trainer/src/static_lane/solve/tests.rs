//! Colours of walls before few cameras.

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
    let of = |v: &TrainingView| residual_of(v, layer, sky).iter().map(|r| r.length_squared()).sum::<f32>();
    views.iter().map(of).sum()
}

fn solved(views: &[TrainingView], layer: &Gaussians, sky: &SkyCube) -> Gaussians {
    let mut out = Arc::new(layer.clone());
    let config = BackgroundConfig { solve_iterations: 40, solve_noise: 0.005, ..BackgroundConfig::default() };
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
fn no_colour_becomes_brighter_than_photographs_are() {
    let (mut layer, sky, mut views) = wall();
    // Photographs are whiter than what a third of opacity can show.
    layer.opacity_logits.iter_mut().for_each(|o| *o = -0.7);
    let white = ImageRgb8::new(SIZE, vec![255; SIZE.pixels() * 3]).unwrap();
    views.iter_mut().for_each(|view| view.image = white.clone());
    // One is brighter already.
    layer.sh[0] = [3.0; 3];
    let brightest = |layer: &Gaussians, i: usize| {
        let of_view = |view: &TrainingView| {
            let direction = Vec3::from(layer.means[i]) - view.camera.center().as_vec3();
            let basis = sh_basis(layer.sh_degree(), direction.normalize());
            layer.sh_of(i).iter().zip(basis).fold(0.5, |sum, (c, b)| sum + b * c[0])
        };
        views.iter().map(of_view).fold(f32::MIN, f32::max)
    };
    let (mut found, start) = (layer.clone(), brightest(&layer, 0));
    (0..3).for_each(|_| found = solved(&views, &found, &sky));
    let all: Vec<f32> = (1..layer.len()).map(|i| brightest(&found, i)).collect();
    let most = all.iter().copied().fold(f32::MIN, f32::max);
    assert!(most > 1.05 && most < BRIGHTEST + 1e-3, "{most}");
    assert!(start > BRIGHTEST && brightest(&found, 0) < start + 1e-3, "{start} {}", brightest(&found, 0));
    assert!(squared_error(&views, &found, &sky) < squared_error(&views, &layer, &sky));
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
