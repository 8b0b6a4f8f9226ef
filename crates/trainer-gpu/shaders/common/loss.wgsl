// Photometric loss of 3D Gaussian Splatting, 0.8 L1 + 0.2 (1 - SSIM), over the counted pixels of a view.
// `loss`, `region` and `photograph` are bindings of the entry file. CPU twin: trainer/src/loss.

// Half width of the window (px), and pixels of a tile's edge with its halo.
const RADIUS: u32 = 5u;
const HALO: u32 = 26u;
const TILE: u32 = 16u;
// One half and the centre of the normalised window, sigma = 1.5 px (Wang et al. 2004).
const WINDOW: array<f32, 6> = array(0.0010283801, 0.007598758, 0.036000773, 0.10936069, 0.21300553, 0.26601172);

fn tile_origin(tile: u32) -> vec2i {
    return vec2i(i32(tile % loss.tiles.x * TILE), i32(tile / loss.tiles.x * TILE));
}

fn in_image(p: vec2i) -> bool {
    return all(p >= vec2i(0)) && all(p < vec2i(loss.size));
}

fn index_of(p: vec2i) -> u32 {
    return u32(p.y) * loss.size.x + u32(p.x);
}

// Where the derivatives of a channel of a pixel are: plane by plane, so that neighbours are read together.
fn partial_of(pixel: u32, channel: u32) -> u32 {
    return channel * loss.size.x * loss.size.y + pixel;
}

// Whether a pixel counts: one bit each, row by row.
fn is_counted(pixel: u32) -> bool {
    return (region[pixel >> 5u] >> (pixel & 31u) & 1u) != 0u;
}

// A channel of the photograph: interleaved RGB bytes.
fn target_at(pixel: u32, channel: u32) -> f32 {
    let byte = pixel * 3u + channel;
    return f32((photograph[byte >> 2u] >> ((byte & 3u) * 8u)) & 255u) / 255.0;
}

var<workgroup> tree: array<vec2f, 256>;

// Sums of two values over the 256 invocations of a workgroup, in a fixed order; valid in invocation 0.
fn sum_group(value: vec2f, local: u32) -> vec2f {
    tree[local] = value;
    workgroupBarrier();
    for (var step = 128u; step > 0u; step /= 2u) {
        if local < step {
            tree[local] += tree[local + step];
        }
        workgroupBarrier();
    }
    return tree[0];
}
