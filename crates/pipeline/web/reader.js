// Beside the page: reads the files of a stream and makes columns of their rows, so that nothing of it holds up pictures.

import { columnsOf, middleOf } from './columns.js';
import { Stream } from './stream.js';

let stream = null;

async function load(name) {
    const answer = await fetch(name, { cache: 'no-store' }).catch(() => null);
    if (!answer) throw new Error(`${name}: no answer. Is ffgs still running?`);
    if (!answer.ok) throw new Error(`${name}: ${answer.status} ${answer.statusText}`);
    return new Uint8Array(await answer.arrayBuffer());
}

/** A frame by its place in the list. */
async function frame(at) {
    const { static: still, dynamic: moving } = stream.manifest;
    const state = await stream.read(at);
    const columns = columnsOf(state.moving, moving);
    return { at, still: columnsOf(state.still, still), moving: columns, middle: middleOf(columns), moved: state.moving.moved?.slice(0, 3 * columns.count),
        uncertainty: state.uncertainty, sky: state.sky };
}

const answers = {
    async open() {
        stream = await Stream.open(load);
        return { manifest: stream.manifest, entries: stream.entries };
    },
    async refresh() {
        await stream.refresh();
        return stream.entries;
    },
    frame,
};

/** Questions are answered one after another: a frame is made from the one before. */
let last = Promise.resolve();
addEventListener('message', ({ data: { id, name, value } }) => {
    last = last.then(() => answers[name](value)).then((answer) => postMessage({ id, answer }), (error) => postMessage({ id, error: error.message }));
});
