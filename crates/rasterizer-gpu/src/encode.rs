//! The order of the kernels: projection, sort by depth, binning to tiles, blending, and the backward pass.

use crate::layout::plan;
use crate::scene::{GpuGradients, GpuScene};
use crate::scratch::{BLOCK, DIGIT_BITS, DIGITS, Scratch};
use crate::view::GpuView;
use crate::{kernels, layout::ViewUniform};
use ffgs_core::PixelFilter;
use ffgs_gpu::{Buffer, Commands, Gpu, Groups};
use ffgs_rasterizer::{Dropout, RenderOptions};

/// Up to this many values one workgroup scans alone: 4 rounds, for which three kernels are not worth their start.
const SHORT: usize = 4 * BLOCK;

/// Writes what changes between renders of a view. `stamp` is the number of the training step.
pub fn prepare(
    gpu: &Gpu,
    scene: &GpuScene,
    view: &GpuView,
    scratch: &Scratch,
    options: RenderOptions,
    stamp: u32,
) {
    let degree = options.sh_degree.map_or(scene.sh_degree, |d| d.min(scene.sh_degree));
    let constants = ViewUniform {
        count: scene.count as u32,
        sh_degree: degree as u32,
        sh_stride: ffgs_core::sh_coefficients(scene.sh_degree) as u32,
        antialiased: u32::from(scene.filter == PixelFilter::Compensated),
        span_capacity: scratch.capacity.spans as u32,
        pair_capacity: scratch.capacity.pairs as u32,
        stamp,
        dropout_threshold: options.dropout.map_or(0, Dropout::threshold),
        dropout_draw: options.dropout.map_or(0, |dropout| dropout.draw),
        dropout_gain: options.dropout.map_or(1.0, Dropout::gain),
        beyond: if options.at_centres { 0.0 } else { 1.0 },
        ..view.constants
    };
    gpu.write(&view.uniform, &[constants]);
}

/// Renders into `scratch.pixels`.
pub fn render(commands: &mut Commands, scene: &GpuScene, view: &GpuView, scratch: &Scratch) {
    bin_to_tiles(commands, scene, view, scratch);
    let s = scratch;
    let buffers =
        [&view.uniform, &s.splats, &s.list, &view.slots, &view.layers, &s.pixels, &s.last, &s.entries];
    commands.run(&kernels::BLEND, &buffers, Groups::of(view.slots(), 1));
}

/// Everything before blending: the depth-ordered list of each tile.
pub fn bin_to_tiles(commands: &mut Commands, scene: &GpuScene, view: &GpuView, scratch: &Scratch) {
    let (s, n) = (scratch, scene.count);
    let order = &s.keys[0];
    commands.clear(&s.spans_used);
    let project = [
        &view.uniform,
        &scene.geometry,
        &scene.sh,
        &view.tile_slots,
        &s.splats,
        order,
        &s.extents,
        &s.spans,
        &s.spans_used,
    ];
    commands.run(&kernels::PROJECT, &project, Groups::Items(n));
    sort_by_depth(commands, s, n);
    let ranks = [&view.uniform, order, &s.extents, &s.counts, &view.slots];
    commands.run(&kernels::RANK_COUNTS, &ranks, Groups::Items(n.max(view.slots())));
    let job = &s.jobs.scan_gaussians;
    scan(commands, s, job, &s.counts, Groups::of(n, BLOCK));
    commands.run(&kernels::PLAN_PAIRS, &[&view.uniform, &s.spans_used, &s.sums, &s.plan], Groups::Direct(1));
    let emit = [
        &view.uniform,
        order,
        &s.counts,
        &s.spans,
        &view.tile_slots,
        &s.extents,
        &s.pairs[0],
        &s.pair_splats,
    ];
    commands.run(&kernels::EMIT_PAIRS, &emit, Groups::Items(n));
    let sorted = sort_by_tile(commands, s, view.slots());
    let ranges = [&s.plan, sorted, &s.pair_splats, &s.list, &view.slots];
    commands.run(&kernels::TILE_RANGES, &ranges, each_pair(s));
}

fn each_pair(s: &Scratch) -> Groups<'_> {
    Groups::Indirect(&s.plan, u64::from(plan::EACH) * 4)
}

/// The histogram of a sort of at most `items` items.
fn scan_histogram(commands: &mut Commands, s: &Scratch, job: &Buffer, items: usize, groups: Groups) {
    if DIGITS * items.div_ceil(BLOCK) <= SHORT {
        commands.run(&kernels::SCAN_SINGLE, &[job, &s.plan, &s.histogram], Groups::Direct(1));
    } else {
        scan(commands, s, job, &s.histogram, groups);
    }
}

fn scan(commands: &mut Commands, s: &Scratch, job: &Buffer, values: &Buffer, groups: Groups) {
    commands.run(&kernels::SCAN_BLOCKS, &[job, &s.plan, values, &s.sums], groups);
    commands.run(&kernels::SCAN_SPINE, &[job, &s.plan, &s.sums], Groups::Direct(1));
    commands.run(&kernels::SCAN_APPLY, &[job, &s.plan, &s.sums, values], groups);
}

