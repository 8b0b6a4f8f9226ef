// The page: a time line over a 4D stream, drawn by the PlayCanvas engine.

import * as pc from './playcanvas.mjs';
import { listen } from './input.js';
import { LayerView } from './layer.js';
import { overlayOf } from './overlay.js';
import { drawSky } from './sky.js';
import { Stream, valuesOf } from './stream.js';

/** Share of its distance that the camera may move before colours are computed again. */
const RECOLOUR = 0.02;
/** Radians per second around what moves, while time stands still. */
const BULLET_TURN = 0.7;
/** Seconds for which pictures are drawn after a change: splats are sorted beside the drawing. */
const AWAKE = 1.5;
/** Milliseconds between two looks for new frames of a run that goes on. */
const LOOK_EVERY = 3000;
const $ = (id) => document.getElementById(id);
const query = new URLSearchParams(location.hash.slice(1));

function say(text, isError = false) {
    $('message').textContent = text;
    $('message').className = isError ? 'error' : '';
    document.body.dataset.state = isError ? 'error' : text ? 'busy' : 'ready';
}

async function load(name) {
    const answer = await fetch(name, { cache: 'no-store' }).catch(() => null);
    if (!answer) throw new Error(`${name}: no answer. Is ffgs still running?`);
    if (!answer.ok) throw new Error(`${name}: ${answer.status} ${answer.statusText}`);
    return new Uint8Array(await answer.arrayBuffer());
}

async function loadJson(name) {
    const answer = await fetch(name, { cache: 'no-store' }).catch(() => null);
    return answer?.ok ? answer.json() : null;
}

/** The stream, as soon as there is one: a run that has just begun has none. */
async function openStream() {
    for (;;) {
        try {
            return await Stream.open(load);
        } catch (error) {
            if (!error.message.includes(': 404')) throw error;
            say('No frame is finished yet: this page goes on when there is one.');
            await new Promise((done) => setTimeout(done, LOOK_EVERY));
        }
    }
}

/** The pose of a camera with OpenCV axes as an entity's. */
function place(entity, worldFromCamera) {
    const m = new pc.Mat4();
    const d = worldFromCamera;
    // Columns: right, up, back.
    m.set([d[0], d[4], d[8], 0, -d[1], -d[5], -d[9], 0, -d[2], -d[6], -d[10], 0, d[3], d[7], d[11], 1]);
    entity.setPosition(m.getTranslation());
    entity.setRotation(new pc.Quat().setFromMat4(m));
}

class Player {
    constructor(app, stream, capture) {
        Object.assign(this, { app, stream, capture, at: 0, shown: -1, playing: false, clock: 0, busy: false });
        this.up = new pc.Vec3(stream.manifest.up);
        this.camera = new pc.Entity('camera');
        this.camera.addComponent('camera', { clearColor: new pc.Color(0, 0, 0), nearClip: 0.05, farClip: 10000, fov: 60 });
        app.root.addChild(this.camera);
        this.layers = { still: new LayerView(app, 'static', stream.manifest.static), moving: new LayerView(app, 'moving', stream.manifest.dynamic) };
        this.overlay = 'none';
        this.awake = AWAKE;
        app.autoRender = false;
        this.bullet = false;
        this.colouredFrom = null;
        this.target = new pc.Vec3();
        this.mode = 'orbit';
        this.orbit = { yaw: 0.6, pitch: 0.5, distance: 10 };
        app.scene.gsplat.antiAlias = stream.manifest.antialiased;
        // Nothing is too small to be drawn: the reconstruction is of such splats.
        Object.assign(app.scene.gsplat, { minPixelSize: 0, minContribution: 0, dataFormat: pc.GSPLATDATA_LARGE });
        app.scene.exposure = 1;
        this.sky = null;
    }

    get count() {
        return this.stream.entries.length;
    }

