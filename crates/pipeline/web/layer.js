// A layer of Gaussians as the engine's splats, coloured as a camera sees them or by an overlay.

import * as pc from './playcanvas.mjs';

const SH_C0 = 0.28209479177387814;
const SH_C1 = 0.4886025119029199;
const SH_C2 = [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
const SH_C3 = [-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658, 1.445305721320277, -0.5900435899266435];
/** Values above degree 0 in a row. */
const STRIDE = 45;

/** Half-precision bits of a number. */
const half = (() => {
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

/** Values of the SH basis of 3D Gaussian Splatting above degree 0 for a unit direction; returns how many. */
function basis(degree, x, y, z, out) {
    if (degree === 0) return 0;
    out[0] = -SH_C1 * y;
    out[1] = SH_C1 * z;
    out[2] = -SH_C1 * x;
    if (degree === 1) return 3;
    const [xx, yy, zz] = [x * x, y * y, z * z];
    out[3] = SH_C2[0] * x * y;
    out[4] = SH_C2[1] * y * z;
    out[5] = SH_C2[2] * (2 * zz - xx - yy);
    out[6] = SH_C2[3] * x * z;
    out[7] = SH_C2[4] * (xx - yy);
    if (degree === 2) return 8;
    out[8] = SH_C3[0] * y * (3 * xx - yy);
    out[9] = SH_C3[1] * x * y * z;
    out[10] = SH_C3[2] * y * (4 * zz - xx - yy);
    out[11] = SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy);
    out[12] = SH_C3[4] * x * (4 * zz - xx - yy);
    out[13] = SH_C3[5] * z * (xx - yy);
    out[14] = SH_C3[6] * x * (xx - 3 * yy);
    return 15;
}

/** A layer as the engine's splats; made again only when it outgrows its room. */
export class LayerView {
    constructor(app, name, steps) {
        this.app = app;
        this.steps = steps;
        this.entity = new pc.Entity(name);
        app.root.addChild(this.entity);
        this.room = 0;
        this.values = null;
    }

    /** Shows values of `stream.js` with the harmonics of their rows. */
    show(values, harmonics) {
        Object.assign(this, { values, harmonics });
        if (values.count > this.room) this.grow(Math.ceil(values.count * 1.25) + 256);
        const { container } = this;
        if (!container) return;
        const [center, scale, rotation] = ['dataCenter', 'dataScale', 'dataRotation'].map((n) => container.getTexture(n));
        const [p, s, r] = [center, scale, rotation].map((t) => t.lock());
        for (let i = 0; i < values.count; i++) {
            for (let k = 0; k < 3; k++) {
                const v = values.position[3 * i + k];
                p[4 * i + k] = v;
                container.centers[3 * i + k] = v;
                s[4 * i + k] = half(Math.exp(values.logScale[3 * i + k]));
            }
            // The engine's formats have the real part first.
            for (let k = 0; k < 4; k++) r[4 * i + k] = half(values.quat[4 * i + k]);
        }
        [center, scale, rotation].forEach((t) => t.unlock());
        // The engine orders splats in a number of steps over these bounds: wide ones would mix near and far.
        container.aabb.compute(container.centers.subarray(0, 3 * Math.max(1, values.count)));
    }

    /** Colours for an eye, or those of an overlay: a function of a row and a place for red, green and blue. */
    colour(eye, overlay) {
        const { values, container, harmonics } = this;
        if (!container || !values) return;
        const texture = container.getTexture('dataColor');
        const c = texture.lock();
        const [b, rgb] = [new Float64Array(15), [0, 0, 0]];
        const { harmonic, sh_degree: degree } = this.steps;
        for (let i = 0; i < values.count; i++) {
            if (overlay) overlay(i, rgb);
            else {
                const [x, y, z] = [values.position[3 * i] - eye.x, values.position[3 * i + 1] - eye.y, values.position[3 * i + 2] - eye.z];
                const length = Math.sqrt(x * x + y * y + z * z) || 1;
                const count = basis(degree, x / length, y / length, z / length, b);
                for (let k = 0; k < 3; k++) {
                    let sum = 0;
                    for (let j = 0, at = STRIDE * i + k; j < count; j++, at += 3) sum += b[j] * harmonics[at];
                    rgb[k] = Math.max(0, 0.5 + SH_C0 * values.colour[3 * i + k] + sum * harmonic);
                }
            }
            for (let k = 0; k < 3; k++) c[4 * i + k] = half(rgb[k]);
            c[4 * i + 3] = half(values.opacity[i]);
        }
        texture.unlock();
        container.update(values.count, true);
    }

    grow(room) {
        const format = pc.GSplatFormat.createDefaultFormat(this.app.graphicsDevice);
        const container = new pc.GSplatContainer(this.app.graphicsDevice, room, format);
        container.aabb = new pc.BoundingBox();
        if (this.entity.gsplat) this.entity.removeComponent('gsplat');
        this.container?.destroy();
        this.entity.addComponent('gsplat', { resource: container });
        Object.assign(this, { container, room });
    }
}
