//! The conformance suite of methods.

use super::in_1_and_8_threads;
use super::world::World;
use ffgs_core::{Scene, StageLog};
use ffgs_method::{MotionMethod, TrackSource};
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// Gaussians of the world that methods are tried on.
const COUNT: usize = 120;
/// What of a place (m) is rounding: f32 keeps 6e-8 of half a metre, and solvers stop at a hundredth of a pixel, which
/// is a third of a millimetre here.
const ROUNDING: f64 = 5e-4;

/// A method as the suite makes it, from the trackers of a run.
pub(crate) type Build<'a> =
    dyn for<'t> Fn(&'t [Box<dyn TrackSource>]) -> Box<dyn MotionMethod + 't> + Sync + 'a;

/// What a [`MotionMethod`] owes: identity motion moves nothing; the order of the Gaussians decides nothing; empty scenes,
/// masks and tracks are no error; 1 and 8 threads give equal bytes; a restored method goes on as one that never stopped.
pub fn motion_method(name: &str, build: &Build) {
    identity_motion_moves_nothing(name, build);
    the_order_of_gaussians_decides_nothing(name, build);
    empty_inputs_are_no_error(name, build);
    threads_give_equal_bytes(name, build);
    restored_is_never_stopped(name, build);
}

/// The scene after `steps` predictions.
fn run(
    build: &Build,
    world: &World,
    tracks: &[Box<dyn TrackSource>],
    order: &[usize],
    steps: usize,
) -> Scene {
    let mut scene = world.scene(order);
    let mut method = build(tracks);
    method.begin(&scene).expect("the first frame");
    for frame in 1..=steps {
        predict(&mut *method, world, tracks, frame, &mut scene);
    }
    scene
}

fn predict(
    method: &mut dyn MotionMethod,
    world: &World,
    tracks: &[Box<dyn TrackSource>],
    frame: usize,
    scene: &mut Scene,
) {
    let predicted =
        world.with_step(frame, tracks, |step| method.predict(step, scene, &mut StageLog::default()));
    predicted.unwrap_or_else(|error| panic!("frame {frame}: {error:#}"));
}

/// Place of every Gaussian by its id.
fn places(scene: &Scene) -> BTreeMap<u32, DVec3> {
    let dynamic = &scene.dynamic;
    let places = dynamic.gaussians.positions();
    assert!(places.iter().all(|place| place.is_finite()), "a place is not finite");
    assert_eq!(dynamic.ids.len(), places.len(), "one id per Gaussian");
    dynamic.ids.iter().copied().zip(places).collect()
}

fn in_order() -> Vec<usize> {
    (0..COUNT).collect()
}

fn identity_motion_moves_nothing(name: &str, build: &Build) {
    let world = World::new(COUNT, DVec3::ZERO);
    let moved = places(&run(build, &world, &[world.tracker()], &in_order(), 2));
    for (id, place) in places(&world.scene(&in_order())) {
        let now =
            moved.get(&id).unwrap_or_else(|| panic!("{name}: Gaussian {id}, which stood still, is gone"));
        let far = now.distance(place);
        assert!(far < ROUNDING, "{name}: nothing moved, but Gaussian {id} went {far} m");
    }
}

fn the_order_of_gaussians_decides_nothing(name: &str, build: &Build) {
    let world = World::new(COUNT, DVec3::new(0.02, 0.01, 0.0));
    // 37 and 120 have no common divisor: every index once.
    let order: Vec<usize> = (0..COUNT).map(|i| 37 * i % COUNT).collect();
    let [one, other] =
        [in_order(), order].map(|order| places(&run(build, &world, &[world.tracker()], &order, 1)));
    for (id, place) in one.iter().filter(|(id, _)| (**id as usize) < COUNT) {
        let far = other.get(id).map_or(f64::INFINITY, |there| there.distance(*place));
        assert!(far < ROUNDING, "{name}: Gaussian {id} ends {far} m elsewhere in another order");
    }
}

fn empty_inputs_are_no_error(name: &str, build: &Build) {
    let world = World::new(COUNT, DVec3::new(0.02, 0.0, 0.0));
    let mut unmasked = world.clone();
    unmasked.masked = false;
    let nothing = run(build, &world, &[world.tracker()], &[], 2);
    assert!(nothing.dynamic.gaussians.is_empty(), "{name}: Gaussians came out of an empty scene");
    places(&run(build, &unmasked, &[world.tracker()], &in_order(), 2));
    places(&run(build, &world, &[world.silent_tracker()], &in_order(), 2));
}

