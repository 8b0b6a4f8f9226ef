// Decoder of the 4D stream, versions 1 to 3, as docs/STREAM.md specifies it. No dependency; browsers and node.

const VERSIONS = [1, 2, 3];
const MAX_ROWS = 2 ** 25;
const ROWS_PER_BYTE = 4096;
const MAX_GROUPS = 16;
const MAX_HARMONICS = 45;
const NUMBERS_OF_MOTION = 10;

/** Two estimates of how probable a 0 is, of 65 536. */
class Bit {
    constructor() {
        this.a = 32768;
        this.b = 32768;
    }
}

const bits = (count) => Array.from({ length: count }, () => new Bit());

/** The binary range decoder. */
class Coder {
    constructor(bytes) {
        this.bytes = bytes;
        this.at = 4;
        this.range = 0xffffffff;
        this.code = ((this.byte(0) << 24) | (this.byte(1) << 16) | (this.byte(2) << 8) | this.byte(3)) >>> 0;
    }

    byte(at) {
        return at < this.bytes.length ? this.bytes[at] : 0;
    }

    split(bound, above) {
        const bit = this.code >= bound;
        if (bit) this.code = (this.code - bound) >>> 0;
        this.range = bit ? above : bound;
        while (this.range < 0x1000000) {
            this.range = (this.range << 8) >>> 0;
            this.code = ((this.code << 8) | this.byte(this.at++)) >>> 0;
        }
        return bit;
    }

    bit(model) {
        const bound = (this.range >>> 16) * ((model.a + model.b + 1) >> 1);
        const bit = this.split(bound, this.range - bound);
        if (bit) {
            model.a -= (model.a - 32) >> 4;
            model.b -= (model.b - 32) >> 7;
        } else {
            model.a += (65503 - model.a) >> 4;
            model.b += (65503 - model.b) >> 7;
        }
        return bit;
    }

    plain(count) {
        let value = 0;
        for (let i = 0; i < count; i++) {
            const half = this.range >>> 1;
            value = (value << 1) | (this.split(half, half) ? 1 : 0);
        }
        return value;
    }
}

class Flag {
    constructor() {
        this.last = 0;
        this.models = bits(2);
    }

    decode(coder) {
        const flag = coder.bit(this.models[this.last]);
        this.last = flag ? 1 : 0;
        return flag;
    }
}

class Symbols {
    constructor(count) {
        this.count = count;
        this.tree = bits(1 << count);
    }

    decode(coder) {
        let node = 1;
        for (let i = 0; i < this.count; i++) node = (node << 1) | (coder.bit(this.tree[node]) ? 1 : 0);
        return node - (1 << this.count);
    }
}

/** Models of signed integers that depend on a context. */
class ContextNumbers {
    constructor(contexts) {
        this.zero = bits(contexts);
        this.sign = new Bit();
        this.more = Array.from({ length: contexts }, () => bits(31));
        this.next = Array.from({ length: contexts }, () => bits(31));
    }

    decode(coder, context) {
        if (!coder.bit(this.zero[context])) return 0;
        const negative = coder.bit(this.sign);
        let below = 0;
        while (below + 1 < 31 && coder.bit(this.more[context][below])) below++;
        let value = 1;
        if (below > 0) {
            value = 2 | (coder.bit(this.next[context][below]) ? 1 : 0);
            const rest = below - 1;
            value = (value << rest) | coder.plain(rest);
        }
        return negative ? -value | 0 : value | 0;
    }
}

/** What a number tells of its neighbours. */
const classOf = (value) => (value === 0 ? 0 : value === 1 || value === -1 ? 1 : 2);

class Numbers {
    constructor() {
        this.last = 0;
        this.models = new ContextNumbers(3);
    }

    decode(coder) {
        const value = this.models.decode(coder, this.last);
        this.last = classOf(value);
        return value;
    }
}

const three = () => [new Numbers(), new Numbers(), new Numbers()];

