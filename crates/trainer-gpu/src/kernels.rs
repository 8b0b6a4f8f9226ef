//! The compute shaders of `shaders/`, each with the shared pieces it needs.

use ffgs_gpu::{kernels, wgsl};
use ffgs_rasterizer_gpu::{LEDGER, VIEW};

const LOSS_STRUCT: &str = wgsl!("common/loss_struct");
const LOSS: &str = wgsl!("common/loss");
const ADAM_STEP: &str = wgsl!("common/adam");
const SKY_STRUCT: &str = wgsl!("common/sky_struct");
const NATURAL: &str = wgsl!("common/natural");
const PRIOR: &str = wgsl!("common/prior");
const SKY: &str = wgsl!("common/sky");

kernels! {
    LOSS_STATISTICS = "loss_statistics" of 256, [LOSS_STRUCT, LOSS];
    LOSS_GRADIENT = "loss_gradient" of 256, [LOSS_STRUCT, LOSS];
    LOSS_VALUE = "loss_value" of 256, [LOSS_STRUCT];
    SQUARED_ERROR = "squared_error" of 256, [LOSS_STRUCT, LOSS];
    ADAM = "adam" of 256, [ADAM_STEP, LEDGER];
    PRIOR_GEOMETRY = "prior_geometry" of 256, [VIEW, LOSS_STRUCT, LEDGER, PRIOR];
    PRIOR_COLOURS = "prior_colours" of 256, [VIEW, LOSS_STRUCT, LEDGER, PRIOR];
    NATURAL_GEOMETRY = "natural_geometry" of 256, [VIEW, LOSS_STRUCT, LEDGER, PRIOR, ADAM_STEP, NATURAL];
    NATURAL_COLOURS = "natural_colours" of 256, [VIEW, LOSS_STRUCT, LEDGER, PRIOR, ADAM_STEP, NATURAL];
    CARRY = "carry" of 256, [];
    ALPHA_PENALTY = "alpha_penalty" of 256, [VIEW];
    SKY_LAYERS = "sky_layers" of 256, [VIEW, SKY_STRUCT, SKY];
    SKY_GRADIENT = "sky_gradient" of 256, [VIEW, SKY_STRUCT, SKY];
    SKY_ADAM = "sky_adam" of 256, [SKY_STRUCT, ADAM_STEP];
}
