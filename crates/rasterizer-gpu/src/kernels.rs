//! The compute shaders of `shaders/rasterizer`, each with the shared pieces it needs.

use ffgs_gpu::Kernel;

/// Text of a shader file, taken at build time: a missing file does not build, and an old one cannot be shipped.
macro_rules! wgsl {
    ($path:expr) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shaders/", $path, ".wgsl"))
    };
}

macro_rules! kernel {
    ($name:ident, $file:literal, [$($piece:expr),*]) => {
        pub(crate) const $name: Kernel = Kernel {
            name: $file,
            source: &[$($piece,)* GROUPS, wgsl!(concat!("rasterizer/", $file))],
            subgroups: false,
        };
    };
}

const GROUPS: &str = wgsl!("common/groups");
const VIEW: &str = wgsl!("common/view");
const PLAN: &str = wgsl!("common/plan");
const SCAN: &str = wgsl!("common/scan_group");
const SH: &str = wgsl!("common/spherical_harmonics");
const EWA: &str = wgsl!("common/ewa");
const WALK: &str = wgsl!("common/walk");
const REDUCE: &str = wgsl!("common/reduce_shared");
const LEDGER: &str = wgsl!("common/ledger");

kernel!(PROJECT, "project", [VIEW, SH, EWA]);
kernel!(RANK_COUNTS, "rank_counts", [VIEW]);
kernel!(SCAN_BLOCKS, "scan_blocks", [PLAN, SCAN]);
kernel!(SCAN_SPINE, "scan_spine", [PLAN, SCAN]);
kernel!(SCAN_APPLY, "scan_apply", [PLAN, SCAN]);
kernel!(SORT_COUNT, "sort_count", [PLAN]);
kernel!(SORT_SCATTER, "sort_scatter", [PLAN]);
kernel!(PLAN_PAIRS, "plan_pairs", [VIEW, PLAN]);
kernel!(EMIT_PAIRS, "emit_pairs", [VIEW]);
kernel!(TILE_RANGES, "tile_ranges", [PLAN]);
kernel!(BLEND, "blend", [VIEW, WALK]);
kernel!(BLEND_BACKWARD, "blend_backward", [VIEW, WALK, REDUCE]);
kernel!(TILE_DEPTHS, "tile_depths", [VIEW]);
kernel!(BLEND_SPLIT, "blend_split", [VIEW, WALK]);
kernel!(PROJECTION_BACKWARD, "projection_backward", [VIEW, SH, EWA, LEDGER]);

/// Every kernel of this crate.
#[cfg(test)]
pub(crate) const ALL: [Kernel; 15] = [
    PROJECT,
    RANK_COUNTS,
    SCAN_BLOCKS,
    SCAN_SPINE,
    SCAN_APPLY,
    SORT_COUNT,
    SORT_SCATTER,
    PLAN_PAIRS,
    EMIT_PAIRS,
    TILE_RANGES,
    BLEND,
    BLEND_BACKWARD,
    PROJECTION_BACKWARD,
    TILE_DEPTHS,
    BLEND_SPLIT,
];