/** The rows of a layer: columns of integers; after a change also `moved`, the step of each position since the frame before. */
export class Rows {
    constructor(capacity) {
        this.count = 0;
        this.position = new Int32Array(3 * capacity);
        this.largest = new Uint8Array(capacity);
        this.rotation = new Int32Array(3 * capacity);
        this.scales = new Int32Array(3 * capacity);
        this.opacity = new Int32Array(capacity);
        this.colour = new Int32Array(3 * capacity);
        this.harmonics = new Int16Array(MAX_HARMONICS * capacity);
        this.group = new Uint8Array(capacity);
    }

    clone() {
        const out = new Rows(0);
        out.count = this.count;
        for (const name of ['position', 'largest', 'rotation', 'scales', 'opacity', 'colour', 'harmonics', 'group']) {
            out[name] = this[name].slice();
        }
        return out;
    }
}

const bitLength = (value) => 32 - Math.clz32(value);
const round = (x) => Math.floor(x + 0.5) | 0;
const harmonicsOf = (steps) => 3 * ((steps.sh_degree + 1) ** 2 - 1);

function levelOf(steps, s0, s1, s2) {
    const octaves = Math.floor((Math.max(s0, s1, s2) - steps.level_zero) / steps.scales_per_octave);
    return Math.min(20, Math.max(0, octaves));
}

/** Adds a change of colour to three values from `at` on. */
function changeColour(models, coder, from, fromAt, out, at) {
    const green = models[0].decode(coder);
    const red = (green + models[1].decode(coder)) | 0;
    const blue = (green + models[2].decode(coder)) | 0;
    out[at] = from[fromAt] + red;
    out[at + 1] = from[fromAt + 1] + green;
    out[at + 2] = from[fromAt + 2] + blue;
}

/** Whether the harmonics of a layer are brightness and two differences of colours instead of red, green and blue. */
export const isOpponent = (steps) => steps.harmonic_channels === 'opponent';

class Harmonics {
    constructor(steps) {
        this.count = harmonicsOf(steps);
        this.opponent = isOpponent(steps);
        this.any = new Flag();
        this.values = Array.from({ length: this.opponent ? 9 : 3 }, () => new ContextNumbers(this.opponent ? 9 : 3));
        this.last = this.values.map(() => 0);
        this.before = new Uint8Array(MAX_HARMONICS);
    }

    /** Adds what is coded to the values from `at` on. */
    decode(coder, out, at) {
        if (this.count === 0 || !this.any.decode(coder)) {
            this.before.fill(0);
            return;
        }
        const { opponent, before, last } = this;
        for (let k = 0; k < this.count; k++) {
            const degree = (k >= 9 ? 1 : 0) + (k >= 24 ? 1 : 0);
            const model = opponent ? 3 * degree + (k % 3) : degree;
            const context = opponent ? 3 * before[k] + last[model] : last[model];
            const value = this.values[model].decode(coder, context);
            before[k] = last[model] = classOf(value);
            out[at + k] += value;
        }
    }
}

class RowModels {
    constructor(steps) {
        this.steps = steps;
        this.group = new Symbols(4);
        this.scales = three();
        this.position = three();
        this.largest = new Symbols(2);
        this.rotation = [0, 1, 2].map(() => new Symbols(bitLength(Math.max(1, 2 * steps.rotation))));
        this.opacity = new Symbols(bitLength(Math.max(1, steps.opacity)));
        this.colour = three();
        this.harmonics = new Harmonics(steps);
        this.before = new Rows(1);
        this.beforeAt = 0;
    }

