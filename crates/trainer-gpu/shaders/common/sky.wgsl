// Cube map of the sky: faces +x, -x, +y, -y, +z, -z with OpenGL's orientation, bilinear inside a face.
// CPU twin: trainer/src/sky.rs.

struct Sample {
    texels: vec4u,
    weights: vec4f,
}

// Face (x), and coordinates on it in -1..=1.
fn face_of(d: vec3f) -> vec3f {
    let a = abs(d);
    if a.x >= a.y && a.x >= a.z {
        return select(vec3f(1.0, d.z / a.x, -d.y / a.x), vec3f(0.0, -d.z / a.x, -d.y / a.x), d.x > 0.0);
    }
    if a.y >= a.z {
        return select(vec3f(3.0, d.x / a.y, -d.z / a.y), vec3f(2.0, d.x / a.y, d.z / a.y), d.y > 0.0);
    }
    return select(vec3f(5.0, -d.x / a.z, -d.y / a.z), vec3f(4.0, d.x / a.z, -d.y / a.z), d.z > 0.0);
}

// What the pixel sees; `view` is the uniform of the entry file.
fn sky_sample(pixel: vec2u, size: u32) -> Sample {
    let p = (vec2f(pixel) + 0.5 - view.principal) / view.focal;
    let ray = view.rotation[0].xyz * p.x + view.rotation[1].xyz * p.y + view.rotation[2].xyz;
    let face = face_of(ray);
    let limit = f32(size) - 1.0;
    let place = clamp((face.yz * 0.5 + 0.5) * f32(size) - 0.5, vec2f(0.0), vec2f(limit));
    let low = vec2u(place);
    let high = min(low + 1u, vec2u(size - 1u));
    let f = place - vec2f(low);
    let row = u32(face.x) * size;
    var s: Sample;
    s.texels = vec4u(
        (row + low.y) * size + low.x,
        (row + low.y) * size + high.x,
        (row + high.y) * size + low.x,
        (row + high.y) * size + high.x,
    );
    s.weights = vec4f((1.0 - f.y) * (1.0 - f.x), (1.0 - f.y) * f.x, f.y * (1.0 - f.x), f.y * f.x);
    return s;
}
