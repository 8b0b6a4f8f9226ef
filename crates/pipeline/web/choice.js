// Which Gaussians stand for all in a picture that must be drawn fast.
//
// Those that are opaque and large in the picture are drawn as they are. Of the others some are drawn, the larger ones more likely, and
// these are widened, so that together they cover as much as all did: without that the picture would get holes.

/** Bits of a score that its bin leaves out: what remains is the exponent and three bits below it. */
const LEFT_OUT = 20;
/** A Gaussian is widened by at most this factor. */
const WIDEST = 4;

/** The area that each Gaussian covers in the picture, times its opacity; 0 where it is not in the picture. `m`: clip space from world. */
function scores({ count, center, area, reach, opacity }, m, [wide, high], weight) {
    const out = new Float32Array(count);
    const most = 4 / (wide * high);
    for (let i = 0; i < count; i++) {
        const [x, y, z] = [center[4 * i], center[4 * i + 1], center[4 * i + 2]];
        const w = m[3] * x + m[7] * y + m[11] * z + m[15];
        const over = Math.max(Math.abs(m[0] * x + m[4] * y + m[8] * z + m[12]) - wide * reach[i], Math.abs(m[1] * x + m[5] * y + m[9] * z + m[13]) - high * reach[i]);
        out[i] = w > 0 && over < w ? weight * opacity[i] * Math.min(area[i] / (w * w), most) : 0;
    }
    return out;
}

/** The score from which on all are drawn, if those below are drawn with the likelihood score / threshold; and how many have one. */
function threshold(all, budget) {
    const bins = 1 << (32 - LEFT_OUT);
    const [counts, sums] = [new Uint32Array(bins), new Float64Array(bins)];
    for (const values of all) {
        const bits = new Uint32Array(values.buffer);
        for (let i = 0; i < values.length; i++) {
            counts[bits[i] >>> LEFT_OUT]++;
            sums[bits[i] >>> LEFT_OUT] += values[i];
        }
    }
    const start = new Float32Array(Uint32Array.from({ length: bins }, (_, bin) => bin << LEFT_OUT).buffer);
    const seen = counts.reduce((a, b) => a + b) - counts[0];
    let [bin, above, below] = [bins - 1, 0, sums.reduce((a, b) => a + b)];
    for (; bin > 0; bin--) {
        above += counts[bin];
        below -= sums[bin];
        if (above + below / start[bin] > budget) break;
    }
    return { least: start[Math.min(bins - 1, bin + 1)], seen, all: seen <= budget };
}

/** A number of 0 to 1 that belongs to a row, so that the same Gaussians are drawn while the camera turns. */
const lot = (i) => (Math.imul(i + 1, 0x9e3779b1) >>> 0) / 2 ** 32;

/**
 * The rows of each layer that are drawn, about `budget` of all, and the factors by which they are widened; `seen` is how many are in the
 * picture. `matrix` leads from the world to clip space, `lens` has the factors of its projection; `weight` says how much a layer counts.
 */
export function choose(layers, matrix, lens, budget) {
    const all = layers.map(({ columns, weight }) => scores(columns, matrix, lens, weight));
    const { least, seen, all: fits } = threshold(all, budget);
    const chosen = all.map((values) => {
        const [rows, wider] = [new Uint32Array(values.length), new Float32Array(values.length)];
        let n = 0;
        for (let i = 0; i < values.length; i++) {
            const likely = fits && values[i] > 0 ? 1 : values[i] / least;
            if (likely <= lot(i)) continue;
            rows[n] = i;
            wider[n++] = Math.min(WIDEST, 1 / Math.sqrt(Math.min(1, likely)));
        }
        return { rows: rows.subarray(0, n), wider: wider.subarray(0, n) };
    });
    return { chosen, seen };
}
