//! The CPU as a training backend: what every backend owes, and that no result depends on the number of threads.

mod suite;

use ffgs_core::{Gaussians, SkyCube};
use ffgs_trainer::{CpuBackend, DynamicLaneConfig, FirstFrame, StaticMethod};
use suite::{World, backend_suite, first_frame, world};

backend_suite! {
    {} &CpuBackend;
    a_step_of_the_dynamic_lane_goes_against_the_slope_of_the_loss,
    the_dynamic_lane_brings_a_disturbed_layer_back,
    natural_steps_lead_to_the_true_places,
    what_has_settled_takes_fewer_steps,
    both_methods_of_the_static_lane_restore_colours,
    the_sky_lane_restores_texels,
    the_first_frame_comes_nearer_to_the_photographs,
    what_is_fixed_stays,
    equal_inputs_give_equal_bytes,
    no_step_changes_nothing,
}

/// Every lane, with few steps, in the memory of its results.
fn all_lanes(world: &World) -> (Gaussians, Vec<Gaussians>, SkyCube, FirstFrame) {
    let mut moving = world.disturbed();
    let config = DynamicLaneConfig { iterations: 20, ..DynamicLaneConfig::default() };
    world.train(&CpuBackend, &config, &mut moving);
    let fixed = [StaticMethod::Solve, StaticMethod::Steps].map(|method| world.recolour(&CpuBackend, method));
    let mut sky = SkyCube::filled(8, [0.5; 3]);
    world.train_sky(&CpuBackend, &mut sky);
    (moving, fixed.to_vec(), sky, first_frame(&CpuBackend, world))
}

#[test]
fn no_lane_depends_on_the_number_of_threads() {
    let world = world();
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| all_lanes(&world))
    };
    let (one, three) = (run(1), run(3));
    assert!(one.0 == three.0, "dynamic");
    assert!(one.1 == three.1, "static");
    assert!(one.2.texels == three.2.texels, "sky");
    assert!(one.3.gaussians == three.3.gaussians && one.3.sky.texels == three.3.sky.texels, "first frame");
}
