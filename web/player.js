// The page: a time line over a 4D stream, drawn by the PlayCanvas engine.

import * as pc from './playcanvas.mjs';
import { Stream, valuesOf } from './stream.js';

const SH_C0 = 0.28209479177387814;
const $ = (id) => document.getElementById(id);
const query = new URLSearchParams(location.hash.slice(1));

function say(text, isError = false) {
    $('message').textContent = text;
    $('message').className = isError ? 'error' : '';
    document.body.dataset.state = isError ? 'error' : text ? 'busy' : 'ready';
}

async function load(name) {
    const answer = await fetch(name, { cache: 'no-store' }).catch(() => null);
    if (!answer) throw new Error(`${name}: no answer. Is ffgs view still running?`);
    if (!answer.ok) throw new Error(`${name}: ${answer.status} ${answer.statusText}`);
    return new Uint8Array(await answer.arrayBuffer());
}

async function loadJson(name) {
    const answer = await fetch(name, { cache: 'no-store' }).catch(() => null);
    return answer?.ok ? answer.json() : null;
}

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

/** A layer as the engine's splats; made again only when it outgrows its room. */
class LayerView {
    constructor(app, name) {
        this.app = app;
        this.entity = new pc.Entity(name);
        app.root.addChild(this.entity);
        this.room = 0;
    }

    show(values) {
        if (values.count > this.room) this.grow(Math.ceil(values.count * 1.25) + 256);
        const { container } = this;
        if (!container) return;
        const [center, color, scale, rotation] = ['dataCenter', 'dataColor', 'dataScale', 'dataRotation'].map((n) => container.getTexture(n));
        const [p, c, s, r] = [center, color, scale, rotation].map((t) => t.lock());
        for (let i = 0; i < values.count; i++) {
            for (let k = 0; k < 3; k++) {
                const v = values.position[3 * i + k];
                p[4 * i + k] = v;
                container.centers[3 * i + k] = v;
                c[4 * i + k] = half(Math.max(0, 0.5 + SH_C0 * values.colour[3 * i + k]));
                s[4 * i + k] = half(Math.exp(values.logScale[3 * i + k]));
                r[4 * i + k] = half(values.quat[4 * i + k + 1]);
            }
            c[4 * i + 3] = half(values.opacity[i]);
            r[4 * i + 3] = half(values.quat[4 * i]);
        }
        [center, color, scale, rotation].forEach((t) => t.unlock());
        container.update(values.count, true);
    }

    grow(room) {
        const format = pc.GSplatFormat.createDefaultFormat(this.app.graphicsDevice);
        const container = new pc.GSplatContainer(this.app.graphicsDevice, room, format);
        container.aabb = new pc.BoundingBox(new pc.Vec3(), new pc.Vec3(1e4, 1e4, 1e4));
        if (this.entity.gsplat) this.entity.removeComponent('gsplat');
        this.container?.destroy();
        this.entity.addComponent('gsplat', { resource: container });
        Object.assign(this, { container, room });
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
        this.layers = { still: new LayerView(app, 'static'), moving: new LayerView(app, 'moving') };
        this.target = new pc.Vec3();
        this.mode = 'orbit';
        this.orbit = { yaw: 0.6, pitch: 0.5, distance: 10 };
        app.scene.gsplat.antiAlias = stream.manifest.antialiased;
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
        this.layers.still.show(valuesOf(state.still, still));
        const values = valuesOf(state.moving, moving);
        this.layers.moving.show(values);
        this.middle = median(values) ?? this.middle ?? new pc.Vec3();
        if (this.shown < 0 || this.mode === 'follow') this.target.copy(this.middle);
        if (state.sky && state.sky !== this.sky) this.showSky(state.sky);
    }

    showSky(jpeg) {
        this.sky = jpeg;
        document.body.dataset.sky = 'loading';
        createImageBitmap(new Blob([jpeg], { type: 'image/jpeg' })).then((image) => {
            drawSky(this, image);
            document.body.dataset.sky = 'ready';
        }, () => {});
    }