    decode(coder, rows, i) {
        const { steps, before, beforeAt: b } = this;
        rows.group[i] = this.group.decode(coder);
        const s = rows.scales;
        s[3 * i] = before.scales[3 * b] + this.scales[0].decode(coder);
        s[3 * i + 1] = s[3 * i] + this.scales[1].decode(coder);
        s[3 * i + 2] = before.scales[3 * b + 2] + this.scales[2].decode(coder);
        const level = levelOf(steps, s[3 * i], s[3 * i + 1], s[3 * i + 2]);
        for (let k = 0; k < 3; k++) {
            const cell = ((before.position[3 * b + k] >> level) + this.position[k].decode(coder)) | 0;
            rows.position[3 * i + k] = cell << level;
        }
        rows.largest[i] = this.largest.decode(coder);
        for (let k = 0; k < 3; k++) rows.rotation[3 * i + k] = this.rotation[k].decode(coder) - steps.rotation;
        rows.opacity[i] = this.opacity.decode(coder);
        changeColour(this.colour, coder, before.colour, 3 * b, rows.colour, 3 * i);
        this.harmonics.decode(coder, rows.harmonics, MAX_HARMONICS * i);
        this.before = rows;
        this.beforeAt = i;
    }
}

/** Differences to a row that is there. */
class Residuals {
    constructor(steps) {
        [this.moved, this.turned, this.scaled, this.coloured] = [0, 1, 2, 3].map(() => new Flag());
        [this.position, this.rotation, this.scales, this.colour] = [three(), three(), three(), three()];
        this.opacity = new Numbers();
        this.harmonics = new Harmonics(steps);
    }

    /** Adds what is coded to row `i`. */
    decode(coder, steps, rows, i) {
        const level = levelOf(steps, rows.scales[3 * i], rows.scales[3 * i + 1], rows.scales[3 * i + 2]);
        const add = (flag, models, column, shift) => {
            if (!flag.decode(coder)) return;
            for (let k = 0; k < 3; k++) column[3 * i + k] += models[k].decode(coder) << shift;
        };
        add(this.moved, this.position, rows.position, level);
        add(this.turned, this.rotation, rows.rotation, 0);
        add(this.scaled, this.scales, rows.scales, 0);
        rows.opacity[i] = Math.min(steps.opacity, Math.max(0, rows.opacity[i] + this.opacity.decode(coder)));
        if (this.coloured.decode(coder)) changeColour(this.colour, coder, rows.colour, 3 * i, rows.colour, 3 * i);
        this.harmonics.decode(coder, rows.harmonics, MAX_HARMONICS * i);
    }
}

/** Reads numbers of four bytes off a section. */
class Words {
    constructor(bytes) {
        this.bytes = bytes;
        this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
        this.at = 0;
    }

    need() {
        if (this.at + 4 > this.bytes.length) throw new Error('corrupt: a section ends early');
        this.at += 4;
        return this.at - 4;
    }

    u32() {
        return this.view.getUint32(this.need(), true);
    }

    f32() {
        return this.view.getFloat32(this.need(), true);
    }

    rest() {
        return this.bytes.subarray(this.at);
    }
}

function plausible(count, bytes) {
    if (count > Math.min(MAX_ROWS, (bytes.length + 1) * ROWS_PER_BYTE)) throw new Error(`corrupt: ${count} Gaussians`);
    return count;
}

function decodeKey(section, steps) {
    const words = new Words(section);
    const count = plausible(words.u32(), words.rest());
    const coder = new Coder(words.rest());
    const [models, rows] = [new RowModels(steps), new Rows(count)];
    rows.count = count;
    for (let i = 0; i < count; i++) models.decode(coder, rows, i);
    return rows;
}

/** Static rows whose shape has changed: differences, or other Gaussians in their places. */
function decodeRows(section, steps, rows) {
    const [coder, changed, replaced] = [new Coder(section), new Flag(), new Flag()];
    const [residuals, models] = [new Residuals(steps), new RowModels(steps)];
    for (let i = 0; i < rows.count; i++) {
        if (!changed.decode(coder)) continue;
        if (replaced.decode(coder)) {
            rows.harmonics.fill(0, MAX_HARMONICS * i, MAX_HARMONICS * (i + 1));
            models.decode(coder, rows, i);
        } else {
            residuals.decode(coder, steps, rows, i);
        }
    }
}

