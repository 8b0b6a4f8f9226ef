// View-dependent colours: the spherical harmonics of 3D Gaussian Splatting.

import { isOpponent } from './stream.js';

const SH_C0 = 0.28209479177387814;
const SH_C1 = 0.4886025119029199;
const SH_C2 = [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
const SH_C3 = [-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658, 1.445305721320277, -0.5900435899266435];
const [SQRT1_3, SQRT1_6] = [1 / Math.sqrt(3), 1 / Math.sqrt(6)];
/** Values above degree 0 in a row. */
const STRIDE = 45;
const b = new Float64Array(15);

/** Values of the basis above degree 0 for a unit direction; returns how many. */
function basis(degree, x, y, z) {
    if (degree === 0) return 0;
    b[0] = -SH_C1 * y;
    b[1] = SH_C1 * z;
    b[2] = -SH_C1 * x;
    if (degree === 1) return 3;
    const [xx, yy, zz] = [x * x, y * y, z * z];
    b[3] = SH_C2[0] * x * y;
    b[4] = SH_C2[1] * y * z;
    b[5] = SH_C2[2] * (2 * zz - xx - yy);
    b[6] = SH_C2[3] * x * z;
    b[7] = SH_C2[4] * (xx - yy);
    if (degree === 2) return 8;
    b[8] = SH_C3[0] * y * (3 * xx - yy);
    b[9] = SH_C3[1] * x * y * z;
    b[10] = SH_C3[2] * y * (4 * zz - xx - yy);
    b[11] = SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy);
    b[12] = SH_C3[4] * x * (4 * zz - xx - yy);
    b[13] = SH_C3[5] * z * (xx - yy);
    b[14] = SH_C3[6] * x * (xx - 3 * yy);
    return 15;
}

/** The colour of row `i` of some columns as an eye sees it. */
export function colourOf({ center, colour, harmonics }, steps, i, eye, rgb) {
    const [x, y, z] = [center[4 * i] - eye.x, center[4 * i + 1] - eye.y, center[4 * i + 2] - eye.z];
    const unit = 1 / (Math.sqrt(x * x + y * y + z * z) || 1);
    const count = basis(steps.sh_degree, x * unit, y * unit, z * unit);
    let [first, second, third] = [0, 0, 0];
    for (let j = 0, at = STRIDE * i; j < count; j++, at += 3) {
        first += b[j] * harmonics[at];
        second += b[j] * harmonics[at + 1];
        third += b[j] * harmonics[at + 2];
    }
    let [red, green, blue] = [first, second, third];
    if (isOpponent(steps)) {
        const white = first * SQRT1_3;
        const across = second * Math.SQRT1_2;
        const other = third * SQRT1_6;
        red = white + across + other;
        green = white - 2 * other;
        blue = white - across + other;
    }
    rgb[0] = Math.max(0, 0.5 + SH_C0 * colour[3 * i] + red * steps.harmonic);
    rgb[1] = Math.max(0, 0.5 + SH_C0 * colour[3 * i + 1] + green * steps.harmonic);
    rgb[2] = Math.max(0, 0.5 + SH_C0 * colour[3 * i + 2] + blue * steps.harmonic);
}
