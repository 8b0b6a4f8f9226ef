//! A GPU as a training backend: what every backend owes, by the assertions that the CPU passes.

#[path = "../../trainer/tests/suite/mod.rs"]
mod suite;

use ffgs_gpu::Gpu;
use ffgs_rasterizer_gpu::SceneDevice;
use ffgs_trainer_gpu::GpuBackend;
use suite::backend_suite;

backend_suite! {
    {
        #[ignore = "needs a GPU"]
    }
    &GpuBackend(&SceneDevice::new(Gpu::for_test()));
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
