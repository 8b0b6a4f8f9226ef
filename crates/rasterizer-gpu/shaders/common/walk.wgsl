// The walk over a tile's splats, front to back, shared by every kernel that blends. CPU twin: rasterizer/src/blend.rs.
// A workgroup of 64 invocations owns a tile; an invocation owns four pixels of one column, so that what it reads of a
// splat serves four times.

const BATCH: u32 = 64u;
const ROWS: u32 = 4u;

var<workgroup> batch_shape: array<vec4f, 64>;   // mean; shape x, y
var<workgroup> batch_colour: array<vec4f, 64>;  // shape z; opacity; colour r, g
var<workgroup> batch_rest: array<vec2f, 64>;    // colour b; entry (bits)
var<workgroup> batch_index: array<u32, 64>;     // Gaussian

fn load_splat(local: u32, item: vec2u, splat: Splat) {
    batch_shape[local] = vec4f(splat.mean, splat.shape.xy);
    batch_colour[local] = vec4f(splat.shape.z, splat.opacity, splat.colour.x, splat.colour.y);
    batch_rest[local] = vec2f(splat.colour.z, bitcast<f32>(item.x));
    batch_index[local] = item.y;
}

// First pixel of a tile.
fn tile_origin(tile: u32) -> vec2u {
    return vec2u(tile % view.tiles.x, tile / view.tiles.x) * TILE;
}

// Pixel `row` (0..3) of an invocation, inside its tile.
fn local_pixel(local: u32, row: u32) -> vec2u {
    return vec2u(local % TILE, local / TILE * ROWS + row);
}

fn in_image(pixel: vec2u) -> bool {
    return all(pixel < view.size);
}

struct Alpha {
    // Pixel centre minus splat centre (px).
    delta: vec2f,
    // exp(-sigma).
    falloff: f32,
    // Capped opacity; 0 where the splat does not show.
    alpha: f32,
}

fn alpha_at(k: u32, pixel: vec2u) -> Alpha {
    let shape = batch_shape[k];
    let colour = batch_colour[k];
    var a: Alpha;
    a.delta = vec2f(pixel) + 0.5 - shape.xy;
    let along = a.delta.x + shape.z * a.delta.y;
    let sigma = shape.w * along * along + colour.x * a.delta.y * a.delta.y;
    a.falloff = exp(-sigma);
    let alpha = min(MAX_ALPHA, colour.y * a.falloff);
    a.alpha = select(0.0, alpha, alpha >= MIN_ALPHA);
    return a;
}

fn colour_of(k: u32) -> vec3f {
    return vec3f(batch_colour[k].zw, batch_rest[k].x);
}