function decodeColours(section, steps, rows) {
    const [coder, changed, colour, harmonics] = [new Coder(section), new Flag(), three(), new Harmonics(steps)];
    for (let i = 0; i < rows.count; i++) {
        if (changed.decode(coder)) changeColour(colour, coder, rows.colour, 3 * i, rows.colour, 3 * i);
        harmonics.decode(coder, rows.harmonics, MAX_HARMONICS * i);
    }
}

/** Quaternion (w, x, y, z) of a row. */
function quatOf(rows, i, steps, out) {
    const unit = Math.SQRT1_2 / steps.rotation;
    const a = rows.rotation[3 * i] * unit;
    const b = rows.rotation[3 * i + 1] * unit;
    const c = rows.rotation[3 * i + 2] * unit;
    const rest = [a, b, c];
    const largest = rows.largest[i];
    for (let k = 0, next = 0; k < 4; k++) {
        out[k] = k === largest ? Math.sqrt(Math.max(0, 1 - (a * a + b * b + c * c))) : rest[next++];
    }
    return out;
}

const STILL = { quat: [1, 0, 0, 0], centre: [0, 0, 0], step: [0, 0, 0] };

function matrixOf([w, x, y, z]) {
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ];
}

/** Writes what a group's motion predicts of row `i` of `from` into row `j` of `to`. */
function predict(from, i, motion, steps, to, j) {
    const { matrix, centre, step, quat } = motion;
    const d = [0, 1, 2].map((k) => from.position[3 * i + k] * steps.position - centre[k]);
    for (let k = 0; k < 3; k++) {
        const row = matrix[k];
        const place = row[0] * d[0] + row[1] * d[1] + row[2] * d[2] + centre[k] + step[k];
        to.position[3 * j + k] = round(place / steps.position);
    }
    const [a, b, c, e] = quat;
    const [w, x, y, z] = quatOf(from, i, steps, [0, 0, 0, 0]);
    let q = [
        a * w - b * x - c * y - e * z,
        a * x + b * w + c * z - e * y,
        a * y - b * z + c * w + e * x,
        a * z + b * y - c * x + e * w,
    ];
    const length = Math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    q = length > 0 ? q.map((v) => v / length) : [1, 0, 0, 0];
    let largest = 0;
    for (let k = 1; k < 4; k++) if (Math.abs(q[k]) > Math.abs(q[largest])) largest = k;
    const scale = (q[largest] < 0 ? -1 : 1) * steps.rotation * Math.SQRT2;
    to.largest[j] = largest;
    for (let k = 0, next = 3 * j; k < 4; k++) if (k !== largest) to.rotation[next++] = round(q[k] * scale);
    for (let k = 0; k < 3; k++) {
        to.scales[3 * j + k] = from.scales[3 * i + k];
        to.colour[3 * j + k] = from.colour[3 * i + k];
    }
    to.opacity[j] = from.opacity[i];
    to.group[j] = from.group[i];
    to.harmonics.set(from.harmonics.subarray(MAX_HARMONICS * i, MAX_HARMONICS * (i + 1)), MAX_HARMONICS * j);
}