/// All 32 bits in an even number of passes: the result is where it started.
pub(crate) fn sort_by_depth(commands: &mut Commands, s: &Scratch, n: usize) {
    let [a, b] = &s.keys;
    let histogram = Groups::of(DIGITS * n.div_ceil(BLOCK), BLOCK);
    for (pass, job) in s.jobs.sort_gaussians.iter().enumerate() {
        let (from, to) = if pass % 2 == 0 { (a, b) } else { (b, a) };
        commands.run(&kernels::SORT_COUNT, &[job, &s.plan, from, &s.histogram], Groups::of(n, BLOCK));
        scan_histogram(commands, s, &s.jobs.histogram_of_gaussians, n, histogram);
        commands.run(&kernels::SORT_SCATTER, &[job, &s.plan, &s.histogram, from, to], Groups::of(n, BLOCK));
    }
}

/// As many bits as the slots have; returns where the result is.
fn sort_by_tile<'a>(commands: &mut Commands, s: &'a Scratch, slots: usize) -> &'a Buffer {
    let [a, b] = &s.pairs;
    let passes = bits_of(slots).div_ceil(DIGIT_BITS) as usize;
    let groups = || Groups::Indirect(&s.plan, u64::from(plan::SORT) * 4);
    for (pass, job) in s.jobs.sort_pairs[..passes].iter().enumerate() {
        let (from, to) = if pass % 2 == 0 { (a, b) } else { (b, a) };
        commands.run(&kernels::SORT_COUNT, &[job, &s.plan, from, &s.histogram], groups());
        let histogram = Groups::Indirect(&s.plan, u64::from(plan::SCAN) * 4);
        scan_histogram(commands, s, &s.jobs.histogram_of_pairs, s.capacity.pairs, histogram);
        commands.run(&kernels::SORT_SCATTER, &[job, &s.plan, &s.histogram, from, to], groups());
    }
    &s.pairs[passes % 2]
}

/// Bits that tell `count` values apart.
fn bits_of(count: usize) -> u32 {
    usize::BITS - count.saturating_sub(1).leading_zeros()
}

/// Nearest depth per computed tile of the splats that were binned last, into `depths` (one f32 per slot); empty tiles take that of the
/// closest tiles that are not.
pub fn tile_depths(commands: &mut Commands, view: &GpuView, scratch: &Scratch, depths: &Buffer) {
    let s = scratch;
    let buffers = [&view.uniform, &s.splats, &s.list, &view.slots, &view.tile_slots, depths];
    commands.run(&kernels::TILE_DEPTHS, &buffers, Groups::Items(view.slots()));
}

/// Adds 1 to `counts` (u32 per Gaussian) for every Gaussian with a splat among those binned last.
pub fn count_views(
    commands: &mut Commands,
    scene: &GpuScene,
    view: &GpuView,
    scratch: &Scratch,
    counts: &Buffer,
) {
    let buffers = [&view.uniform, &scratch.extents, counts];
    commands.run(&kernels::COUNT_VIEWS, &buffers, Groups::Items(scene.count));
}

/// Blends the splats that were binned last into the layers of `view`, cut at `depths`: nearer splats in front, the rest over
/// the background that the layers hold.
pub fn render_split(commands: &mut Commands, view: &GpuView, scratch: &Scratch, depths: &Buffer) {
    let s = scratch;
    let buffers = [&view.uniform, &s.splats, &s.list, &view.slots, depths, &view.layers];
    commands.run(&kernels::BLEND_SPLIT, &buffers, Groups::of(view.slots(), 1));
}

/// Adds the derivatives of the loss whose derivative by the last render's pixels is `scratch.upstream`.
pub fn backward(
    commands: &mut Commands,
    scene: &GpuScene,
    view: &GpuView,
    scratch: &Scratch,
    gradients: &GpuGradients,
) {
    let s = scratch;
    let blend = [
        &view.uniform,
        &s.splats,
        &s.list,
        &view.slots,
        &view.layers,
        &s.pixels,
        &s.last,
        &s.upstream,
        &s.entries,
    ];
    let kernel = commands.pick(&kernels::BLEND_BACKWARD, &kernels::BLEND_BACKWARD_SUBGROUPS);
    commands.run(kernel, &blend, Groups::of(view.parts(), 1));
    let project = [
        &view.uniform,
        &scene.geometry,
        &scene.sh,
        &s.extents,
        &s.entries,
        &gradients.scene.geometry,
        &gradients.scene.sh,
        &gradients.ledger,
        &gradients.pose,
    ];
    commands.run(&kernels::PROJECTION_BACKWARD, &project, Groups::Items(scene.count));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scratch::Capacity;

    /// Around the edges of a block, and long enough for the scan in three kernels.
    #[test]
    #[ignore = "needs a GPU"]
    fn the_radix_sort_is_the_standard_stable_sort() {
        let gpu = Gpu::for_test();
        for n in [1, 1023, 1024, 1025, 300_000] {
            let key = |i: u32| i.wrapping_mul(2_654_435_761) >> (i % 29);
            let mut pairs: Vec<[u32; 2]> = (0..n).map(|i| [key(i), i]).collect();
            let scratch =
                Scratch::new(&gpu, Capacity { gaussians: n as usize, ..Capacity::default() }).unwrap();
            scratch.restart(&gpu, n as usize);
            gpu.write(&scratch.keys[0], &pairs);
            let mut commands = gpu.commands();
            sort_by_depth(&mut commands, &scratch, n as usize);
            gpu.submit(commands).unwrap();
            pairs.sort_by_key(|p| p[0]);
            assert!(gpu.download::<[u32; 2]>(&scratch.keys[0], n as usize).unwrap() == pairs, "{n} pairs");
        }
    }

    #[test]
    fn bits_tell_the_slots_apart() {
        assert_eq!([1, 2, 3, 16, 17, 8160].map(bits_of), [0, 1, 2, 4, 5, 13]);
    }
}
