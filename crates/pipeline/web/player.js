// The page: a time line over a 4D stream, drawn by the PlayCanvas engine.

import * as pc from './playcanvas.mjs';
import { opened, reopen } from './frames.js';
import { listen } from './input.js';
import { overlayOf } from './overlay.js';
import { Picture } from './picture.js';
import { Quality } from './quality.js';
import { drawSky } from './sky.js';

/** Radians per second around what moves, while time stands still. */
const BULLET_TURN = 0.7;
/** Milliseconds between two looks for new frames of a run that goes on. */
const LOOK_EVERY = 3000;
const $ = (id) => document.getElementById(id);
const query = new URLSearchParams(location.hash.slice(1));

function say(text, isError = false) {
    $('message').textContent = text;
    $('message').className = isError ? 'error' : '';
    document.body.dataset.state = isError ? 'error' : text ? 'busy' : 'ready';
}

async function loadJson(name) {
    const answer = await fetch(name, { cache: 'no-store' }).catch(() => null);
    return answer?.ok ? answer.json() : null;
}

/** The stream, as soon as there is one: a run that has just begun has none. */
async function openStream() {
    for (let stream = opened; ; stream = reopen()) {
        try {
            return await stream;
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
        this.picture = new Picture(app, stream.manifest);
        this.quality = new Quality(drawsInSoftware(app.graphicsDevice));
        this.pixelRatio = app.graphicsDevice.maxPixelRatio;
        this.overlay = 'none';
        app.autoRender = false;
        // Splats are sorted beside the drawing: the engine says when there is something new to draw.
        app.systems.gsplat.on('frame:request', () => { app.renderNextFrame = true; });
        this.bullet = false;
        Object.assign(this, { drewAt: null, touched: false, pose: new pc.Mat4() });
        this.target = new pc.Vec3();
        this.mode = 'orbit';
        this.orbit = { yaw: 0.6, pitch: 0.5, distance: 10 };
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
        this.middle = state.middle ? new pc.Vec3(state.middle) : this.middle ?? new pc.Vec3();
        if (this.shown < 0 || this.mode === 'follow') this.target.copy(this.middle);
        this.picture.frame = state;
        this.paint();
        if (state.sky && state.sky !== this.sky) this.showSky(state.sky);
        const last = this.count - 1;
        if (this.playing) this.stream.ahead(state.at < last ? state.at + 1 : 0);
    }

    /** Something has changed: a picture is drawn. */
    wake() {
        this.app.renderNextFrame = true;
    }

    /** Someone turns the camera. */
    touch() {
        this.touched = true;
        this.wake();
    }

    /** The moving layer in the colours of the overlay. */
    paint() {
        const state = this.picture.frame;
        if (!state) return;
        const { legend, paint } = overlayOf(this.overlay, state, this.stream.manifest);
        $('legend').textContent = legend;
        this.picture.paint = paint ?? null;
        this.picture.stale = true;
        this.wake();
    }

    lay(overlay) {
        this.overlay = overlay;
        $('overlay').value = overlay;
        this.paint();
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
        this.advance(seconds);
        if (this.bullet) this.orbit.yaw += seconds * BULLET_TURN;
        this.moveCamera();
        const pose = this.camera.getWorldTransform();
        const turned = !pose.equals(this.pose);
        this.pose.copy(pose);
        this.tickedAt = performance.now();
        this.adapt(this.tickedAt, turned || this.playing || this.bullet || this.touched);
        this.touched = false;
        if (turned || this.playing || this.bullet) this.wake();
    }

    /** While playing, the frame that it is time for. */
    advance(seconds) {
        if (!this.playing || this.busy) return;
        this.clock += seconds * this.stream.manifest.frames_per_second * Number($('speed').value);
        if (this.clock < 1) return;
        const next = this.at + Math.min(Math.floor(this.clock), this.count);
        this.clock %= 1;
        const over = next > this.count - 1;
        if (over && !$('loop').checked) this.playing = false;
        this.seek(over ? ($('loop').checked ? 0 : this.count - 1) : next);
    }

    /** Chooses how much is drawn, by how long the last picture took, and puts it into the engine. */
    adapt(now, moves) {
        const { quality, picture } = this;
        if (this.drewAt !== null) quality.drawn(now, now - this.drewAt, picture.splats, picture.seen);
        this.drewAt = null;
        const rested = quality.rests;
        quality.tick(now, moves);
        if (quality.rests && !rested) picture.settle();
        const [device, ratio] = [this.app.graphicsDevice, quality.pixels * this.pixelRatio];
        if (device.maxPixelRatio !== ratio) {
            device.maxPixelRatio = ratio;
            this.wake();
        }
        if (picture.update(this.camera, this.target, quality)) this.wake();
        Object.assign(document.body.dataset, { coloured: this.shown, quality: picture.coarse ? 'reduced' : 'full' });
    }

    /** A picture has been drawn; the time to the next tick is what it took. */
    drawn() {
        this.drewAt = this.tickedAt;
    }

    setQuality(setting) {
        this.quality.choose(setting);
        $('quality').value = setting;
        this.wake();
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
        expose(view.exposures?.[Math.min(entry?.frame ?? 0, view.exposures.length - 1)]);
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

/** Whether the processor draws, by the name that the browser gives. */
function drawsInSoftware(device) {
    const { description, architecture } = device.gpuAdapter?.info ?? {};
    return /swiftshader|llvmpipe|softpipe|software|basic render/i.test([device.unmaskedRenderer, description, architecture].join(' '));
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
    // Sorted beside the drawing on WebGPU too: what sorts in the graphics processor projects by a shader that cannot be changed.
    app.scene.gsplat.renderer = pc.GSPLAT_RENDERER_RASTER_CPU_SORT;
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
    player.setQuality(query.get('quality') ?? 'auto');
    // The first picture counts as motion: where pictures are slow it is there the sooner.
    player.touch();
    app.on('update', (seconds) => player.tick(seconds));
    app.on('postrender', () => player.drawn());
    setInterval(() => grow(player), LOOK_EVERY);
}

/** Distance that holds most of what moves. */
function spread(player) {
    const columns = player.stream.state?.moving;
    if (!columns?.count) return 10;
    const { center } = columns;
    const { x, y, z } = player.target;
    const away = Float32Array.from({ length: columns.count }, (_, i) => Math.hypot(center[4 * i] - x, center[4 * i + 1] - y, center[4 * i + 2] - z)).sort();
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
