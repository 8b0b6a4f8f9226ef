// Filters the derivatives back and adds the L1 term: second of two kernels of the loss.
// Floor: 70 B read and 12 B written per pixel; about 100 operations per pixel and channel.
//
// twin: trainer::loss::block::Gradient
// test: trainer-gpu/src/tests.rs::the_loss_and_its_gradient_agree
// bench: kernel/loss_gradient

@group(0) @binding(0) var<uniform> loss: Loss;
@group(0) @binding(1) var<storage, read> slots: array<vec4u>;
@group(0) @binding(2) var<storage, read> region: array<u32>;
@group(0) @binding(3) var<storage, read> photograph: array<u32>;
@group(0) @binding(4) var<storage, read> pixels: array<vec4f>;
@group(0) @binding(5) var<storage, read> partials: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> sums: array<vec4f>;
// Row-major, four per pixel: derivatives by R, G, B and by the transmittance (0).
@group(0) @binding(7) var<storage, read_write> upstream: array<f32>;

// Three values per entry; as vec3f they would take the room of four.
var<workgroup> maps: array<f32, 2028>;
var<workgroup> rows: array<f32, 1248>;

fn load(origin: vec2i, channel: u32, local: u32) {
    for (var i = local; i < HALO * HALO; i += 256u) {
        let p = origin + vec2i(i32(i % HALO), i32(i / HALO)) - i32(RADIUS);
        var partial = vec3f(0.0);
        if in_image(p) {
            let pixel = index_of(p);
            if is_counted(pixel) {
                partial = partials[partial_of(pixel, channel)].xyz;
            }
        }
        maps[i * 3u] = partial.x;
        maps[i * 3u + 1u] = partial.y;
        maps[i * 3u + 2u] = partial.z;
    }
}

fn map_at(i: u32) -> vec3f {
    return vec3f(maps[i * 3u], maps[i * 3u + 1u], maps[i * 3u + 2u]);
}

fn row_at(i: u32) -> vec3f {
    return vec3f(rows[i * 3u], rows[i * 3u + 1u], rows[i * 3u + 2u]);
}

// As in `loss_statistics`.
fn along_row(i: u32) -> vec3f {
    return WINDOW[0] * (map_at(i) + map_at(i + 10u)) + WINDOW[1] * (map_at(i + 1u) + map_at(i + 9u))
        + WINDOW[2] * (map_at(i + 2u) + map_at(i + 8u)) + WINDOW[3] * (map_at(i + 3u) + map_at(i + 7u))
        + WINDOW[4] * (map_at(i + 4u) + map_at(i + 6u)) + WINDOW[5] * map_at(i + 5u);
}

fn down_column(i: u32) -> vec3f {
    return WINDOW[0] * (row_at(i) + row_at(i + 10u * TILE)) + WINDOW[1] * (row_at(i + TILE) + row_at(i + 9u * TILE))
        + WINDOW[2] * (row_at(i + 2u * TILE) + row_at(i + 8u * TILE))
        + WINDOW[3] * (row_at(i + 3u * TILE) + row_at(i + 7u * TILE))
        + WINDOW[4] * (row_at(i + 4u * TILE) + row_at(i + 6u * TILE)) + WINDOW[5] * row_at(i + 5u * TILE);
}

@compute @workgroup_size(256)
fn loss_gradient(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let job = linear_group(group, groups);
    let slot = min(job / 3u, loss.slots - 1u);
    let channel = job % 3u;
    let origin = tile_origin(slots[slot].x);
    load(origin, channel, local);
    workgroupBarrier();
    for (var i = local; i < HALO * TILE; i += 256u) {
        let row = along_row(i / TILE * HALO + i % TILE);
        rows[i * 3u] = row.x;
        rows[i * 3u + 1u] = row.y;
        rows[i * 3u + 2u] = row.z;
    }
    workgroupBarrier();
    let p = origin + vec2i(i32(local % TILE), i32(local / TILE));
    var error = 0.0;
    if in_image(p) {
        let pixel = index_of(p);
        var gradient = 0.0;
        if is_counted(pixel) {
            let mean = down_column(local);
            let x = pixels[pixel][channel];
            let y = target_at(pixel, channel);
            error = x - y;
            gradient = loss.l1_factor * sign(error)
                + loss.ssim_factor * (mean.x + 2.0 * x * mean.y + y * mean.z);
        }
        upstream[pixel * 4u + channel] = gradient;
        if channel == 0u {
            upstream[pixel * 4u + 3u] = 0.0;
        }
    }
    let total = sum_group(vec2f(abs(error), error * error), local);
    if local == 0u {
        sums[slot * 3u + channel].y = total.x;
        sums[slot * 3u + channel].z = total.y;
    }
}
