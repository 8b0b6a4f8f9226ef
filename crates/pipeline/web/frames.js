// The frames of a stream, read by a worker and kept for when they are shown again.

/** Bytes of frames that are kept. */
const ROOM = 256 * 2 ** 20;

const worker = new Worker(new URL('./reader.js', import.meta.url), { type: 'module' });
const waiting = new Map();
let asked = 0;

worker.addEventListener('message', ({ data: { id, answer, error } }) => {
    const { resolve, reject } = waiting.get(id);
    waiting.delete(id);
    if (error === undefined) resolve(answer);
    else reject(new Error(error));
});
worker.addEventListener('error', (event) => {
    for (const { reject } of waiting.values()) reject(new Error(event.message ?? 'the reader of the stream does not start'));
    waiting.clear();
});

function ask(name, value) {
    return new Promise((resolve, reject) => {
        waiting.set(asked, { resolve, reject });
        worker.postMessage({ id: asked++, name, value });
    });
}

const sizeOf = (columns) => Object.values(columns).reduce((sum, column) => sum + (column?.byteLength ?? 0), 0);
const bytesOf = (frame) => sizeOf(frame) + sizeOf(frame.still) + sizeOf(frame.moving);

export class Frames {
    static async open() {
        const out = new Frames();
        Object.assign(out, await ask('open'), { state: null, kept: new Map(), bytes: 0 });
        return out;
    }

    /** Looks for frames that were appended since. */
    async refresh() {
        this.entries = await ask('refresh');
    }

    /** A frame by its place in the list; it is the `state` from then on. */
    async read(at) {
        this.state = await this.get(at);
        return this.state;
    }

    /** Reads a frame that is likely to be asked for next; a fault is told when it is. */
    ahead(at) {
        if (at < this.entries.length) this.get(at).catch(() => {});
    }

    /** The frame or, while it is read, the promise of it. Those that were not asked for longest make room. */
    get(at) {
        const found = this.kept.get(at);
        if (found) {
            this.kept.delete(at);
            this.kept.set(at, found);
            return found;
        }
        const frame = ask('frame', at);
        this.kept.set(at, frame);
        frame.then((read) => this.keep(read), () => this.kept.delete(at));
        return frame;
    }

    keep(frame) {
        frame.bytes = bytesOf(frame);
        this.bytes += frame.bytes;
        for (const [at, old] of this.kept) {
            if (this.bytes <= ROOM || at === frame.at) break;
            this.kept.delete(at);
            old.then((read) => { this.bytes -= read.bytes; }, () => {});
        }
    }
}

/** Opens the stream, and reads the first frame that will be shown. */
export async function reopen() {
    const frames = await Frames.open();
    frames.ahead(Number(new URLSearchParams(location.hash.slice(1)).get('frame') ?? 0));
    return frames;
}

/** Begun while the engine is still being loaded. */
export const opened = reopen();
// Whoever waits for it is told of a fault.
opened.catch(() => {});
