//! The compute shaders of `shaders/trainer`, each with the shared pieces it needs.

use ffgs_gpu::{Kernel, wgsl};

macro_rules! kernel {
    ($name:ident, $file:literal, [$($piece:expr),*]) => {
        pub(crate) const $name: Kernel = Kernel {
            name: $file,
            source: &[$($piece,)* GROUPS, wgsl!(concat!("trainer/", $file))],
            subgroups: false,
        };
    };
}

const GROUPS: &str = wgsl!("common/groups");
const VIEW: &str = wgsl!("common/view");
const LOSS_STRUCT: &str = wgsl!("common/loss_struct");
const LOSS: &str = wgsl!("common/loss");
const ADAM_STEP: &str = wgsl!("common/adam");
const LEDGER: &str = wgsl!("common/ledger");
const SKY_STRUCT: &str = wgsl!("common/sky_struct");
const PRIOR: &str = wgsl!("common/prior");
const SKY: &str = wgsl!("common/sky");

kernel!(LOSS_STATISTICS, "loss_statistics", [LOSS_STRUCT, LOSS]);
kernel!(LOSS_GRADIENT, "loss_gradient", [LOSS_STRUCT, LOSS]);
kernel!(LOSS_VALUE, "loss_value", [LOSS_STRUCT]);
kernel!(SQUARED_ERROR, "squared_error", [LOSS_STRUCT, LOSS]);
kernel!(ADAM, "adam", [ADAM_STEP, LEDGER]);
kernel!(PRIOR_GEOMETRY, "prior_geometry", [VIEW, LOSS_STRUCT, LEDGER, PRIOR]);
kernel!(PRIOR_COLOURS, "prior_colours", [VIEW, LOSS_STRUCT, LEDGER, PRIOR]);
kernel!(CARRY, "carry", []);
kernel!(ALPHA_PENALTY, "alpha_penalty", [VIEW]);
kernel!(SKY_LAYERS, "sky_layers", [VIEW, SKY_STRUCT, SKY]);
kernel!(SKY_GRADIENT, "sky_gradient", [VIEW, SKY_STRUCT, SKY]);
kernel!(SKY_ADAM, "sky_adam", [SKY_STRUCT, ADAM_STEP]);

/// Every kernel of this crate.
#[cfg(test)]
pub(crate) const ALL: [Kernel; 12] = [
    LOSS_STATISTICS,
    LOSS_GRADIENT,
    LOSS_VALUE,
    SQUARED_ERROR,
    ADAM,
    PRIOR_GEOMETRY,
    PRIOR_COLOURS,
    CARRY,
    ALPHA_PENALTY,
    SKY_LAYERS,
    SKY_GRADIENT,
    SKY_ADAM,
];
