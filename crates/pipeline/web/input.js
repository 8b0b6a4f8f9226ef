// Pointers, keys and buttons.

import { record } from './record.js';

const $ = (id) => document.getElementById(id);

export function listen(player) {
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
        player.touch();
        const [dx, dy] = [e.clientX - last.clientX, e.clientY - last.clientY];
        const others = [...pointers.values()].filter((p) => p.pointerId !== e.pointerId);
        if (player.view()) player.choose('orbit');
        if (others.length) {
            const gap = (p) => Math.hypot(p.clientX - others[0].clientX, p.clientY - others[0].clientY);
            const nearer = gap(last) / Math.max(1, gap(e));
            if (player.mode === 'fly') player.camera.translateLocal(0, 0, (nearer - 1) * player.orbit.distance);
            else player.orbit.distance *= nearer;
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
        player.touch();
        player.orbit.distance *= Math.exp(e.deltaY * 0.001);
    }, { passive: false });
    $('time').addEventListener('input', () => player.seek(Number($('time').value)));
    $('play').addEventListener('click', () => toggle(player));
    $('back').addEventListener('click', () => player.seek(player.at - 1));
    $('next').addEventListener('click', () => player.seek(player.at + 1));
    $('bullet').addEventListener('click', () => player.freeze(!player.bullet));
    $('record').addEventListener('click', () => toggleRecording(player));
    $('overlay').addEventListener('change', () => player.lay($('overlay').value));
    $('camera').addEventListener('change', () => player.choose($('camera').value));
    $('quality').addEventListener('change', () => player.setQuality($('quality').value));
    $('compare').addEventListener('change', () => player.update());
    for (const box of document.querySelectorAll('.layer')) {
        box.addEventListener('change', () => {
            if (box.dataset.layer === 'sky') player.dome.entity.enabled = box.checked;
            else player.picture.hide(box.dataset.layer, !box.checked);
            player.wake();
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

let recorder = null;

function toggleRecording(player) {
    if (recorder) {
        recorder.stop();
        recorder = null;
    } else {
        recorder = record($('canvas'), player.stream.manifest.title);
        if (!recorder) $('legend').textContent = 'this browser cannot record a canvas';
    }
    $('record').setAttribute('aria-pressed', Boolean(recorder));
}

function linkTo(player) {
    const { yaw, pitch, distance } = player.orbit;
    const numbers = [yaw, pitch, distance, player.target.x, player.target.y, player.target.z];
    return new URLSearchParams({ frame: player.at, view: player.mode, overlay: player.overlay, orbit: numbers.map((v) => v.toFixed(3)).join(',') }).toString();
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

/** Whether a key is one that the control in focus understands itself. */
function isOwnKey({ target, key }) {
    return target.matches?.('select') || (target.matches?.('input[type=range]') && key.length > 1) || (target.matches?.('input[type=checkbox], button') && key === ' ');
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
        b: () => player.freeze(!player.bullet), r: () => toggleRecording(player),
        u: () => player.lay(player.overlay === 'uncertainty' ? 'none' : 'uncertainty'), m: () => player.lay(player.overlay === 'motion' ? 'none' : 'motion'),
        '?': () => $('helptext').showModal(),
    };
    const fly = { w: [0, 0, -1], s: [0, 0, 1], a: [-1, 0, 0], d: [1, 0, 0], q: [0, -1, 0], e: [0, 1, 0] };
    addEventListener('keydown', (e) => {
        if (isOwnKey(e) || $('helptext').open || e.ctrlKey || e.metaKey) return;
        if (player.mode === 'fly' && fly[e.key]) {
            player.camera.translateLocal(...fly[e.key].map((v) => v * player.orbit.distance * 0.03));
            player.touch();
        } else if (actions[e.key]) {
            e.preventDefault();
            actions[e.key]();
        }
    });
}
