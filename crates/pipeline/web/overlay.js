// Overlays: the colour of each moving Gaussian by how well its place is known, or by how it moves.

/** Dark blue over green to yellow, at equal distances. */
const RAMP = [[0.27, 0.0, 0.33], [0.23, 0.32, 0.55], [0.13, 0.57, 0.55], [0.37, 0.79, 0.38], [0.99, 0.91, 0.14]];

function ramp(share, rgb) {
    const at = Math.max(0, Math.min(1, share)) * (RAMP.length - 1);
    const low = Math.min(RAMP.length - 2, Math.floor(at));
    for (let k = 0; k < 3; k++) rgb[k] = RAMP[low][k] + (at - low) * (RAMP[low + 1][k] - RAMP[low][k]);
}

/** A value below which so large a share of them lies. */
function quantile(values, share) {
    const sorted = Float32Array.from(values).sort();
    return sorted[Math.min(sorted.length - 1, Math.floor(sorted.length * share))] ?? 0;
}

const figure = (v) => v.toPrecision(2);

function uncertainty(state) {
    if (!state.uncertainty) return { legend: 'this stream holds no uncertainty (ffgs export --uncertainty)' };
    const logs = state.uncertainty.map((v) => Math.log2(v));
    const [low, high] = [quantile(logs, 0.05), quantile(logs, 0.95)];
    const span = Math.max(1e-6, high - low);
    return {
        legend: `standard deviation of a position: dark ${figure(2 ** low)}, bright ${figure(2 ** high)} units`,
        paint: (i, rgb) => ramp((logs[i] - low) / span, rgb),
    };
}

function motion(state, manifest) {
    const moved = state.moved;
    if (!moved) return { legend: 'this is a key frame, which says nothing of motion: step to the next' };
    const step = manifest.dynamic.position * manifest.frames_per_second;
    const { up, forward } = manifest;
    const right = [forward[1] * up[2] - forward[2] * up[1], forward[2] * up[0] - forward[0] * up[2], forward[0] * up[1] - forward[1] * up[0]];
    const along = (i, axis) => moved[3 * i] * axis[0] + moved[3 * i + 1] * axis[1] + moved[3 * i + 2] * axis[2];
    const speeds = Float32Array.from({ length: state.moving.count }, (_, i) => Math.hypot(moved[3 * i], moved[3 * i + 1], moved[3 * i + 2]) * step);
    const fast = Math.max(1e-9, quantile(speeds, 0.95));
    return {
        legend: `hue: direction on the ground; brightness: speed, full at ${figure(fast)} units per second`,
        paint: (i, rgb) => {
            const angle = Math.atan2(along(i, right), along(i, forward));
            const value = Math.min(1, 0.15 + (0.85 * speeds[i]) / fast);
            for (let k = 0; k < 3; k++) rgb[k] = value * (0.5 + 0.5 * Math.cos(angle - (k * 2 * Math.PI) / 3));
        },
    };
}

/** How to paint the moving layer of a frame: a legend and, where there is something to show, the function `paint(row, rgb)`. */
export function overlayOf(name, state, manifest) {
    if (name === 'uncertainty') return uncertainty(state);
    if (name === 'motion') return motion(state, manifest);
    return { legend: '' };
}
