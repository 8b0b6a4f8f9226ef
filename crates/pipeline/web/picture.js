// What the engine draws of a frame: all Gaussians, or those that matter most.

import * as pc from './playcanvas.mjs';
import { choose } from './choice.js';
import { Splats } from './splats.js';

/** Share of its distance that the camera may move before colours are computed again. */
const RECOLOUR = 0.02;
/** The same, and an angle in radians, before Gaussians are chosen again. */
const RECHOOSE = 0.1;
/** Most milliseconds that splats wait for those before them to be sorted. */
const PATIENCE = 1000;
/** How much more a moving Gaussian counts than one of the static layer. */
const MOVING_COUNTS = 4;
/** Opacity at which splats end, where all are drawn and where only some are: faint edges cost a third of the time and are not missed there. */
const ENDS = [1 / 255, 8 / 255];

export class Picture {
    constructor(app, manifest) {
        this.steps = { still: manifest.static, moving: manifest.dynamic };
        this.whole = { still: new Splats(app, 'static'), moving: new Splats(app, 'moving') };
        this.some = new Splats(app, 'chosen');
        this.hidden = { still: false, moving: false };
        Object.assign(this, { app, frame: null, paint: null, stale: false, coarse: false, budget: Infinity, splats: 0, seen: 0 });
        Object.assign(this, { eye: new pc.Vec3(), forward: new pc.Vec3() });
        // Splats that came before these were sorted would be drawn in the order of these.
        app.systems.gsplat.on('frame:ready', (camera, layer, ready) => { this.ready = ready; });
        Object.assign(this, { ready: true, changedAt: 0 });
        app.scene.gsplat.antiAlias = manifest.antialiased;
        // Nothing is too small to be drawn: the reconstruction is of such splats.
        Object.assign(app.scene.gsplat, { minPixelSize: 0, minContribution: 0, dataFormat: pc.GSPLATDATA_LARGE });
        app.scene.exposure = 1;
    }

    hide(layer, hidden) {
        this.hidden[layer] = hidden;
        this.stale = true;
    }

    /** Puts into the engine what has changed; whether there was something. */
    update(camera, target, { budget }) {
        const now = performance.now();
        if (!this.frame || (!this.ready && now - this.changedAt < PATIENCE)) return false;
        const eye = camera.getPosition();
        const coarse = budget < Infinity;
        const moved = eye.distance(this.eye) > (coarse ? RECHOOSE : RECOLOUR) * eye.distance(target);
        const turned = camera.forward.dot(this.forward) < Math.cos(RECHOOSE);
        const other = coarse !== this.coarse || (coarse && Math.abs(budget - this.budget) > 0.1 * this.budget);
        if (!this.stale && !other && !moved && !(coarse && turned)) return false;
        this.eye.copy(eye);
        this.forward.copy(camera.forward);
        if (coarse !== this.coarse) this.app.scene.gsplat.alphaClipForward = ENDS[coarse ? 1 : 0];
        if (coarse || this.stale || other) Object.assign(this, { ready: false, changedAt: now });
        if (coarse) this.drawSome(camera, budget);
        else if (this.stale || other) this.drawAll();
        else Object.values(this.whole).forEach((splats) => splats.colour(eye));
        Object.assign(this, { coarse, budget, stale: false });
        return true;
    }

    /** The camera has stopped: the engine may have dropped its last wish to sort. */
    settle() {
        if (!this.coarse) for (const splats of Object.values(this.whole)) splats.sort();
    }

    part(name, { rows, wider } = {}) {
        return { columns: this.frame[name], rows, wider, steps: this.steps[name], paint: name === 'moving' ? this.paint : null };
    }

    drawAll() {
        this.some.entity.enabled = false;
        this.splats = 0;
        for (const name of ['still', 'moving']) {
            const { entity } = this.whole[name];
            entity.enabled = !this.hidden[name];
            if (entity.enabled) this.whole[name].show([this.part(name)], this.eye);
            this.splats += entity.enabled ? this.frame[name].count : 0;
        }
        this.seen = this.splats;
    }

    drawSome(camera, budget) {
        for (const { entity } of Object.values(this.whole)) entity.enabled = false;
        this.some.entity.enabled = true;
        const names = ['still', 'moving'].filter((name) => !this.hidden[name]);
        const layers = names.map((name) => ({ columns: this.frame[name], weight: name === 'moving' ? MOVING_COUNTS : 1 }));
        const projection = projectionOf(camera.camera);
        const matrix = new pc.Mat4().mul2(projection, camera.getWorldTransform().clone().invert());
        const { chosen, seen } = choose(layers, matrix.data, [projection.data[0], projection.data[5]], budget);
        this.some.show(names.map((name, k) => this.part(name, chosen[k])), this.eye);
        this.splats = chosen.reduce((sum, { rows }) => sum + rows.length, 0);
        this.seen = seen;
    }
}

/** The lens that the next picture is drawn with. */
function projectionOf(camera) {
    const out = new pc.Mat4();
    if (camera.calculateProjection) camera.calculateProjection(out);
    else out.copy(camera.projectionMatrix);
    return out;
}
