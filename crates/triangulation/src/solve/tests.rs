//! The step that is not taken because it cannot change which view is removed.

use super::*;
use crate::problems::{Problems, difficult};
use crate::simd::all3;
use crate::views::ViewCamera;
use pulp::Scalar;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const COUNT: usize = 3000;
const SCALES: Scales = Scales { soft: 2.0, cut: 4.0 };

/// Does something with the views of every problem.
fn for_each_problem(problems: &Problems, mut op: impl FnMut(usize, &mut Views<Scalar>)) {
    let view_cameras: Vec<ViewCamera> = problems.cameras.iter().map(ViewCamera::from).collect();
    let mut views = Views::new(Scalar::new(), &view_cameras);
    for i in 0..problems.previous.len() {
        views.gather(&problems.previous, &problems.observations, &[i as u32], true);
        op(i, &mut views);
    }
}

/// No number of pixels is within a focal length of 0: every step is taken.
fn solve(views: &mut Views<Scalar>, start: Start, least_focal: f64) -> Result<Solution, EstimateStatus> {
    let usual = std::mem::replace(&mut views.least_focal, least_focal);
    let mut out = [Err(EstimateStatus::TooFewViews)];
    finish(views, &[start], &TriangulationConfig::default(), SCALES, &mut out);
    views.least_focal = usual;
    out[0]
}

#[test]
fn steps_not_taken_change_no_choice_of_views() {
    let (mut solved, mut elsewhere) = (0, 0);
    for (seed, outliers) in [(1, 0.15), (2, 0.3), (3, 0.5)] {
        let problems = difficult(seed, COUNT, outliers);
        for_each_problem(&problems, |i, views| {
            let mut start = [Start::NONE];
            begin(views, &TriangulationConfig::default(), SCALES, &mut start);
            let (rows, count) = (views.rows.clone(), views.count);
            let short = solve(views, start[0], views.least_focal);
            (views.rows, views.count) = (rows, count);
            match (short, solve(views, start[0], 0.0)) {
                (Ok(a), Ok(b)) => {
                    let m = b.unit_covariance;
                    let sigma = (m.x_axis.x + m.y_axis.y + m.z_axis.z).sqrt();
                    assert_eq!(a.views, b.views, "{seed} {i}");
                    assert!(a.step.distance(b.step) < 1e-5 * sigma, "{seed} {i}: {a:?} {b:?}");
                    solved += 1;
                    elsewhere += usize::from(a.step != b.step);
                }
                (a, b) => assert_eq!(a.err(), b.err(), "{seed} {i}"),
            }
        });
    }
    // Without a view removed after such a step the way is the same.
    assert!(solved > 2 * COUNT && elsewhere > COUNT / 30, "{solved} solved, {elsewhere} by another way");
}

/// Steps of all lengths about points anywhere, near cameras too, and cuts near the worst residual.
#[test]
fn a_certain_outcome_is_the_full_solution() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut certain = 0;
    for_each_problem(&difficult(4, COUNT, 0.3), |i, views| {
        let simd = views.simd;
        let mut any = |size: f64| all3(simd, [(); 3].map(|()| size * rng.random_range(-1.0..1.0)));
        for power in 0..8 {
            let (point, step) = (any(2.0), any(10_f64.powi(-power)));
            let fit = views.reproject(point).0;
            let cut2 = fit.worst * any(1e-2)[0].mul_add(views.number(1.0), views.number(1.0));
            if fit.certain(views, step, cut2).any() {
                let (there, hidden) = views.reproject(plus(point, step));
                let beyond = |fit: &Fit<Scalar>| fit.worst.gt(cut2).any();
                let one_more = there.worst_row.lane(0) == fit.worst_row.lane(0) || !beyond(&fit);
                let hidden = hidden.and_not(views.reproject(point).1).any();
                assert!(one_more && !hidden && beyond(&there) == beyond(&fit), "{i} {power}");
                certain += 1;
            }
        }
    });
    assert!(certain > COUNT, "{certain}");
}