function decodeChange(section, steps, before) {
    const words = new Words(section);
    const [groups, claimed] = [words.u32(), words.u32()];
    if (groups > MAX_GROUPS) throw new Error(`corrupt: ${groups} groups`);
    const motions = Array.from({ length: groups }, () => {
        const n = Array.from({ length: NUMBERS_OF_MOTION }, () => words.f32());
        if (!n.every(Number.isFinite)) throw new Error('corrupt: a motion is not finite');
        return { quat: n.slice(0, 4), centre: n.slice(4, 7), step: n.slice(7), matrix: matrixOf(n.slice(0, 4)) };
    });
    const still = { ...STILL, matrix: matrixOf(STILL.quat) };
    const births = plausible(claimed, words.rest());
    const coder = new Coder(words.rest());
    const out = new Rows(before.count + births);
    out.moved = new Int32Array(3 * (before.count + births));
    const [gone, residuals] = [new Flag(), new Residuals(steps)];
    for (let i = 0; i < before.count; i++) {
        if (gone.decode(coder)) continue;
        const j = out.count++;
        predict(before, i, motions[before.group[i]] ?? still, steps, out, j);
        residuals.decode(coder, steps, out, j);
        for (let k = 0; k < 3; k++) out.moved[3 * j + k] = out.position[3 * j + k] - before.position[3 * i + k];
    }
    const born = new RowModels(steps);
    for (let i = 0; i < births; i++) born.decode(coder, out, out.count++);
    return out;
}

/** How well each of so many positions is known, in the unit of the world. */
function decodeUncertainty(section, count) {
    const [coder, model] = [new Coder(section), new Numbers()];
    let last = 0;
    return Float32Array.from({ length: count }, () => {
        last = (last + model.decode(coder)) | 0;
        return 2 ** (last / 4);
    });
}

const CRC = Uint32Array.from({ length: 256 }, (_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
    return n >>> 0;
});

function crc32(bytes) {
    let crc = 0xffffffff;
    for (const byte of bytes) crc = CRC[(crc ^ byte) & 255] ^ (crc >>> 8);
    return ~crc >>> 0;
}

/** CRC-32 of any bytes with their own CRC-32 behind them: what the first lists held for every file. */
const RESIDUE = 0x2144df1c;

/** Whether a file is whole, and the one that the list names. */
function isListed(bytes, listed) {
    const end = bytes.length - 4;
    if (end < 0) return false;
    const own = new DataView(bytes.buffer, bytes.byteOffset).getUint32(end, true);
    return crc32(bytes.subarray(0, end)) === own && (listed === own || listed === RESIDUE);
}

function sectionsOf(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const name = (at) => String.fromCharCode(...bytes.subarray(at, at + 4));
    const end = bytes.length - 4;
    if (end < 8 || name(0) !== 'FF4D') throw new Error('not a frame of a stream');
    if (!VERSIONS.includes(view.getUint32(4, true))) throw new Error(`version ${view.getUint32(4, true)} is unknown`);
    const out = new Map();
    for (let at = 8; at < end; ) {
        if (at + 8 > end) throw new Error('corrupt: cut off');
        const length = view.getUint32(at + 4, true);
        if (at + 8 + length > end) throw new Error('corrupt: cut off');
        out.set(name(at), bytes.subarray(at + 8, at + 8 + length));
        at += 8 + length;
    }
    return out;
}

/** Values of a layer's rows as players need them; `harmonics` stay integers times `steps.harmonic`. */
export function valuesOf(rows, steps) {
    const n = rows.count;
    const out = {
        count: n,
        position: new Float32Array(3 * n),
        quat: new Float32Array(4 * n),
        logScale: new Float32Array(3 * n),
        opacity: new Float32Array(n),
        colour: new Float32Array(3 * n),
    };
    const [q, scale] = [[0, 0, 0, 0], Math.LN2 / steps.scales_per_octave];
    for (let i = 0; i < n; i++) {
        quatOf(rows, i, steps, q);
        out.quat.set(q, 4 * i);
        out.opacity[i] = rows.opacity[i] / steps.opacity;
        for (let k = 3 * i; k < 3 * i + 3; k++) {
            out.position[k] = rows.position[k] * steps.position;
            out.logScale[k] = rows.scales[k] * scale;
            out.colour[k] = rows.colour[k] * steps.colour;
        }
    }
    return out;
}

