//! A textured ball, photographed where it really went.

use super::photograph::Patch;
use super::*;
use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use ffgs_testkit::look_at;
use glam::DVec2;

const SIZE: ImageSize = ImageSize { width: 96, height: 72 };
/// Size of a pixel at the ball (m): distance over focal length.
const PIXEL_M: f64 = 4.0 / 90.0;

/// 900 Gaussians on a sphere of 0.8 m, coloured by waves over it.
fn ball() -> Gaussians {
    let mut ball = Gaussians::zeros(900, 0);
    for i in 0..900 {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / 900.0;
        let (sin, cos) = (2.399_963 * i as f32).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        let place = [ring * cos, ring * sin, z];
        ball.means[i] = place.map(|v| 0.8 * v);
        ball.quats[i] = [1.0, 0.0, 0.0, 0.0];
        ball.log_scales[i] = [-2.9; 3];
        ball.opacity_logits[i] = 3.0;
        ball.sh[i] = [0, 1, 2].map(|c| (7.0 * place[c]).sin() + 0.5 * (11.0 * place[(c + 1) % 3]).cos());
    }
    ball
}

/// `count` cameras around the ball, and what they see of it after `motion`, brightened by `exposure`.
fn photographs(count: usize, motion: &RigidMotion, exposure: f32) -> Vec<TrainingView> {
    photographs_of(&ball(), &one_group(*motion, 900), count, 4.0, exposure)
}

/// The same of another layer, from a `distance` (m).
fn photographs_of(
    layer: &Gaussians,
    groups: &Groups,
    count: usize,
    distance: f64,
    exposure: f32,
) -> Vec<TrainingView> {
    let moved = moved_layer(layer, groups, Rotate::SplatAndColour);
    let view = |i: usize| {
        let (sin, cos) = (i as f64 * 2.4).sin_cos();
        let eye = DVec3::new(distance * cos, distance * sin, 0.7 * (i % 3) as f64);
        let intrinsics = Intrinsics { fx: 90.0, fy: 90.0, cx: 48.0, cy: 36.0 };
        let camera = Camera::new(intrinsics, look_at(eye, DVec3::ZERO), SIZE).unwrap();
        let mut tape = RenderTape::default();
        let shown = View { camera: &camera, background: Background::Colour([0.3; 3]), tiles: None };
        CpuRasterizer::default().render(&moved, &shown, &mut tape);
        let mut image = PlanarImage::zeros(SIZE);
        image.data_mut().iter_mut().zip(tape.image().data()).for_each(|(out, v)| *out = v + exposure);
        let mask = tape.transmittance().iter().map(|&t| u8::from(t < 0.1)).collect();
        TrainingView { camera, image: ImageRgb8::from(&image), mask: Mask::new(SIZE, mask).unwrap() }
    };
    (0..count).map(view).collect()
}

/// All Gaussians in one group, whose motion is known to 2 cm and 1 degree.
fn one_group(motion: RigidMotion, n: usize) -> Groups {
    let mut covariance = Matrix6::identity() * 0.02_f64.powi(2);
    (3..6).for_each(|i| covariance[(i, i)] = 1.0_f64.to_radians().powi(2));
    let group = Group {
        motion,
        covariance,
        scales: vec![1.0],
        spread: 1e-4,
        shared: 0.0,
        cells: 1,
        flexibility: -9.0,
        lost: false,
    };
    Groups { found: vec![group], of: vec![Some(0); n], ..Groups::default() }
}

fn truth() -> RigidMotion {
    let rotation = DQuat::from_scaled_axis(DVec3::new(0.02, -0.05, 0.15));
    RigidMotion { centre: DVec3::new(0.1, 0.0, -0.1), rotation, step: DVec3::new(0.15, -0.08, 0.05) }
}

/// The truth, 2 cm and a degree off: half a pixel.
fn tracked() -> RigidMotion {
    let turn = DQuat::from_scaled_axis(DVec3::new(-0.01, 0.012, 0.01));
    RigidMotion {
        rotation: turn * truth().rotation,
        step: truth().step + DVec3::new(0.01, 0.015, -0.01),
        ..truth()
    }
}

