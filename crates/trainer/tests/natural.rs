//! Steps along the natural gradient, on losses whose minimum is known.

use ffgs_core::Gaussians;
use ffgs_rasterizer::Information;
use ffgs_trainer::{Adam, Damping, LearningRates, PixelNoise, Prior, expected_gain};
use glam::{DMat3, DQuat, DVec3};

const PIXELS: usize = 100;
const FAR: LearningRates =
    LearningRates { means: 1e3, quats: 1e3, scales: 1e3, opacities: 1e3, sh0: 1e3, sh_rest: 1e3 };

fn known() -> Information {
    let mut others = Gaussians::zeros(2, 1);
    others.quats.fill([0.0, 40.0, 9.0, 25.0]);
    others.log_scales.fill([3.0, 5.0, 8.0]);
    others.opacity_logits.fill(7.0);
    others.sh.fill([2.0, 30.0, 11.0]);
    let block = DMat3::from_cols_array(&[30.0, 10.0, 5.0, 10.0, 40.0, 2.0, 5.0, 2.0, 20.0]);
    Information { positions: vec![block; 2], others }
}

fn prior(information: &Information) -> Prior<'_> {
    Prior {
        information,
        noise: PixelNoise { sigma: 0.1, correlated: 5.0 },
        weight: 1.0,
        curvature: information,
    }
}

fn start() -> Gaussians {
    let mut g = Gaussians::zeros(2, 1);
    let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.7).as_quat();
    // Twice as long as a unit quaternion.
    g.quats.fill([turn.w, turn.x, turn.y, turn.z].map(|v| 2.0 * v));
    g.means.fill([0.4, -0.2, 0.3]);
    g
}

/// After one step of the whole way from `start`, of the first Gaussian alone, where the loss is the penalty of the prior.
fn stepped(
    information: &Information,
    goal: &Gaussians,
    damping: Damping,
    rates: &LearningRates,
) -> Gaussians {
    let (prior, mut now) = (prior(information), start());
    let gradient = prior.pull(goal, vec![3; 2], &now, PIXELS, &[true; 2]);
    let curvature = prior.curvature(damping, &[3; 2], PIXELS);
    Adam::new(2, 1).step_naturally(&mut now, &gradient, (1.0, rates), curvature, &[true, false]);
    now
}

fn close(a: &[f32], b: &[f32]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4)
}

/// One step of Newton's method ends at the minimum of a parabola, whatever the units of its parameters.
#[test]
fn a_whole_step_ends_at_the_minimum_that_the_information_predicts() {
    let (information, mut goal) = (known(), start());
    goal.means.fill([0.1, 0.5, -0.3]);
    let turn = |q: &mut [f32; 4]| {
        *q = [q[0] - 0.006 * q[1], q[1] + 0.006 * q[0], q[2] + 0.006 * q[3], q[3] - 0.006 * q[2]];
    };
    goal.quats.iter_mut().for_each(turn);
    goal.log_scales.fill([0.5, -1.0, 0.2]);
    goal.opacity_logits.fill(1.5);
    goal.sh.fill([0.3, -0.4, 0.7]);
    let now = stepped(&information, &goal, Damping::default(), &FAR);
    assert!(close(&now.means[0], &goal.means[0]), "{:?}", now.means);
    assert!(close(&now.quats[0], &goal.quats[0]), "{:?} {:?}", now.quats, goal.quats);
    assert!(close(&now.log_scales[0], &goal.log_scales[0]) && close(&now.opacity_logits[..1], &[1.5]));
    assert!(close(now.sh[..4].as_flattened(), goal.sh[..4].as_flattened()));
    assert!(now.select(&[1]) == start().select(&[1]), "not touched");
}

/// Where the loss is a parabola, half the squared Newton decrement is what lies between here and the minimum.
#[test]
fn the_expected_gain_is_the_way_down_to_the_minimum() {
    let (information, mut goal) = (known(), start());
    goal.means = vec![[0.1, 0.5, -0.3], [9.0, 9.0, 9.0]];
    let prior = prior(&information);
    let gradient = prior.pull(&goal, vec![3; 2], &start(), PIXELS, &[true; 2]);
    let curvature = prior.curvature(Damping::default(), &[3; 2], PIXELS);
    let gain = |adam: &Adam| expected_gain(&adam.first_moments().means, adam.steps(), curvature);
    let mut adam = Adam::new(2, 1);
    assert_eq!(gain(&adam), None, "no step was taken");
    // The second Gaussian was never seen: it does not count.
    for _ in 0..3 {
        adam.step_naturally(&mut start(), &gradient, (1.0, &FAR), curvature, &[true, false]);
    }
    let way = DVec3::new(0.3, -0.7, 0.6);
    let want = 0.5 * way.dot(information.positions[0] * way);
    assert!((gain(&adam).unwrap() / want - 1.0).abs() < 1e-4, "{:?}, {want}", gain(&adam));
    let damped = prior.curvature(Damping { means: 1e6, ..Damping::default() }, &[3; 2], PIXELS);
    let damped = expected_gain(&adam.first_moments().means, adam.steps(), damped).unwrap();
    assert!(damped < 1e-2 * want, "{damped}");
    let broken = [[f32::NAN; 3]; 2];
    assert_eq!(expected_gain(&broken, adam.steps(), curvature), None, "not a number");
}

/// What nothing is known of gets no derivative of infinite worth, and no step is longer than three rates.
#[test]
fn steps_are_damped_and_limited() {
    let (information, mut goal) = (known(), start());
    goal.log_scales.fill([0.5, -1.0, 0.2]);
    let damping = Damping { scales: 3.0, ..Damping::default() };
    let now = stepped(&information, &goal, damping, &FAR);
    assert!(close(&now.log_scales[0], &[0.25, -5.0 / 8.0, 0.2 * 8.0 / 11.0]), "{:?}", now.log_scales);
    let now = stepped(&information, &goal, Damping::default(), &LearningRates { scales: 0.1, ..FAR });
    assert!(close(&now.log_scales[0], &[0.3, -0.3, 0.2]), "{:?}", now.log_scales);

    let nothing = Information { positions: vec![DMat3::ZERO; 2], others: Gaussians::zeros(2, 1) };
    let (prior, mut now) = (prior(&nothing), start());
    let mut gradient = Gaussians::zeros(2, 1);
    gradient.means.fill([1e-3, 0.0, -1e-3]);
    gradient.opacity_logits.fill(f32::NAN);
    let curvature = prior.curvature(Damping::new(&nothing), &[0; 2], PIXELS);
    let rates = LearningRates::with_means(0.01);
    Adam::new(2, 1).step_naturally(&mut now, &gradient, (0.3, &rates), curvature, &[true; 2]);
    assert!(close(&now.means[0], &[0.37, -0.2, 0.33]), "{:?}", now.means);
    assert_eq!(now.opacity_logits, start().opacity_logits);
}

#[test]
fn damping_is_a_tenth_of_what_is_known_on_the_whole() {
    let mut information = known();
    // The second Gaussian was just born.
    information.positions[1] = DMat3::ZERO;
    information.others.log_scales[1] = [0.0; 3];
    let damping = Damping::new(&information);
    assert!((damping.means - 3.0).abs() < 1e-6 && (damping.scales - 16.0 / 30.0).abs() < 1e-6, "{damping:?}");
    assert!((damping.opacities - 0.7).abs() < 1e-6 && (damping.turns - 74.0 / 30.0).abs() < 1e-6);
}