    update() {
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
        this.moveCamera();
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
    }
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

/** A large sphere seen from inside with the equirectangular picture; made once, then its texture is replaced. */
function drawSky(player, image) {
    const device = player.app.graphicsDevice;
    const texture = new pc.Texture(device, { width: image.width, height: image.height, format: pc.PIXELFORMAT_RGBA8, mipmaps: false,
        addressU: pc.ADDRESS_REPEAT, addressV: pc.ADDRESS_CLAMP_TO_EDGE });
    texture.setSource(image);
    if (!player.dome) player.dome = makeDome(player);
    player.dome.material.setParameter('skyMap', texture);
    player.dome.texture?.destroy();
    player.dome.texture = texture;
}

function makeDome(player) {
    const { up, forward } = player.stream.manifest;
    const material = new pc.ShaderMaterial({
        uniqueName: 'ffgs-sky',
        attributes: { vertex_position: pc.SEMANTIC_POSITION },
        vertexGLSL: `
            attribute vec3 vertex_position;
            uniform mat4 matrix_view;
            uniform mat4 matrix_projection;
            varying vec3 direction;
            void main(void) {
                direction = vertex_position;
                vec4 p = matrix_projection * vec4(mat3(matrix_view) * vertex_position * 100.0, 1.0);
                gl_Position = p.xyww;
            }`,
        fragmentGLSL: `
            precision highp float;
            varying vec3 direction;
            uniform sampler2D skyMap;
            uniform vec3 skyUp;
            uniform vec3 skyForward;
            void main(void) {
                vec3 d = normalize(direction);
                float u = atan(dot(d, cross(skyForward, skyUp)), dot(d, skyForward)) / 6.28318530718 + 0.5;
                float v = acos(clamp(dot(d, skyUp), -1.0, 1.0)) / 3.14159265359;
                gl_FragColor = vec4(textureLod(skyMap, vec2(u, v), 0.0).rgb, 1.0);
            }`,
    });
    material.setParameter('skyUp', up);
    material.setParameter('skyForward', forward);
    material.cull = pc.CULLFACE_NONE;
    material.depthWrite = false;
    const entity = new pc.Entity('sky');
    const mesh = pc.Mesh.fromGeometry(player.app.graphicsDevice, new pc.SphereGeometry({ radius: 1, latitudeBands: 24, longitudeBands: 48 }));
    const instance = new pc.MeshInstance(mesh, material);
    instance.cull = false;
    entity.addComponent('render', { meshInstances: [instance], layers: [pc.LAYERID_WORLD] });
    player.app.root.addChild(entity);
    return { entity, material };
}

function listen(player) {
    const canvas = $('canvas');
    const pointers = new Map();
    canvas.addEventListener('contextmenu', (e) => e.preventDefault());
    canvas.addEventListener('pointerdown', (e) => {
        canvas.setPointerCapture(e.pointerId);
        pointers.set(e.pointerId, e);
    });
    const forget = (e) => pointers.delete(e.pointerId);
    canvas.addEventListener('pointerup', forget);
    canvas.addEventListener('pointercancel', forget);
    canvas.addEventListener('pointermove', (e) => {
        const last = pointers.get(e.pointerId);
        if (!last) return;
        const [dx, dy] = [e.clientX - last.clientX, e.clientY - last.clientY];
        const others = [...pointers.values()].filter((p) => p.pointerId !== e.pointerId);
        if (player.view()) player.choose('orbit');
        if (others.length) {
            const gap = (p) => Math.hypot(p.clientX - others[0].clientX, p.clientY - others[0].clientY);
            player.orbit.distance *= gap(last) / Math.max(1, gap(e));
        } else if (player.mode === 'fly') {
            player.camera.rotate(player.up.x * -dx * 0.2, player.up.y * -dx * 0.2, player.up.z * -dx * 0.2);
            player.camera.rotateLocal(-dy * 0.2, 0, 0);
        } else if (last.buttons === 2) {
            const shift = player.orbit.distance / canvas.clientHeight;
            player.target.add(player.camera.right.clone().mulScalar(-dx * shift)).add(player.camera.up.clone().mulScalar(dy * shift));
        } else {
            player.orbit.yaw -= dx * 0.006;
            player.orbit.pitch = Math.max(-1.5, Math.min(1.5, player.orbit.pitch + dy * 0.006));
        }
        pointers.set(e.pointerId, e);
    });
    canvas.addEventListener('wheel', (e) => {
        e.preventDefault();
        player.orbit.distance *= Math.exp(e.deltaY * 0.001);
    }, { passive: false });
    $('time').addEventListener('input', () => player.seek(Number($('time').value)));
    $('play').addEventListener('click', () => toggle(player));
    $('camera').addEventListener('change', () => player.choose($('camera').value));
    $('compare').addEventListener('change', () => player.update());
    for (const box of document.querySelectorAll('.layer')) {
        box.addEventListener('change', () => {
            const entity = player.layers[box.dataset.layer]?.entity ?? player.dome?.entity;
            if (entity) entity.enabled = box.checked;
        });
    }
    $('help').addEventListener('click', () => $('helptext').showModal());
    $('link').addEventListener('click', async () => {
        location.hash = linkTo(player);
        await navigator.clipboard?.writeText(location.href).catch(() => {});
    });
    dragEdge();
    keys(player);
    addEventListener('resize', () => player.update());
}

function toggle(player) {
    player.playing = !player.playing;
    player.clock = 0;
    if (player.playing && player.at === player.count - 1) player.seek(0);
    player.update();
}

function linkTo(player) {
    const { yaw, pitch, distance } = player.orbit;
    const numbers = [yaw, pitch, distance, player.target.x, player.target.y, player.target.z];
    return new URLSearchParams({ frame: player.at, view: player.mode, orbit: numbers.map((v) => v.toFixed(3)).join(',') }).toString();
}

function dragEdge() {
    const edge = $('edge');
    edge.addEventListener('pointerdown', (e) => edge.setPointerCapture(e.pointerId));
    edge.addEventListener('pointermove', (e) => {
        if (!e.buttons) return;
        const box = $('photo').getBoundingClientRect();
        const share = Math.max(0, Math.min(1, (e.clientX - box.left) / box.width));
        $('photo').style.setProperty('--edge', `${share * 100}%`);
    });
}

function keys(player) {
    const step = (n) => () => player.seek(player.at + n);
    const views = player.capture?.views.length ?? 0;
    const camera = (n) => () => {
        if (!views) return;
        const now = player.view() ? Number(player.mode) : n > 0 ? -1 : 0;
        player.choose(String((now + n + views) % views));
    };
    const actions = {
        ' ': () => toggle(player), ',': step(-1), '.': step(1), ArrowLeft: step(-1), ArrowRight: step(1),
        Home: () => player.seek(0), End: () => player.seek(player.count - 1), '[': camera(-1), ']': camera(1),
        p: () => $('compare').click(), o: () => player.choose('orbit'), f: () => player.choose('fly'), c: () => player.choose('follow'),
        '?': () => $('helptext').showModal(),
    };
    const fly = { w: [0, 0, -1], s: [0, 0, 1], a: [-1, 0, 0], d: [1, 0, 0], q: [0, -1, 0], e: [0, 1, 0] };
    addEventListener('keydown', (e) => {
        if (e.target.matches?.('input, select') || $('helptext').open || e.ctrlKey || e.metaKey) return;
        if (player.mode === 'fly' && fly[e.key]) {
            player.camera.translateLocal(...fly[e.key].map((v) => v * player.orbit.distance * 0.03));
        } else if (actions[e.key]) {
            e.preventDefault();
            actions[e.key]();
        }
    });
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
    app.setCanvasFillMode(pc.FILLMODE_NONE);
    app.setCanvasResolution(pc.RESOLUTION_AUTO);
    app.start();
    return app;
}

async function main() {
    say('loading …');
    const [app, stream, capture] = await Promise.all([makeApp(), Stream.open(load), loadJson('cameras.json')]);
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
    app.on('update', (seconds) => player.tick(seconds));
    setInterval(() => grow(player), 3000);
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
