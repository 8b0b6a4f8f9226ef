// The rows of a layer as columns that the engine's textures hold, and what the choice of splats asks for. Made beside the page.

import { valuesOf } from './stream.js';

/** Standard deviations to which a splat reaches. */
const REACH = 3;

/** Half-precision bits of a number. */
export const half = (() => {
    const f = new Float32Array(1);
    const i = new Uint32Array(f.buffer);
    return (v) => {
        f[0] = v;
        const x = i[0];
        const sign = (x >>> 16) & 0x8000;
        const e = ((x >>> 23) & 255) - 112;
        if (e >= 31) return sign | 0x7bff;
        if (e <= 0) return e < -10 ? sign : sign | (((x & 0x7fffff) | 0x800000) >>> (14 - e));
        return sign | ((e << 10) + ((x & 0x7fffff) >>> 13) + ((x >>> 12) & 1));
    };
})();

/** The columns of some rows: `center`, `scale` and `rotation` as in the engine's textures; `size` has the standard deviations, `area` and `reach` are those of a splat at distance 1. */
export function columnsOf(rows, steps) {
    const n = rows.count;
    const { position, quat, logScale, colour, opacity } = valuesOf(rows, steps);
    const out = { count: n, center: new Float32Array(4 * n), scale: new Uint16Array(4 * n), rotation: new Uint16Array(4 * n),
        size: new Float32Array(3 * n), area: new Float32Array(n), reach: new Float32Array(n), opacity, colour, harmonics: rows.harmonics.slice(0, 45 * n) };
    const s = [0, 0, 0];
    for (let i = 0; i < n; i++) {
        for (let k = 0; k < 3; k++) {
            s[k] = Math.exp(logScale[3 * i + k]);
            out.center[4 * i + k] = position[3 * i + k];
            out.size[3 * i + k] = s[k];
            out.scale[4 * i + k] = half(s[k]);
        }
        // The engine's formats have the real part first.
        for (let k = 0; k < 4; k++) out.rotation[4 * i + k] = half(quat[4 * i + k]);
        out.area[i] = (2 * Math.PI * s[0] * s[1] * s[2]) / Math.min(s[0], s[1], s[2]);
        out.reach[i] = REACH * Math.max(s[0], s[1], s[2]);
    }
    return out;
}

/** Median position of a layer. */
export function middleOf({ count, center }) {
    if (!count) return null;
    return [0, 1, 2].map((k) => Float32Array.from({ length: count }, (_, i) => center[4 * i + k]).sort()[count >> 1]);
}