    /** Shows a frame by its place; calls made meanwhile are answered by the last of them. */
    async seek(at) {
        this.at = Math.max(0, Math.min(this.count - 1, at));
        if (this.busy) return;
        this.busy = true;
        try {
            while (this.shown !== this.at) {
                const wanted = this.at;
                const state = await this.stream.read(wanted);
                this.show(state);
                this.shown = wanted;
            }
            say('');
        } catch (error) {
            this.playing = false;
            this.shown = this.at;
            say(error.message, true);
        } finally {
            this.busy = false;
            this.update();
        }
    }

    show(state) {
        const { static: still, dynamic: moving } = this.stream.manifest;
        this.layers.still.show(valuesOf(state.still, still), state.still.harmonics);
        const values = valuesOf(state.moving, moving);
        this.layers.moving.show(values, state.moving.harmonics);
        this.middle = median(values) ?? this.middle ?? new pc.Vec3();
        if (this.shown < 0 || this.mode === 'follow') this.target.copy(this.middle);
        this.colouredFrom = null;
        if (state.sky && state.sky !== this.sky) this.showSky(state.sky);
    }

    /** Something has changed: pictures are drawn for a while. */
    wake() {
        this.awake = AWAKE;
    }

    /** Colours depend on where one looks from: computed for each frame, and again when the camera has moved. */
    colour() {
        const eye = this.camera.getPosition();
        const near = this.colouredFrom && eye.distance(this.colouredFrom) <= RECOLOUR * eye.distance(this.target);
        const state = this.stream.state;
        if (near || this.busy || !state?.moving) return;
        this.colouredFrom = eye.clone();
        const { legend, paint } = overlayOf(this.overlay, state, this.stream.manifest);
        $('legend').textContent = legend;
        this.layers.still.colour(eye, null);
        this.layers.moving.colour(eye, paint);
        document.body.dataset.coloured = this.shown;
    }

    lay(overlay) {
        this.overlay = overlay;
        this.wake();
        $('overlay').value = overlay;
        this.colouredFrom = null;
    }

    showSky(jpeg) {
        this.sky = jpeg;
        document.body.dataset.sky = 'loading';
        createImageBitmap(new Blob([jpeg], { type: 'image/jpeg' })).then((image) => {
            drawSky(this, image);
            this.wake();
            document.body.dataset.sky = 'ready';
        }, () => {});
    }

    update() {
        this.wake();
        $('time').max = Math.max(0, this.count - 1);
        $('time').value = this.at;
        $('frame').textContent = this.count ? `${this.stream.entries[this.at].frame} (${this.at + 1}/${this.count})` : '-';
        $('play').textContent = this.playing ? '⏸' : '▶';
        document.body.dataset.frame = this.shown;
        this.showPhotograph();
        this.moveCamera();
    }

    tick(seconds) {
        if (this.playing && !this.busy) {
            this.clock += seconds * this.stream.manifest.frames_per_second * Number($('speed').value);
            if (this.clock >= 1) {
                const next = this.at + Math.min(Math.floor(this.clock), this.count);
                this.clock %= 1;
                const over = next > this.count - 1;
                if (over && !$('loop').checked) this.playing = false;
                this.seek(over ? ($('loop').checked ? 0 : this.count - 1) : next);
            }
        }
        if (this.bullet) this.orbit.yaw += seconds * BULLET_TURN;
        if (this.playing || this.bullet) this.wake();
        this.moveCamera();
        this.colour();
        this.awake -= seconds;
        this.app.renderNextFrame = this.awake > 0;
    }

    /** Time stands still while the camera goes around. */
    freeze(on) {
        this.bullet = on;
        $('bullet').setAttribute('aria-pressed', on);
        if (on) {
            this.playing = false;
            if (this.mode !== 'follow') this.choose('orbit');
        }
        this.update();
    }

    view() {
        return this.capture?.views[Number(this.mode)];
    }

