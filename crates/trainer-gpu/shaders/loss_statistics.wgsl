// SSIM and its derivatives by the window's statistics: first of two kernels of the loss. One workgroup per tile and
// channel; a pixel that does not count shows the photograph, so that windows at the edge see no foreign error.
// Floor: 22 B read and 48 B written per pixel; about 130 operations per pixel and channel.
//
// twin: trainer::loss::block::Statistics
// test: trainer-gpu/src/tests.rs::the_loss_and_its_gradient_agree
// bench: kernel/loss_statistics

@group(0) @binding(0) var<uniform> loss: Loss;
@group(0) @binding(1) var<storage, read> slots: array<vec4u>;
@group(0) @binding(2) var<storage, read> region: array<u32>;
@group(0) @binding(3) var<storage, read> photograph: array<u32>;
@group(0) @binding(4) var<storage, read> pixels: array<vec4f>;
// Per channel and pixel: derivatives by the means of x, x^2 + y^2 and x y.
@group(0) @binding(5) var<storage, read_write> partials: array<vec4f>;
// Per tile and channel: sums of SSIM, of |x - y|, of (x - y)^2.
@group(0) @binding(6) var<storage, read_write> sums: array<vec4f>;

const C1: f32 = 0.0001;
const C2: f32 = 0.0009;

// Rendered and photographed samples with halo, and four maps filtered along the rows.
var<workgroup> samples: array<vec2f, 676>;
var<workgroup> rows: array<vec4f, 416>;

fn load(origin: vec2i, channel: u32, local: u32) {
    for (var i = local; i < HALO * HALO; i += 256u) {
        let p = origin + vec2i(i32(i % HALO), i32(i / HALO)) - i32(RADIUS);
        var xy = vec2f(0.0);
        if in_image(p) {
            let pixel = index_of(p);
            let y = target_at(pixel, channel);
            xy = vec2f(y);
            if is_counted(pixel) {
                xy.x = pixels[pixel][channel];
            }
        }
        samples[i] = xy;
    }
}

fn moments(i: u32) -> vec4f {
    let s = samples[i];
    return vec4f(s, dot(s, s), s.x * s.y);
}

// The window over eleven samples from i on. Written out, so that no loop looks its weights up.
fn along_row(i: u32) -> vec4f {
    return WINDOW[0] * (moments(i) + moments(i + 10u)) + WINDOW[1] * (moments(i + 1u) + moments(i + 9u))
        + WINDOW[2] * (moments(i + 2u) + moments(i + 8u)) + WINDOW[3] * (moments(i + 3u) + moments(i + 7u))
        + WINDOW[4] * (moments(i + 4u) + moments(i + 6u)) + WINDOW[5] * moments(i + 5u);
}

// The same over eleven rows.
fn down_column(i: u32) -> vec4f {
    return WINDOW[0] * (rows[i] + rows[i + 10u * TILE]) + WINDOW[1] * (rows[i + TILE] + rows[i + 9u * TILE])
        + WINDOW[2] * (rows[i + 2u * TILE] + rows[i + 8u * TILE])
        + WINDOW[3] * (rows[i + 3u * TILE] + rows[i + 7u * TILE])
        + WINDOW[4] * (rows[i + 4u * TILE] + rows[i + 6u * TILE]) + WINDOW[5] * rows[i + 5u * TILE];
}

fn filter_rows(local: u32) {
    for (var i = local; i < HALO * TILE; i += 256u) {
        rows[i] = along_row(i / TILE * HALO + i % TILE);
    }
}

// SSIM in w; derivatives by the means of x, x^2 + y^2, x y in xyz, where
// SSIM = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sxx + syy + C2)).
fn similarity(mean: vec4f) -> vec4f {
    let product = mean.x * mean.y;
    let squares = dot(mean.xy, mean.xy);
    let a1 = 2.0 * product + C1;
    let b1 = squares + C1;
    let a2 = 2.0 * (mean.w - product) + C2;
    let b2 = mean.z - squares + C2;
    let inverse = 1.0 / (b1 * b2);
    let ssim = a1 * a2 * inverse;
    let by_squares = -ssim / b2;
    let by_product = 2.0 * a1 * inverse;
    let by_mean = 2.0 * mean.y * a2 * inverse - 2.0 * mean.x * (ssim / b1) - 2.0 * mean.x * by_squares
        - mean.y * by_product;
    return vec4f(by_mean, by_squares, by_product, ssim);
}

@compute @workgroup_size(256)
fn loss_statistics(
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
    filter_rows(local);
    workgroupBarrier();
    let p = origin + vec2i(i32(local % TILE), i32(local / TILE));
    var ssim = 0.0;
    if in_image(p) {
        let pixel = index_of(p);
        if is_counted(pixel) {
            let s = similarity(down_column(local));
            ssim = s.w;
            partials[partial_of(pixel, channel)] = vec4f(s.xyz, 0.0);
        }
    }
    let total = sum_group(vec2f(ssim, 0.0), local);
    if local == 0u {
        sums[slot * 3u + channel].x = total.x;
    }
}
