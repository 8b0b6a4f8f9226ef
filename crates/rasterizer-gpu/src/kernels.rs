//! The compute shaders of `shaders/`, each with the shared pieces it needs.

use ffgs_gpu::{kernels, wgsl};

/// What a kernel knows of a view, for kernels of other crates.
pub const VIEW: &str = wgsl!("common/view");
const PLAN: &str = wgsl!("common/plan");
const SCAN: &str = wgsl!("common/scan_group");
const SH: &str = wgsl!("common/spherical_harmonics");
const EXPANSION: &str = wgsl!("common/expansion");
const EWA: &str = wgsl!("common/ewa");
const WALK: &str = wgsl!("common/walk");
const PARTS: &str = wgsl!("common/parts");
const BACKWARD: &str = wgsl!("common/backward");
const SUMS: &str = wgsl!("common/footprint");
const SHARED: &str = wgsl!("common/reduce_shared");
const SUBGROUPS: &str = wgsl!("common/reduce_subgroups");
/// What training keeps of every Gaussian, likewise.
pub const LEDGER: &str = wgsl!("common/ledger");

kernels! {
    PROJECT = "project" of 256, [VIEW, SH, EXPANSION, EWA];
    RANK_COUNTS = "rank_counts" of 256, [VIEW];
    SCAN_BLOCKS = "scan_blocks" of 256, [PLAN, SCAN];
    SCAN_SPINE = "scan_spine" of 256, [PLAN, SCAN];
    SCAN_APPLY = "scan_apply" of 256, [PLAN, SCAN];
    SCAN_SINGLE = "scan_single" of 256, [PLAN, SCAN];
    SORT_COUNT = "sort_count" of 256, [PLAN];
    SORT_SCATTER = "sort_scatter" of 256, [PLAN];
    PLAN_PAIRS = "plan_pairs" of 1, [VIEW, PLAN];
    EMIT_PAIRS = "emit_pairs" of 256, [VIEW];
    TILE_RANGES = "tile_ranges" of 256, [PLAN];
    BLEND = "blend" of 64, [VIEW, WALK, PARTS];
    BLEND_BACKWARD = "blend_backward" of 64, [VIEW, WALK, PARTS, SHARED, BACKWARD];
    BLEND_BACKWARD_SUBGROUPS = "blend_backward_subgroups" of 64, [VIEW, WALK, PARTS, SUBGROUPS, BACKWARD], subgroups;
    FOOTPRINT = "footprint" of 64, [VIEW, WALK, PARTS, SHARED, SUMS];
    FOOTPRINT_SUBGROUPS = "footprint_subgroups" of 64, [VIEW, WALK, PARTS, SUBGROUPS, SUMS], subgroups;
    FOOTPRINT_TOTALS = "footprint_totals" of 256, [VIEW];
    TOP_CONTRIBUTORS = "top_contributors" of 64, [VIEW, WALK];
    COUNT_VIEWS = "count_views" of 256, [VIEW];
    TILE_DEPTHS = "tile_depths" of 256, [VIEW];
    BLEND_SPLIT = "blend_split" of 64, [VIEW, WALK];
    PROJECTION_BACKWARD = "projection_backward" of 256, [VIEW, SH, EXPANSION, EWA, LEDGER];
}