fn threads_give_equal_bytes(name: &str, build: &Build) {
    let world = World::new(COUNT, DVec3::new(0.02, 0.01, 0.0));
    let [one, eight] = in_1_and_8_threads(|| bits(&run(build, &world, &[world.tracker()], &in_order(), 2)));
    assert!(one == eight, "{name}: 1 and 8 threads give different bytes");
}

fn restored_is_never_stopped(name: &str, build: &Build) {
    let world = World::new(COUNT, DVec3::new(0.02, 0.01, 0.0));
    let tracks = [world.tracker()];
    let mut scene = world.scene(&in_order());
    let mut first = build(&tracks);
    first.begin(&scene).expect("the first frame");
    predict(&mut *first, &world, &tracks, 1, &mut scene);
    let mut method = build(&tracks);
    method.restore(&first.save(), &scene).expect("a saved state is restored");
    predict(&mut *method, &world, &tracks, 2, &mut scene);
    let whole = run(build, &world, &tracks, &in_order(), 2);
    assert!(
        bits(&scene) == bits(&whole),
        "{name}: a restored method ends elsewhere than one that never stopped"
    );
}

/// Every number of the dynamic layer.
fn bits(scene: &Scene) -> Vec<u64> {
    let dynamic = &scene.dynamic;
    let g = &dynamic.gaussians;
    let columns =
        [g.means.as_flattened(), g.quats.as_flattened(), g.log_scales.as_flattened(), &g.opacity_logits];
    let singles = columns.into_iter().flatten().chain(g.sh.as_flattened()).map(|v| u64::from(v.to_bits()));
    let covariances = dynamic.covariances.iter().flat_map(DMat3::to_cols_array);
    let steps = dynamic.steps.iter().flat_map(DVec3::to_array);
    let doubles = covariances.chain(steps).map(f64::to_bits);
    singles.chain(doubles).chain(dynamic.ids.iter().map(|id| u64::from(*id))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Result;
    use ffgs_method::Step;

    /// What a broken method does wrong.
    #[derive(Clone, Copy, PartialEq)]
    enum Wrong {
        Nothing,
        Drifts,
        GoesByIndex,
        GoesByThreads,
        Forgets,
    }

    #[derive(Clone, Copy)]
    struct Broken {
        wrong: Wrong,
        frames: f32,
    }

    impl MotionMethod for Broken {
        fn predict(&mut self, _: &Step, scene: &mut Scene, _: &mut StageLog) -> Result<()> {
            self.frames += 1.0;
            for (i, mean) in scene.dynamic.gaussians.means.iter_mut().enumerate() {
                mean[0] += match self.wrong {
                    Wrong::Nothing => 0.0,
                    Wrong::Drifts => 0.01,
                    Wrong::GoesByIndex => 1e-5 * i as f32,
                    Wrong::GoesByThreads => 1e-6 * rayon::current_num_threads() as f32,
                    Wrong::Forgets => 1e-6 * self.frames,
                };
            }
            Ok(())
        }
    }

    fn broken(wrong: Wrong) -> Box<dyn MotionMethod> {
        Box::new(Broken { wrong, frames: 0.0 })
    }

    fn suite(wrong: Wrong) {
        motion_method("broken", &|_| broken(wrong));
    }

    #[test]
    fn a_method_that_leaves_all_as_it_is_conforms() {
        suite(Wrong::Nothing);
    }

    #[test]
    #[should_panic(expected = "nothing moved, but Gaussian 0 went 0.02")]
    fn a_method_that_drifts_is_found() {
        suite(Wrong::Drifts);
    }

    #[test]
    #[should_panic(expected = "elsewhere in another order")]
    fn a_method_that_goes_by_the_index_is_found() {
        the_order_of_gaussians_decides_nothing("broken", &|_| broken(Wrong::GoesByIndex));
    }

    #[test]
    #[should_panic(expected = "1 and 8 threads")]
    fn a_method_that_depends_on_threads_is_found() {
        suite(Wrong::GoesByThreads);
    }

    #[test]
    #[should_panic(expected = "never stopped")]
    fn a_method_that_forgets_its_state_is_found() {
        suite(Wrong::Forgets);
    }
}
