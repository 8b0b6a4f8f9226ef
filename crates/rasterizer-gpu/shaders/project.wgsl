// Projects Gaussians, colours them, and finds the tiles that each one touches: exactly, row by row, once. Later
// kernels read the spans that are stored here and never decide again.
// Floor per Gaussian: 48 B read, 72 B written, and 12 B per SH coefficient and 4 B per tile row for those in sight;
// about 400 operations.
//
// twin: rasterizer::block::Block
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: kernel/project

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> geometry: array<Geometry>;
// (Gaussian, coefficient, RGB).
@group(0) @binding(2) var<storage, read> sh: array<f32>;
@group(0) @binding(3) var<storage, read> tile_slots: array<u32>;
@group(0) @binding(4) var<storage, read_write> splats: array<Splat>;
// (depth bits, Gaussian); those out of sight sort to the end.
@group(0) @binding(5) var<storage, read_write> keys: array<vec2u>;
// Pairs; first span; first tile row and number of rows in half words; first entry (later).
@group(0) @binding(6) var<storage, read_write> extents: array<vec4u>;
// First tile and end of a row in half words.
@group(0) @binding(7) var<storage, read_write> spans: array<u32>;
@group(0) @binding(8) var<storage, read_write> spans_used: array<atomic<u32>>;

var<workgroup> group_rows: atomic<u32>;
var<workgroup> group_start: u32;

const OUT_OF_SIGHT: u32 = 0xffffffffu;

struct Cover {
    first_row: i32,
    rows: u32,
    squared_reach: f32,
    half_height: f32,
    // How the square of the ellipse's half width falls with the square of the height.
    shrink: f32,
    // Height of the ellipse's rightmost point.
    right_tip: f32,
}

// `2 reach`, slightly generous: rounding in a coverage test must never lose a pixel that the blend accepts.
fn squared_reach(opacity: f32) -> f32 {
    return 2.0 * max(log(255.0 * opacity), 0.0) * 1.0001 + 1e-4;
}

fn tile_of(v: f32, count: f32) -> i32 {
    return i32(clamp(floor(v / f32(TILE)), -1.0, count));
}

fn cover_of(splat: Splat, e: Ewa) -> Cover {
    var c: Cover;
    c.squared_reach = squared_reach(splat.opacity);
    c.half_height = sqrt(c.squared_reach * e.filtered.z) + 1e-3;
    c.shrink = splat.shape.z / splat.shape.y;
    c.right_tip = sqrt(c.squared_reach * e.filtered.x) * e.filtered.y / e.filtered.x;
    let rows = f32(view.tiles.y);
    c.first_row = max(tile_of(splat.mean.y - c.half_height - 0.5, rows), 0);
    let last_row = min(tile_of(splat.mean.y + c.half_height - 0.5, rows), i32(view.tiles.y) - 1);
    c.rows = u32(max(last_row - c.first_row + 1, 0));
    return c;
}

// Centre and half width of the ellipse at height dy.
fn edge(splat: Splat, c: Cover, dy: f32) -> vec2f {
    let half_width = sqrt(max(0.5 * c.squared_reach / splat.shape.y - dy * dy * c.shrink, 0.0));
    return vec2f(-splat.shape.x * dy, half_width);
}

// First tile (x) and end (y) in a tile row; empty when they are equal.
fn span_of(splat: Splat, c: Cover, row: i32) -> vec2u {
    let top = max(f32(row) * f32(TILE) + 0.5 - splat.mean.y, -c.half_height);
    let bottom = max(min(f32(row) * f32(TILE) + f32(TILE) - 0.5 - splat.mean.y, c.half_height), top);
    let right = edge(splat, c, clamp(c.right_tip, top, bottom));
    let left = edge(splat, c, clamp(-c.right_tip, top, bottom));
    let columns = f32(view.tiles.x);
    let first = max(tile_of(splat.mean.x + left.x - left.y - 0.51, columns), 0);
    let last = min(tile_of(splat.mean.x + right.x + right.y - 0.49, columns), i32(view.tiles.x) - 1);
    if first > last {
        return vec2u(0u);
    }
    return vec2u(u32(first), u32(last) + 1u);
}

fn active_tiles(row: i32, span: vec2u) -> u32 {
    var count = 0u;
    for (var x = span.x; x < span.y; x++) {
        count += u32(tile_slots[u32(row) * view.tiles.x + x] != NO_SLOT);
    }
    return count;
}

fn view_colour(i: u32, offset: vec3f) -> vec3f {
    let distance = length(offset);
    let direction = select(vec3f(0.0), offset / distance, distance > 0.0);
    let colour = sh_colour(i, view.sh_degree, direction);
    return select(vec3f(0.0), max(colour, vec3f(0.0)), all_finite(colour));
}

@compute @workgroup_size(256)
fn project(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = linear_group(group, groups) * 256u + local;
    if local == 0u {
        atomicStore(&group_rows, 0u);
    }
    workgroupBarrier();
    var splat: Splat;
    var cover: Cover;
    var offset: vec3f;
    if i < view.count {
        let g = geometry[i];
        let e = project_shape(g);
        splat.opacity = min(sigmoid(g.opacity_logit) * dropout_factor(i), 1.0) * compensation_of(e);
        if e.valid && splat.opacity >= MIN_ALPHA {
            splat.mean = e.mean + view.principal;
            splat.depth = e.expansion.point.z;
            splat.shape = shape_of(e);
            offset = e.offset;
            if is_finite(splat.mean.x) && is_finite(splat.mean.y) {
                cover = cover_of(splat, e);
            }
        }
    }
    // Room for the spans: one atomic a workgroup. Where they lie differs from run to run, what they say does not.
    let before = atomicAdd(&group_rows, cover.rows);
    workgroupBarrier();
    if local == 0u {
        group_start = atomicAdd(&spans_used[0], atomicLoad(&group_rows));
    }
    workgroupBarrier();
    if i >= view.count {
        return;
    }
    let start = group_start + before;
    var pairs = 0u;
    if start + cover.rows <= view.span_capacity {
        for (var r = 0u; r < cover.rows; r++) {
            let row = cover.first_row + i32(r);
            let span = span_of(splat, cover, row);
            spans[start + r] = span.x | (span.y << 16u);
            pairs += active_tiles(row, span);
        }
    }
    extents[i] = vec4u(pairs, start, u32(cover.first_row) | (cover.rows << 16u), 0u);
    keys[i] = vec2u(select(OUT_OF_SIGHT, bitcast<u32>(splat.depth), pairs > 0u), i);
    if pairs > 0u {
        splat.colour = view_colour(i, offset);
        splats[i] = splat;
    }
}