/// Errors of step (m) and turn (rad) of a group about the truth.
fn errors(group: &Group) -> [f64; 2] {
    let turn = group.motion.rotation * truth().rotation.inverse();
    [(group.motion.step - truth().step).length(), turn.to_scaled_axis().length()]
}

fn aligned(views: &[TrainingView]) -> (usize, Group) {
    let mut groups = one_group(tracked(), 900);
    let config = AlignmentConfig::default();
    let count = align(&config, Rotate::SplatAndColour, views, &ball(), &[None], &mut groups);
    (count, groups.found.remove(0))
}

#[test]
fn the_true_motion_is_found_with_a_covariance_that_says_how_well() {
    let (count, group) = aligned(&photographs(8, &truth(), 0.0));
    let ([step, turn], [start, turned]) = (errors(&group), errors(&one_group(tracked(), 900).found[0]));
    assert_eq!(count, 1);
    assert!(start > 0.4 * PIXEL_M && turned > 0.015, "the start is off: {start} m, {turned} rad");
    assert!(step < 0.05 * PIXEL_M, "{step} m is more than a twentieth of a pixel");
    assert!(turn < 0.003, "{turn} rad");
    let error = offset(&RigidMotion {
        step: group.motion.step - truth().step,
        rotation: group.motion.rotation * truth().rotation.inverse(),
        ..truth()
    });
    let distance = error.dot(&group.covariance.cholesky().unwrap().solve(&error));
    // 99.9 % point of chi squared with six degrees of freedom.
    assert!(distance < 22.5, "{distance}");
    assert!(group.covariance[(0, 0)].sqrt() < 0.5 * PIXEL_M && group.shared == 0.0);
}

#[test]
fn reduced_photographs_tell_it_too() {
    let whole = photographs(8, &truth(), 0.0);
    let (count, group) = aligned(&TrainingView::all_reduced(&whole, 2));
    let [step, turn] = errors(&group);
    assert!(count == 1 && step < 0.1 * PIXEL_M && turn < 0.006, "{step} m, {turn} rad");
}

#[test]
fn a_change_of_exposure_is_no_motion() {
    let (count, group) = aligned(&photographs(8, &truth(), 0.1));
    let [step, turn] = errors(&group);
    assert!(count == 1 && step < 0.1 * PIXEL_M && turn < 0.006, "{step} m, {turn} rad");
}

#[test]
fn where_photographs_tell_nothing_the_trackers_motion_stays() {
    let unchanged = |views: &[TrainingView]| {
        let (count, group) = aligned(views);
        count == 0
            && group.motion == tracked()
            && group.covariance == one_group(tracked(), 1).found[0].covariance
    };
    let views = photographs(8, &truth(), 0.0);
    assert!(unchanged(&views[..LEAST_VIEWS - 1]), "too few views");
    assert!(unchanged(&[]), "no view");
    let black = |view: &TrainingView| TrainingView {
        image: ImageRgb8::new(SIZE, vec![0; SIZE.pixels() * 3]).unwrap(),
        ..view.clone()
    };
    assert!(unchanged(&views.iter().map(black).collect::<Vec<_>>()), "no texture");
    let hidden = |view: &TrainingView| TrainingView { mask: Mask::filled(SIZE, false), ..view.clone() };
    assert!(unchanged(&views.iter().map(hidden).collect::<Vec<_>>()), "empty masks");
    let mut off = one_group(tracked(), 900);
    let config = AlignmentConfig { steps: 0, ..AlignmentConfig::default() };
    assert_eq!(align(&config, Rotate::Splat, &views, &ball(), &[None], &mut off), 0);
}

