// Reads the conformance stream with the decoder of our page: node stream_test.mjs STREAM_JS FOLDER
import { readFile } from 'node:fs/promises';
import { join, resolve } from 'node:path';
import { pathToFileURL } from 'node:url';

const [decoder, folder] = process.argv.slice(2);
const { Stream, fingerprintOf } = await import(pathToFileURL(resolve(decoder)).href);
const load = async (name) => new Uint8Array(await readFile(join(folder, name)));
const expected = JSON.parse(await readFile(join(folder, 'expected.json'), 'utf8'));
const { static: still, dynamic: moving } = JSON.parse(await readFile(join(folder, 'manifest.json'), 'utf8'));

async function check(stream, at) {
    const state = await stream.read(at);
    const found = [fingerprintOf(state.still, still), fingerprintOf(state.moving, moving)];
    if (String(found) !== String(expected[at])) throw new Error(`frame ${at}: ${found}, expected ${expected[at]}`);
}

// In order, then at random, then each by a decoder of its own.
const stream = await Stream.open(load);
if (stream.entries.length !== expected.length) throw new Error('another number of frames');
for (let at = 0; at < expected.length; at++) await check(stream, at);
for (const at of [5, 1, 6, 0, 3]) await check(stream, at);
for (let at = 0; at < expected.length; at++) await check(await Stream.open(load), at);

// A changed byte is seen.
const damaged = await Stream.open(async (name) => {
    const bytes = await load(name);
    if (name.endsWith('.4df')) bytes[bytes.length >> 1] ^= 1;
    return bytes;
});
const error = await damaged.read(0).then(() => null, (e) => e);
if (!error?.message.includes('damaged')) throw new Error(`damage was not seen: ${error}`);
console.log(`test result: ok. ${expected.length} passed; 0 failed`);
