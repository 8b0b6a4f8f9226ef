//! The compute shaders of `shaders/rasterizer`, each with the shared pieces it needs.

use ffgs_gpu::{Kernel, wgsl};

macro_rules! kernel {
    ($name:ident, $file:literal, [$($piece:expr),*]) => {
        kernel!($name, $file, [$($piece),*], subgroups = false);
    };
    ($name:ident, $file:literal, [$($piece:expr),*], subgroups = $subgroups:literal) => {
        pub(crate) const $name: Kernel = Kernel {
            name: $file,
            source: &[$($piece,)* GROUPS, wgsl!(concat!("rasterizer/", $file))],
            subgroups: $subgroups,
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
const BACKWARD: &str = wgsl!("common/backward");
const SUMS: &str = wgsl!("common/footprint");
const SHARED: &str = wgsl!("common/reduce_shared");
const SUBGROUPS: &str = wgsl!("common/reduce_subgroups");
const LEDGER: &str = wgsl!("common/ledger");

kernel!(PROJECT, "project", [VIEW, SH, EWA]);
kernel!(RANK_COUNTS, "rank_counts", [VIEW]);
kernel!(SCAN_BLOCKS, "scan_blocks", [PLAN, SCAN]);
kernel!(SCAN_SPINE, "scan_spine", [PLAN, SCAN]);
kernel!(SCAN_APPLY, "scan_apply", [PLAN, SCAN]);
kernel!(SCAN_SINGLE, "scan_single", [PLAN, SCAN]);
kernel!(SORT_COUNT, "sort_count", [PLAN]);
kernel!(SORT_SCATTER, "sort_scatter", [PLAN]);
kernel!(PLAN_PAIRS, "plan_pairs", [VIEW, PLAN]);
kernel!(EMIT_PAIRS, "emit_pairs", [VIEW]);
kernel!(TILE_RANGES, "tile_ranges", [PLAN]);
kernel!(BLEND, "blend", [VIEW, WALK]);
kernel!(BLEND_BACKWARD, "blend_backward", [VIEW, WALK, SHARED, BACKWARD]);
kernel!(
    BLEND_BACKWARD_SUBGROUPS,
    "blend_backward_subgroups",
    [VIEW, WALK, SUBGROUPS, BACKWARD],
    subgroups = true
);
kernel!(FOOTPRINT, "footprint", [VIEW, WALK, SHARED, SUMS]);
kernel!(FOOTPRINT_SUBGROUPS, "footprint_subgroups", [VIEW, WALK, SUBGROUPS, SUMS], subgroups = true);
kernel!(FOOTPRINT_TOTALS, "footprint_totals", [VIEW]);
kernel!(TOP_CONTRIBUTORS, "top_contributors", [VIEW, WALK]);
kernel!(COUNT_VIEWS, "count_views", [VIEW]);
kernel!(TILE_DEPTHS, "tile_depths", [VIEW]);
kernel!(BLEND_SPLIT, "blend_split", [VIEW, WALK]);
kernel!(PROJECTION_BACKWARD, "projection_backward", [VIEW, SH, EWA, LEDGER]);

/// Every kernel of this crate.
#[cfg(test)]
pub(crate) const ALL: [Kernel; 22] = [
    PROJECT,
    RANK_COUNTS,
    SCAN_BLOCKS,
    SCAN_SPINE,
    SCAN_APPLY,
    SCAN_SINGLE,
    SORT_COUNT,
    SORT_SCATTER,
    PLAN_PAIRS,
    EMIT_PAIRS,
    TILE_RANGES,
    BLEND,
    BLEND_BACKWARD,
    BLEND_BACKWARD_SUBGROUPS,
    FOOTPRINT,
    FOOTPRINT_SUBGROUPS,
    FOOTPRINT_TOTALS,
    TOP_CONTRIBUTORS,
    PROJECTION_BACKWARD,
    COUNT_VIEWS,
    TILE_DEPTHS,
    BLEND_SPLIT,
];
