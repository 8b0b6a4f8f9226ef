// The walk over a tile's splats, front to back, shared by every kernel that blends. CPU twin: rasterizer/src/blend.rs.
// A workgroup of 64 invocations owns a tile; an invocation owns four pixels of one column, so that what it reads of a
// splat serves four times. The four are the components of vectors, and no loop runs over them: what a loop indexes, drivers keep
// in memory instead of registers.

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

// First of the four pixels of an invocation, inside its tile; the others lie below it.
fn local_column(local: u32) -> vec2u {
    return vec2u(local % TILE, local / TILE * ROWS);
}

fn in_image(pixel: vec2u) -> bool {
    return all(pixel < view.size);
}

// Which of the four pixels from `first` down are in the image.
fn column_in_image(first: vec2u) -> vec4<bool> {
    return vec4<bool>(first.x < view.size.x) & (first.y + vec4u(0u, 1u, 2u, 3u) < vec4u(view.size.y));
}

// Centres of four pixels (px): one x and four y.
struct Column {
    x: f32,
    y: vec4f,
}

fn column_from(first: vec2u) -> Column {
    return Column(f32(first.x) + 0.5, f32(first.y) + vec4f(0.5, 1.5, 2.5, 3.5));
}

struct Alphas {
    // Pixel centres minus splat centre (px).
    across: f32,
    down: vec4f,
    // exp(-sigma).
    falloff: vec4f,
    // Capped opacity; 0 where the splat does not show.
    alpha: vec4f,
}

fn alphas_at(k: u32, pixels: Column) -> Alphas {
    let shape = batch_shape[k];
    let colour = batch_colour[k];
    var a: Alphas;
    a.across = pixels.x - shape.x;
    a.down = pixels.y - shape.y;
    let along = a.across + shape.z * a.down;
    let sigma = shape.w * along * along + colour.x * a.down * a.down;
    a.falloff = exp(-sigma);
    let alpha = min(vec4f(MAX_ALPHA), colour.y * a.falloff);
    a.alpha = select(vec4f(0.0), alpha, alpha >= vec4f(MIN_ALPHA));
    return a;
}

fn colour_of(k: u32) -> vec3f {
    return vec3f(batch_colour[k].zw, batch_rest[k].x);
}

// What four pixels show so far.
struct Blended {
    red: vec4f,
    green: vec4f,
    blue: vec4f,
    transmittance: vec4f,
    // Those that more splats may add to.
    open: vec4<bool>,
}

fn nothing_blended(open: vec4<bool>) -> Blended {
    return Blended(vec4f(0.0), vec4f(0.0), vec4f(0.0), vec4f(1.0), open);
}

// Adds a splat of `alpha` to the pixels that it shows in; returns these.
fn blend_splat(pixels: ptr<function, Blended>, alpha: vec4f, shade: vec3f) -> vec4<bool> {
    let shows = (*pixels).open & (alpha > vec4f(0.0));
    let weight = alpha * (*pixels).transmittance;
    let next = (*pixels).transmittance - weight;
    let counts = shows & (next > vec4f(MIN_TRANSMITTANCE));
    let added = select(vec4f(0.0), weight, counts);
    (*pixels).red += added * shade.x;
    (*pixels).green += added * shade.y;
    (*pixels).blue += added * shade.z;
    (*pixels).transmittance = select((*pixels).transmittance, next, counts);
    (*pixels).open = (*pixels).open & (counts | !shows);
    return counts;
}

// Colour and transmittance of each of the four.
fn pixel_x(b: Blended) -> vec4f {
    return vec4f(b.red.x, b.green.x, b.blue.x, b.transmittance.x);
}

fn pixel_y(b: Blended) -> vec4f {
    return vec4f(b.red.y, b.green.y, b.blue.y, b.transmittance.y);
}

fn pixel_z(b: Blended) -> vec4f {
    return vec4f(b.red.z, b.green.z, b.blue.z, b.transmittance.z);
}

fn pixel_w(b: Blended) -> vec4f {
    return vec4f(b.red.w, b.green.w, b.blue.w, b.transmittance.w);
}
