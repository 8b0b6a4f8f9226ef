// The K largest contributions of every pixel, heaviest first; of equal ones the one in front comes first.
// Floor: as `blend`, and 8 B per entry of the result.
//
// twin: rasterizer::top_contributors::TopContributors
// test: rasterizer-gpu/tests/parity.rs::footprints_and_top_contributors_agree
// bench: gpu/top_contributors

@group(0) @binding(0) var<uniform> view: View;
// K, at most 16.
@group(0) @binding(1) var<uniform> kept: vec4u;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> list: array<vec2u>;
@group(0) @binding(4) var<storage, read> slots: array<vec4u>;
@group(0) @binding(5) var<storage, read> last: array<u32>;
// (pixel, K): Gaussian, -1 = none; weight (bits).
@group(0) @binding(6) var<storage, read_write> top: array<vec2i>;

const MOST: u32 = 16u;

@compute @workgroup_size(64)
fn top_contributors(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    // A quarter of a tile: the lists of four pixels would not fit in registers.
    let job = linear_group(group, groups);
    let slot = min(job / 4u, view.slots - 1u);
    let tile = slots[slot];
    let pixel = tile_origin(tile.x) + vec2u(local % TILE, job % 4u * 4u + local / TILE);
    let centre = column_from(pixel);
    var counted = 0u;
    let at = pixel.y * view.size.x + pixel.x;
    if in_image(pixel) {
        counted = last[at];
    }
    let count = min(kept.x, MOST);
    var indices: array<i32, 16>;
    var weights: array<f32, 16>;
    for (var k = 0u; k < MOST; k++) {
        indices[k] = -1;
    }
    var transmittance = 1.0;
    for (var first = 0u; first < tile.z - tile.y; first += BATCH) {
        workgroupBarrier();
        let from_list = tile.y + first + local;
        if from_list < tile.z {
            let item = list[from_list];
            load_splat(local, item, splats[item.y]);
        }
        workgroupBarrier();
        let end = min(BATCH, max(counted, first) - first);
        for (var k = 0u; k < end; k++) {
            // One of four: drivers drop the others.
            let weight = alphas_at(k, centre).alpha.x * transmittance;
            transmittance -= weight;
            if weight > weights[count - 1u] {
                var place = count - 1u;
                for (; place > 0u && weights[place - 1u] < weight; place--) {
                    weights[place] = weights[place - 1u];
                    indices[place] = indices[place - 1u];
                }
                weights[place] = weight;
                indices[place] = i32(batch_index[k]);
            }
        }
    }
    if in_image(pixel) {
        for (var k = 0u; k < count; k++) {
            top[at * count + k] = vec2i(indices[k], bitcast<i32>(weights[k]));
        }
    }
}