#[test]
fn of_two_starts_the_photographs_take_the_better_one() {
    let views = photographs(8, &truth(), 0.0);
    let off = |by: f64| RigidMotion { step: truth().step + DVec3::new(by, -by, 0.0), ..truth() };
    let error = |tracked: RigidMotion, last: Option<RigidMotion>| {
        let mut groups = one_group(tracked, 900);
        align(&AlignmentConfig::default(), Rotate::SplatAndColour, &views, &ball(), &[last], &mut groups);
        errors(&groups.found[0])[0]
    };
    let far = 10.0 * PIXEL_M;
    assert!(error(off(far), None) > 3.0 * PIXEL_M, "beyond the reach of the steps");
    assert!(error(off(far), Some(off(0.02))) < 0.1 * PIXEL_M);
    assert!(error(tracked(), Some(off(far))) < 0.1 * PIXEL_M, "the trackers are right");
}

/// Two balls, one above the other, each a group that moves by a step (m).
fn two_balls(steps: [DVec3; 2]) -> (Gaussians, Groups) {
    let mut layer = Gaussians::zeros(0, 0);
    let mut groups = Groups::default();
    for (g, step) in steps.into_iter().enumerate() {
        let centre = DVec3::new(0.0, 0.0, 2.4 * g as f64 - 1.2);
        let mut ball = ball();
        ball.means.iter_mut().for_each(|mean| mean[2] += centre.z as f32);
        layer.extend(&ball);
        let motion = RigidMotion { centre, rotation: DQuat::IDENTITY, step };
        groups.found.append(&mut one_group(motion, 0).found);
        groups.of.extend([Some(g); 900]);
    }
    (layer, groups)
}

#[test]
fn a_group_that_trackers_lost_moves_like_another_where_the_photographs_agree() {
    // Ten pixels, and half of one.
    let (fast, near) = (DVec3::new(0.7, -0.6, 0.2), DVec3::new(0.02, 0.03, -0.02));
    let align_from = |tracked: [DVec3; 2], truth: [DVec3; 2]| {
        let (layer, photographed) = two_balls(truth);
        let views = photographs_of(&layer, &photographed, 8, 8.0, 0.0);
        let mut groups = two_balls(tracked).1;
        align(&AlignmentConfig::default(), Rotate::SplatAndColour, &views, &layer, &[None; 2], &mut groups);
        groups.found
    };
    let found = align_from([fast + near, DVec3::ZERO], [fast; 2]);
    assert!(found[1].lost && !found[0].lost, "{found:?}");
    assert!(found[1].motion.step.distance(fast) < 0.02, "a quarter of a pixel: {:?}", found[1].motion.step);
    // A group that is where its trackers say stays there, however the other one moves.
    let found = align_from([fast + near, near], [fast, DVec3::ZERO]);
    assert!(found.iter().all(|group| !group.lost), "{found:?}");
    assert!(found[1].motion.step.length() < 0.02, "{:?}", found[1].motion.step);
    // A lost group does not take a motion that does not fit it either.
    let found = align_from([fast + near, DVec3::ZERO], [fast, -fast]);
    assert!(!found[1].lost, "{found:?}");
}

#[test]
fn a_motion_goes_on_about_the_moved_centre() {
    let places = ball().positions();
    let motion = truth();
    let now: Vec<DVec3> = places.iter().map(|&p| motion.apply(p)).collect();
    let mut steps: Vec<DVec3> = now.iter().zip(&places).map(|(a, b)| *a - *b).collect();
    // Some members went elsewhere, and of one nothing is known.
    steps.iter_mut().step_by(5).for_each(|step| *step = DVec3::new(0.0, 3.0, 0.0));
    steps[1] = DVec3::NAN;
    let groups = one_group(motion, 900);
    let next = continuation::continued(&groups, &now, &steps)[0].unwrap();
    let error = now.iter().map(|&p| next.apply(p).distance(motion.apply(p))).fold(0.0, f64::max);
    // The same screw once more: the step turns with the body.
    assert!(error < 1e-3, "{error}");
    assert!(continuation::continued(&one_group(motion, 9), &now[..9], &steps[..9])[0].is_none(), "too few");
}

