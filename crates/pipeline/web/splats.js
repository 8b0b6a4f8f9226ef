// Gaussians as the engine's splats: their shapes, and their colours as an eye sees them or as an overlay paints them.

import * as pc from './playcanvas.mjs';
import { colourOf } from './colours.js';
import { half } from './columns.js';

/** Splats for which there is always room, and how many times as much room as splats there may be. */
const LEAST_ROOM = 1024;
const SPARE = 3;

/** Copies rows of a column with so many values a row. */
function copy(from, to, at, rows, count, width) {
    if (!rows) to.set(from.subarray(0, width * count), width * at);
    else for (let j = 0; j < count; j++) for (let k = 0; k < width; k++) to[width * (at + j) + k] = from[width * rows[j] + k];
}

/** The number of rows of a part. */
const countOf = ({ rows, columns }) => rows?.length ?? columns.count;

/** Some splats of the engine; made again only when they outgrow their room. */
export class Splats {
    constructor(app, name) {
        this.app = app;
        this.entity = new pc.Entity(name);
        app.root.addChild(this.entity);
        this.room = 0;
        this.parts = [];
    }

    /** Shows parts of layers, each `{ columns, rows, wider, steps, paint }`; without `rows` all of them, without `paint` in their own colours. */
    show(parts, eye) {
        this.parts = parts;
        const count = parts.reduce((sum, part) => sum + countOf(part), 0);
        // Whole textures go to the graphics processor with each change: much room costs time.
        if (count > this.room || SPARE * count + LEAST_ROOM < this.room) this.grow(Math.ceil(count * 1.25) + LEAST_ROOM);
        const { container } = this;
        if (!container) return;
        const textures = ['dataCenter', 'dataScale', 'dataRotation'].map((n) => container.getTexture(n));
        const [center, scale, rotation] = textures.map((t) => t.lock());
        let at = 0;
        for (const part of parts) {
            const { columns, rows, wider } = part;
            const n = countOf(part);
            copy(columns.center, center, at, rows, n, 4);
            if (rows) for (let j = 0; j < n; j++) for (let k = 0; k < 3; k++) scale[4 * (at + j) + k] = half(wider[j] * columns.size[3 * rows[j] + k]);
            else copy(columns.scale, scale, at, rows, n, 4);
            copy(columns.rotation, rotation, at, rows, n, 4);
            at += n;
        }
        for (let i = 0; i < count; i++) for (let k = 0; k < 3; k++) container.centers[3 * i + k] = center[4 * i + k];
        textures.forEach((t) => t.unlock());
        // The engine orders splats in a number of steps over these bounds: wide ones would mix near and far.
        container.aabb.compute(container.centers.subarray(0, 3 * Math.max(1, count)));
        this.paint(eye);
        container.update(count, true);
    }

    /** New colours of the same splats. */
    colour(eye) {
        if (!this.container) return;
        this.paint(eye);
        this.entity.gsplat.workBufferUpdate = pc.WORKBUFFER_UPDATE_ONCE;
    }

    /** Has the splats sorted anew. */
    sort() {
        this.container?.update(this.container.numSplats, true);
    }

    paint(eye) {
        const texture = this.container.getTexture('dataColor');
        const [out, rgb] = [texture.lock(), [0, 0, 0]];
        let at = 0;
        for (const part of this.parts) {
            const { columns, rows, steps, paint } = part;
            for (let j = 0, n = countOf(part); j < n; j++, at += 4) {
                const i = rows ? rows[j] : j;
                if (paint) paint(i, rgb);
                else colourOf(columns, steps, i, eye, rgb);
                for (let k = 0; k < 3; k++) out[at + k] = half(rgb[k]);
                out[at + 3] = half(columns.opacity[i]);
            }
        }
        texture.unlock();
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