    moveCamera() {
        const view = this.view();
        if (view) {
            const frame = this.stream.entries[this.at]?.frame ?? 0;
            const pose = view.world_from_camera[Math.min(frame, view.world_from_camera.length - 1)];
            place(this.camera, pose);
            this.project(view);
        } else {
            this.camera.camera.calculateProjection = null;
            if (this.mode !== 'fly') this.turn();
        }
    }

    /** The lens of a view, fitted into the canvas with its own principal point. */
    project({ width, height, fx, fy, cx, cy }) {
        const box = this.fit(width, height);
        this.camera.camera.calculateProjection = (matrix) => {
            const [near, far] = [this.camera.camera.nearClip, this.camera.camera.farClip];
            // The picture lies at `box` in a canvas of `size`: widen the frustum by what is around it.
            const left = (-cx - box.x / box.scale) * near / fx;
            const right = left + (box.canvas[0] / box.scale) * near / fx;
            const top = (cy + box.y / box.scale) * near / fy;
            const bottom = top - (box.canvas[1] / box.scale) * near / fy;
            matrix.setFrustum(left, right, bottom, top, near, far);
        };
    }

    fit(width, height) {
        const canvas = [$('canvas').clientWidth, $('canvas').clientHeight];
        const scale = Math.min(canvas[0] / width, canvas[1] / height);
        return { scale, canvas, x: (canvas[0] - width * scale) / 2, y: (canvas[1] - height * scale) / 2 };
    }

    turn() {
        if (this.mode === 'follow') this.target.copy(this.middle ?? this.target);
        const { yaw, pitch, distance } = this.orbit;
        const forward = new pc.Vec3(this.stream.manifest.forward);
        const right = new pc.Vec3().cross(forward, this.up);
        const eye = new pc.Vec3();
        eye.add(forward.mulScalar(-Math.cos(yaw) * Math.cos(pitch) * distance));
        eye.add(right.mulScalar(Math.sin(yaw) * Math.cos(pitch) * distance));
        eye.add(this.up.clone().mulScalar(Math.sin(pitch) * distance));
        eye.add(this.target);
        this.camera.setPosition(eye);
        this.camera.lookAt(this.target, this.up);
    }

    choose(mode) {
        this.mode = mode;
        $('camera').value = mode;
        $('compare').disabled = !this.view()?.photographs;
        this.update();
    }

    showPhotograph() {
        const view = this.view();
        const entry = this.stream.entries[this.at];
        const name = view?.photographs?.[Math.min(entry?.frame ?? 0, view.photographs.length - 1)];
        const shows = $('compare').checked && Boolean(name);
        $('photo').hidden = !shows;
        if (!shows) return;
        const box = this.fit(view.width, view.height);
        Object.assign($('photo').style, { left: `${box.x}px`, top: `${box.y}px`, width: `${view.width * box.scale}px`, height: `${view.height * box.scale}px` });
        if (!$('photograph').src.endsWith(name)) $('photograph').src = name;
        expose(view.exposure);
    }
}

/** Shows the photograph in the exposure that all cameras share, which the page renders: `offsets` of its log odds are removed. */
function expose(offsets) {
    const value = (offset, v) => v / (v + (1 - v) * Math.exp(offset));
    const steps = Array.from({ length: 65 }, (_, i) => i / 64);
    (offsets ?? []).forEach((offset, c) => {
        const table = steps.map((v) => value(offset, v)).join(' ');
        document.querySelectorAll('#exposure feComponentTransfer > *')[c].setAttribute('tableValues', table);
    });
    $('photograph').style.filter = offsets ? 'url(#exposure)' : '';
}

/** Median position of the opaque half of a layer. */
function median(values) {
    if (!values.count) return null;
    const axis = (k) => {
        const column = Float32Array.from({ length: values.count }, (_, i) => values.position[3 * i + k]).sort();
        return column[column.length >> 1];
    };
    return new pc.Vec3(axis(0), axis(1), axis(2));
}

