// From derivatives of pixels to derivatives per (tile, splat) entry, front to back over the same lists as `blend`.
// `behind` starts as everything that a pixel shows, weighted by its derivative, and loses each contribution in turn: no
// transmittance is divided back out of a product. A list is differentiated in parts side by side, each from where `blend`
// says that it begins: few tiles would leave most of a device idle. CPU twin: rasterizer/src/backward.rs.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> list: array<vec2u>;
@group(0) @binding(3) var<storage, read> slots: array<vec4u>;
@group(0) @binding(4) var<storage, read> layers: array<vec4f>;
@group(0) @binding(5) var<storage, read> pixels: array<vec4f>;
@group(0) @binding(6) var<storage, read> last: array<u32>;
// Derivatives of the loss by a pixel's RGB and transmittance, row-major.
@group(0) @binding(7) var<storage, read> upstream: array<vec4f>;
// Per entry, with d = dL/dexponent, o = pixel - centre: sums of d o.x, d o.y, d o.x^2, d o.x o.y, d o.y^2,
// dL/dopacity, and of the colour's derivative.
@group(0) @binding(8) var<storage, read_write> entries: array<f32>;

var<workgroup> longest: atomic<u32>;
var<workgroup> longest_shared: u32;

// What a pixel says to the splats that it shows.
struct Given {
    // Derivative of the loss by their blended colour.
    gradient: vec3f,
    // Everything that the pixel shows of them and behind them, weighted by its derivative.
    behind: f32,
    // Entries of the list up to the last one that counts.
    counted: u32,
}

fn given_to(inside: bool, slot: u32, place: vec2u, pixel: vec2u) -> Given {
    if !inside {
        return Given(vec3f(0.0), 0.0, 0u);
    }
    var back = vec4f(view.background, 1.0);
    var front = vec4f(0.0);
    if view.layered != 0u {
        let layer = (slot * AREA + place.y * TILE + place.x) * 2u;
        back = layers[layer];
        front = layers[layer + 1u];
    }
    let at = pixel.y * view.size.x + pixel.x;
    let shown = pixels[at];
    let given = upstream[at];
    let behind = dot(given.xyz, shown.xyz - front.xyz) + shown.w * (given.w + front.w);
    return Given(given.xyz * back.w, behind, last[at]);
}

fn sum_of(v: vec4f) -> f32 {
    return (v.x + v.y) + (v.z + v.w);
}

// Part `job % parts` of the list of slot `job / parts`; `job` must not differ inside a workgroup.
fn differentiate_part(job: u32, local: u32) {
    let slot = job / view.parts;
    let part = job % view.parts;
    var tile = vec4u(0u);
    if slot < view.slots {
        tile = slots[slot];
    }
    let place = local_column(local);
    let first_pixel = tile_origin(tile.x) + place;
    let centres = column_from(first_pixel);
    let inside = column_in_image(first_pixel) & vec4<bool>(slot < view.slots);
    let p0 = given_to(inside.x, slot, place, first_pixel);
    let p1 = given_to(inside.y, slot, place + vec2u(0u, 1u), first_pixel + vec2u(0u, 1u));
    let p2 = given_to(inside.z, slot, place + vec2u(0u, 2u), first_pixel + vec2u(0u, 2u));
    let p3 = given_to(inside.w, slot, place + vec2u(0u, 3u), first_pixel + vec2u(0u, 3u));
    let red = vec4f(p0.gradient.x, p1.gradient.x, p2.gradient.x, p3.gradient.x);
    let green = vec4f(p0.gradient.y, p1.gradient.y, p2.gradient.y, p3.gradient.y);
    let blue = vec4f(p0.gradient.z, p1.gradient.z, p2.gradient.z, p3.gradient.z);
    let counted = vec4u(p0.counted, p1.counted, p2.counted, p3.counted);
    var behind = vec4f(p0.behind, p1.behind, p2.behind, p3.behind);
    var transmittance = vec4f(1.0);
    let most = max(max(counted.x, counted.y), max(counted.z, counted.w));
    if local == 0u {
        atomicStore(&longest, 0u);
    }
    workgroupBarrier();
    atomicMax(&longest, most);
    workgroupBarrier();
    if local == 0u {
        longest_shared = atomicLoad(&longest);
    }
    let reached = workgroupUniformLoad(&longest_shared);
    let size = part_length(tile.z - tile.y);
    let begin = min(part * size, tile.z - tile.y);
    let end = min(begin + size, tile.z - tile.y);
    let length = clamp(reached, begin, end);
    if begin > 0u && begin < length {
        let so_far = red * state_of(slot, part, 0u, place)
            + green * state_of(slot, part, 1u, place)
            + blue * state_of(slot, part, 2u, place);
        behind -= so_far;
        transmittance = state_of(slot, part, 3u, place);
    }
    for (var first = begin; first < length; first += BATCH) {
        workgroupBarrier();
        let at = tile.y + first + local;
        if at < tile.z {
            let item = list[at];
            load_splat(local, item, splats[item.y]);
        }
        workgroupBarrier();
        let batch = min(BATCH, length - first);
        for (var start = 0u; start < batch; start += REDUCED) {
            let reduced = min(REDUCED, batch - start);
            for (var j = 0u; j < reduced; j++) {
                let k = start + j;
                let a = alphas_at(k, centres);
                let adds = (vec4u(first + k) < counted) & (a.alpha > vec4f(0.0));
                if !any_adds(any(adds)) {
                    keep_nothing(j, local);
                    continue;
                }
                let shade = colour_of(k);
                let opacity = batch_colour[k].y;
                let weight = select(vec4f(0.0), a.alpha * transmittance, adds);
                let shown = red * shade.x + green * shade.y + blue * shade.z;
                behind -= select(vec4f(0.0), weight * shown, adds);
                let d_alpha = transmittance * shown - behind / (1.0 - a.alpha);
                transmittance -= weight;
                let free = adds & (opacity * a.falloff < vec4f(MAX_ALPHA));
                let d = select(vec4f(0.0), d_alpha * a.falloff, free);
                let e = d * opacity;
                let e_sum = sum_of(e);
                let e_down = e * a.down;
                let e_down_sum = sum_of(e_down);
                let around = vec4f(e_sum, e_sum * a.across, e_down_sum, dot(e_down, a.down));
                keep_partials(
                    j,
                    local,
                    vec4f(around.y, around.z, around.y * a.across, around.z * a.across),
                    vec4f(around.w, sum_of(d), dot(weight, red), dot(weight, green)),
                    dot(weight, blue),
                );
            }
            workgroupBarrier();
            for (var row = local; row < reduced * ENTRY; row += 64u) {
                let entry = bitcast<u32>(batch_rest[start + row / ENTRY].y);
                entries[entry * ENTRY + row % ENTRY] = total_of(row);
            }
            workgroupBarrier();
        }
    }
    // Entries that no pixel reached.
    for (var row = local; row < (end - length) * ENTRY; row += 64u) {
        let entry = list[tile.y + length + row / ENTRY].x;
        entries[entry * ENTRY + row % ENTRY] = 0.0;
    }
}