/** CRC-32 of all rows of a layer, as docs/STREAM.md defines it. */
export function fingerprintOf(rows, steps) {
    const [n, rest] = [rows.count, harmonicsOf(steps)];
    const size = 54 + 2 * rest;
    const bytes = new Uint8Array(n * size);
    const view = new DataView(bytes.buffer);
    for (let i = 0; i < n; i++) {
        let at = i * size;
        for (const column of [rows.position, rows.rotation, rows.scales, rows.colour]) {
            for (let k = 0; k < 3; k++, at += 4) view.setInt32(at, column[3 * i + k], true);
        }
        view.setInt32(at, rows.opacity[i], true);
        bytes[at + 4] = rows.largest[i];
        bytes[at + 5] = rows.group[i];
        for (let k = 0; k < rest; k++) view.setInt16(at + 6 + 2 * k, rows.harmonics[MAX_HARMONICS * i + k], true);
    }
    return crc32(bytes);
}

/** A stream at `base`, read with `load(name)`, which gives the bytes of a file. */
export class Stream {
    static async open(load) {
        const text = async (name) => new TextDecoder().decode(await load(name));
        const out = new Stream();
        out.load = load;
        out.text = text;
        out.manifest = JSON.parse(await text('manifest.json'));
        if (out.manifest.format !== 'ffgs-4d') throw new Error('manifest.json is not that of a 4D stream');
        if (!VERSIONS.includes(out.manifest.version)) {
            throw new Error(`version ${out.manifest.version} of the stream is unknown; reload the page or use a newer player`);
        }
        out.state = null;
        await out.refresh();
        return out;
    }

    /** Looks for frames that were appended since. */
    async refresh() {
        const text = await this.text('frames.jsonl');
        const complete = text.slice(0, text.lastIndexOf('\n') + 1);
        this.entries = complete.split('\n').filter((line) => line).map((line) => JSON.parse(line));
    }

    /** Places in the list that must be applied in turn to arrive at `at`. */
    pathTo(at) {
        const before = (is) => {
            for (let i = at; i >= 0; i--) if (this.entries[i][is]) return i;
            throw new Error('no key frame before the frame');
        };
        const [key, base] = [before('key'), before('static_key')];
        const range = (from) => Array.from({ length: Math.max(0, at - from + 1) }, (_, i) => from + i);
        if (this.state?.baseAt === base) {
            const now = this.state.at;
            return key <= now && now <= at ? range(now + 1) : range(key);
        }
        return base < key ? [base, ...range(key)] : range(key);
    }

    /** The frame at a place in the list. */
    async read(at) {
        for (const step of this.pathTo(at)) {
            const state = this.state;
            this.state = null;
            this.state = await this.apply(state, step);
        }
        return this.state;
    }

    async apply(state, at) {
        const entry = this.entries[at];
        const bytes = await this.load(entry.file);
        if (!isListed(bytes, entry.crc32)) throw new Error(`${entry.file} is damaged: its checksum differs`);
        const sections = sectionsOf(bytes);
        const need = (name) => {
            if (!sections.has(name)) throw new Error(`${entry.file} has no section ${name}`);
            return sections.get(name);
        };
        const { static: still, dynamic: moving } = this.manifest;
        let next = state;
        if (entry.static_key) {
            const base = decodeKey(need('STAT'), still);
            next = { baseAt: at, base, still: base.clone(), moving: null, sky: null };
        }
        if (!next) throw new Error('no static layer before this frame');
        if (entry.key) next.still = next.base.clone();
        if (sections.has('SROW')) decodeRows(sections.get('SROW'), still, next.still);
        if (sections.has('SCOL')) decodeColours(sections.get('SCOL'), still, next.still);
        next.moving = entry.key ? decodeKey(need('DKEY'), moving) : decodeChange(need('DMOV'), moving, next.moving);
        next.uncertainty = sections.has('DUNC') ? decodeUncertainty(sections.get('DUNC'), next.moving.count) : null;
        if (sections.has('SKYE')) next.sky = sections.get('SKYE').slice();
        next.at = at;
        return next;
    }
}