/**
 * Draws splats as the reconstruction was trained: the engine measures them in half pixels, but widens them by 0.3 as others do in
 * whole ones; it cuts large ones off, and linearises the lens also far outside the picture.
 */
function drawAsTrained(device) {
    const [language, vec2] = device.isWebGPU ? [pc.SHADERLANGUAGE_WGSL, 'vec2f'] : [pc.SHADERLANGUAGE_GLSL, 'vec2'];
    const chunks = pc.ShaderChunks.get(device, language);
    const edge = `1.3 / abs(${vec2}(center.projMat00, center.projMat11))`;
    const changes = [[/\+ 0\.3\b/g, '+ 1.2'],
        [/-J1 \/ vp\.z \* vp\.xy/, `-J1 * clamp(vp.xy / vp.z, -${edge}, ${edge})`]];
    const change = (text, [from, to]) => {
        if (!text?.match(from)) throw new Error('this version of the engine is not the one that the page is written for');
        return text.replace(from, to);
    };
    chunks.set('gsplatCornerVS', changes.reduce(change, chunks.get('gsplatCornerVS')));
}

async function makeApp() {
    const canvas = $('canvas');
    const types = [query.get('device') ?? 'webgl2', 'webgl2'];
    const device = await pc.createGraphicsDevice(canvas, { deviceTypes: types, antialias: false }).catch(() => null);
    if (!device) throw new Error('This browser has no WebGL2, which the player needs. Switch on hardware acceleration, or use another browser.');
    const options = new pc.AppOptions();
    options.graphicsDevice = device;
    options.componentSystems = [pc.CameraComponentSystem, pc.GSplatComponentSystem, pc.RenderComponentSystem];
    options.resourceHandlers = [];
    const app = new pc.AppBase(canvas);
    app.init(options);
    drawAsTrained(device);
    app.setCanvasFillMode(pc.FILLMODE_NONE);
    app.setCanvasResolution(pc.RESOLUTION_AUTO);
    app.start();
    return app;
}

async function main() {
    say('loading …');
    const [app, stream, capture] = await Promise.all([makeApp(), openStream(), loadJson('cameras.json')]);
    document.title = stream.manifest.title;
    const player = new Player(app, stream, capture);
    globalThis.player = player;
    for (const [i, view] of (capture?.views ?? []).entries()) $('camera').add(new Option(`${view.split} ${view.name}`, String(i)));
    listen(player);
    if (!player.count) say('No frame is finished yet: this page goes on when there is one.');
    else await player.seek(Number(query.get('frame') ?? 0));
    const orbit = query.get('orbit')?.split(',').map(Number);
    if (orbit?.length === 6 && orbit.every(Number.isFinite)) {
        [player.orbit.yaw, player.orbit.pitch, player.orbit.distance] = orbit;
        player.target.set(orbit[3], orbit[4], orbit[5]);
    } else {
        player.orbit.distance = 1.5 * spread(player);
    }
    player.choose(query.get('view') ?? 'orbit');
    player.lay(query.get('overlay') ?? 'none');
    app.on('update', (seconds) => player.tick(seconds));
    setInterval(() => grow(player), LOOK_EVERY);
}

/** Distance that holds most of what moves. */
function spread(player) {
    const rows = player.stream.state?.moving;
    if (!rows?.count) return 10;
    const step = player.stream.manifest.dynamic.position;
    const away = Float32Array.from({ length: rows.count }, (_, i) => Math.hypot(
        rows.position[3 * i] * step - player.target.x, rows.position[3 * i + 1] * step - player.target.y,
        rows.position[3 * i + 2] * step - player.target.z)).sort();
    return Math.max(1e-3, away[Math.floor(away.length * 0.9)]);
}

/** Frames that a run has finished since. */
async function grow(player) {
    const before = player.count;
    await player.stream.refresh().catch(() => {});
    if (player.count === before) return;
    if (before === 0) await player.seek(0);
    player.update();
}

main().catch((error) => say(error.message, true));