#[test]
fn photographs_tell_whether_a_part_departs() {
    let still = RigidMotion { centre: DVec3::ZERO, rotation: DQuat::IDENTITY, step: DVec3::ZERO };
    let (before, now) = (photographs(8, &still, 0.0), photographs(8, &truth(), 0.0));
    let views: Vec<(&TrainingView, &TrainingView)> = before.iter().zip(&now).collect();
    let claim = DVec3::new(0.1, 0.15, 0.0);
    // The upper half of the ball is one cell, the lower half another.
    let odds = |motion: RigidMotion, offsets: [Option<DVec3>; 2]| {
        let mut groups = one_group(motion, 900);
        groups.cells.order = (0..900).collect();
        groups.cells.leaves = vec![0..450, 450..900];
        let seen: Vec<_> = before.iter().map(|view| surface_points(view, &ball(), &groups, 4096)).collect();
        departures::departures(&views, &seen, &groups, &offsets)
    };
    let [claimed, silent] = odds(truth(), [Some(claim), None]).try_into().unwrap();
    assert!(claimed < -20.0 && silent == 0.0, "{claimed} {silent}");
    let wrong = RigidMotion { step: truth().step - claim, ..truth() };
    let [right, silent] = odds(wrong, [Some(claim), None]).try_into().unwrap();
    assert!(right > 20.0 && silent == 0.0, "{right} {silent}");
}

#[test]
fn derivatives_agree_with_finite_differences() {
    let views = photographs(1, &truth(), 0.0);
    let mut groups = one_group(truth(), 900);
    let moved = moved_layer(&ball(), &groups, Rotate::Splat);
    let points = surface_points(&views[0], &moved, &groups, 200).remove(0);
    let patch = Patch { view: &views[0], points: &points };
    let motion = groups.found.remove(0).motion;
    // Off the pixels' centres, where another sixteen pixels begin to count.
    let step = DVec3::new(0.011, -0.009, 0.013);
    let motion = RigidMotion { centre: motion.centre + motion.step, rotation: DQuat::IDENTITY, step };
    let shift = 1e-5;
    let rows = patch.rows(&motion);
    assert!(rows.len() > 50, "{}", rows.len());
    for k in 0..6 {
        let mut change = Unknowns::zeros();
        change[k] = shift;
        let [ahead, back] = [change, -change].map(|change| patch.rows(&super::moved(motion, &change)));
        assert_eq!([ahead.len(), back.len()], [rows.len(); 2]);
        for ((row, ahead), back) in rows.iter().zip(ahead).zip(back) {
            let slope = (ahead.difference - back.difference) / (2.0 * shift);
            assert!((slope - row.derivative[k]).abs() < 1e-3 * (1.0 + slope.abs()), "{k}: {slope} {row:?}");
        }
    }
}

#[test]
fn a_photograph_of_constant_slope_is_interpolated_to_its_rounding() {
    let value = |x: f64, y: f64| 0.2 + 0.004 * x + 0.003 * y;
    let mut image = PlanarImage::zeros(SIZE);
    for i in 0..SIZE.pixels() {
        let (x, y) = ((i % SIZE.width) as f64 + 0.5, (i / SIZE.width) as f64 + 0.5);
        image.set_pixel(i, [value(x, y) as f32; 3]);
    }
    let mut view = photographs(1, &truth(), 0.0).remove(0);
    (view.image, view.mask) = (ImageRgb8::from(&image), Mask::filled(SIZE, true));
    let patch = Patch { view: &view, points: &[] };
    let (found, slope) = patch.bicubic(DVec2::new(20.3, 30.9)).unwrap();
    // Eight bits per channel.
    assert!((found - value(20.3, 30.9)).abs() < 1.0 / 255.0, "{found}");
    assert!((slope - DVec2::new(0.004, 0.003)).abs().max_element() < 2.0 / 255.0, "{slope}");
    for outside in [DVec2::new(1.2, 30.0), DVec2::new(95.0, 30.0), DVec2::new(20.0, -3.0), DVec2::NAN] {
        assert!(patch.bicubic(outside).is_none(), "{outside}");
    }
}
