// Gaussian-weighted K nearest tracks at every masked pixel: Algorithm 2. All tracks are looked at; invocations of a
// group read the same one at the same time.
// Floor: 20 B per pixel; about 8 operations per pixel and track.
//
// twin: voronoi::gaussian_knn::GaussianKnn
// test: motion-gpu/tests/parity.rs::densification_agrees_for_any_number_of_tracks_and_neighbours
// bench: gpu/motion_fields

struct Densify {
    // Masked pixels, tracks, and neighbours K (at most MOST_NEIGHBOURS).
    pixels: u32,
    tracks: u32,
    neighbours: u32,
    // Row of the tracker's first pixel in `fields`.
    first: u32,
    // Pixels to the unit square; 1 / (2 sigma^2).
    scale: vec2f,
    half_precision: f32,
    // 1: confidence times visibility.
    use_visibility: u32,
    // Columns of the image.
    width: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> job: Densify;
// Masked pixels, row-major numbers.
@group(0) @binding(1) var<storage, read> pixels: array<u32>;
// Source (px, integer-centred), displacement (px).
@group(0) @binding(2) var<storage, read> tracks: array<vec4f>;
@group(0) @binding(3) var<storage, read> visibility: array<f32>;
// Per tracker and masked pixel: flow (px), visibility, confidence.
@group(0) @binding(4) var<storage, read_write> fields: array<vec4f>;

const MOST_NEIGHBOURS: u32 = 16u;

@compute @workgroup_size(64)
fn densify(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 64u + local;
    if at >= job.pixels {
        return;
    }
    let number = pixels[at];
    let pixel = vec2f(vec2u(number % job.width, number / job.width));
    // The nearest so far, ascending; of equally distant ones the first tracks.
    var distance: array<f32, 16>;
    var nearest: array<u32, 16>;
    var found = 0u;
    for (var t = 0u; t < job.tracks; t++) {
        let d = (pixel - tracks[t].xy) * job.scale;
        let squared = dot(d, d);
        if found == job.neighbours && !(squared < distance[found - 1u]) {
            continue;
        }
        var place = min(found, job.neighbours - 1u);
        while place > 0u && distance[place - 1u] > squared {
            distance[place] = distance[place - 1u];
            nearest[place] = nearest[place - 1u];
            place--;
        }
        distance[place] = squared;
        nearest[place] = t;
        found = min(found + 1u, job.neighbours);
    }
    var sum = vec3f(0.0);
    var total = 0.0;
    // Weights relative to the nearest, whose own is then 1: the sum cannot be 0 / 0 however far the tracks are.
    for (var k = 0u; k < found; k++) {
        let weight = exp(-(distance[k] - distance[0]) * job.half_precision);
        total += weight;
        sum += weight * vec3f(tracks[nearest[k]].zw, visibility[nearest[k]]);
    }
    var field = vec4f(0.0);
    if found > 0u {
        let mean = sum / total;
        let confidence = exp(-distance[0] * job.half_precision);
        field = vec4f(mean, confidence * select(1.0, mean.z, job.use_visibility != 0u));
    }
    fields[job.first + at] = field;
}
