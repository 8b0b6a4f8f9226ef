// Real spherical harmonics in the basis and with the signs of 3D Gaussian Splatting.
// `sh` is a binding of the entry file. Coefficients are taken one by one, by constant numbers: an array that a loop
// indexes would lie in memory. CPU twin: rasterizer/src/spherical_harmonics.rs.

const SH_C0: f32 = 0.2820948;
const SH_C1: f32 = 0.4886025;
const SH_C2: array<f32, 5> = array(1.0925484, -1.0925484, 0.31539157, -1.0925484, 0.5462742);
const SH_C3: array<f32, 7> =
    array(-0.5900436, 2.8906114, -0.4570458, 0.3731763, -0.4570458, 1.4453057, -0.5900436);

// Basis values in direction d (unit); entries beyond `degree` are zero.
fn sh_basis(degree: u32, d: vec3f) -> array<f32, 16> {
    var b: array<f32, 16>;
    b[0] = SH_C0;
    if degree >= 1u {
        b[1] = -SH_C1 * d.y;
        b[2] = SH_C1 * d.z;
        b[3] = -SH_C1 * d.x;
    }
    let q = d * d;
    if degree >= 2u {
        b[4] = SH_C2[0] * d.x * d.y;
        b[5] = SH_C2[1] * d.y * d.z;
        b[6] = SH_C2[2] * (2.0 * q.z - q.x - q.y);
        b[7] = SH_C2[3] * d.x * d.z;
        b[8] = SH_C2[4] * (q.x - q.y);
    }
    if degree >= 3u {
        b[9] = SH_C3[0] * d.y * (3.0 * q.x - q.y);
        b[10] = SH_C3[1] * d.x * d.y * d.z;
        b[11] = SH_C3[2] * d.y * (4.0 * q.z - q.x - q.y);
        b[12] = SH_C3[3] * d.z * (2.0 * q.z - 3.0 * q.x - 3.0 * q.y);
        b[13] = SH_C3[4] * d.x * (4.0 * q.z - q.x - q.y);
        b[14] = SH_C3[5] * d.z * (q.x - q.y);
        b[15] = SH_C3[6] * d.x * (q.x - 3.0 * q.y);
    }
    return b;
}

// Coefficient k of Gaussian i (RGB).
fn sh_at(i: u32, k: u32) -> vec3f {
    let at = (i * view.sh_stride + k) * 3u;
    return vec3f(sh[at], sh[at + 1u], sh[at + 2u]);
}

// Colour of Gaussian i in direction d, not clamped.
fn sh_colour(i: u32, degree: u32, d: vec3f) -> vec3f {
    let b = sh_basis(degree, d);
    var colour = 0.5 + b[0] * sh_at(i, 0u);
    if degree >= 1u {
        colour += b[1] * sh_at(i, 1u);
        colour += b[2] * sh_at(i, 2u);
        colour += b[3] * sh_at(i, 3u);
    }
    if degree >= 2u {
        colour += b[4] * sh_at(i, 4u);
        colour += b[5] * sh_at(i, 5u);
        colour += b[6] * sh_at(i, 6u);
        colour += b[7] * sh_at(i, 7u);
        colour += b[8] * sh_at(i, 8u);
    }
    if degree >= 3u {
        colour += b[9] * sh_at(i, 9u);
        colour += b[10] * sh_at(i, 10u);
        colour += b[11] * sh_at(i, 11u);
        colour += b[12] * sh_at(i, 12u);
        colour += b[13] * sh_at(i, 13u);
        colour += b[14] * sh_at(i, 14u);
        colour += b[15] * sh_at(i, 15u);
    }
    return colour;
}

// Number of coefficients of a degree.
fn sh_coefficients(degree: u32) -> u32 {
    return (degree + 1u) * (degree + 1u);
}

// Partial derivatives of each basis polynomial by the direction's components.
fn sh_basis_gradient(degree: u32, d: vec3f) -> array<vec3f, 16> {
    var g: array<vec3f, 16>;
    if degree >= 1u {
        g[1] = vec3f(0.0, -SH_C1, 0.0);
        g[2] = vec3f(0.0, 0.0, SH_C1);
        g[3] = vec3f(-SH_C1, 0.0, 0.0);
    }
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let q = d * d;
    if degree >= 2u {
        g[4] = SH_C2[0] * vec3f(y, x, 0.0);
        g[5] = SH_C2[1] * vec3f(0.0, z, y);
        g[6] = SH_C2[2] * vec3f(-2.0 * x, -2.0 * y, 4.0 * z);
        g[7] = SH_C2[3] * vec3f(z, 0.0, x);
        g[8] = SH_C2[4] * vec3f(2.0 * x, -2.0 * y, 0.0);
    }
    if degree >= 3u {
        g[9] = SH_C3[0] * vec3f(6.0 * x * y, 3.0 * q.x - 3.0 * q.y, 0.0);
        g[10] = SH_C3[1] * vec3f(y * z, x * z, x * y);
        g[11] = SH_C3[2] * vec3f(-2.0 * x * y, 4.0 * q.z - q.x - 3.0 * q.y, 8.0 * y * z);
        g[12] = SH_C3[3] * vec3f(-6.0 * x * z, -6.0 * y * z, 6.0 * q.z - 3.0 * q.x - 3.0 * q.y);
        g[13] = SH_C3[4] * vec3f(4.0 * q.z - 3.0 * q.x - q.y, -2.0 * x * y, 8.0 * x * z);
        g[14] = SH_C3[5] * vec3f(2.0 * x * z, -2.0 * y * z, q.x - q.y);
        g[15] = SH_C3[6] * vec3f(3.0 * q.x - 3.0 * q.y, -6.0 * x * y, 0.0);
    }
    return g;
}
