// Drives our page in headless Chromium: node page_test.mjs CHROMIUM FFGS RUN CAPTURE CAMERA PICTURE [SCREENSHOTS]
// RUN has at least two frames; PICTURE is the camera CAMERA of its frame 1, as `ffgs render` drew it.
import { spawn } from 'node:child_process';
import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { cwd } from 'node:process';

const { chromium } = createRequire(join(cwd(), 'package.json'))('playwright-core');
const [executablePath, program, run, capture, camera, picture, shots] = process.argv.slice(2);
/** Least agreement (dB) of the page with our own renderer. */
const LEAST_PSNR = 30;
const ARGUMENTS = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'];
const WEBGPU = ['--enable-unsafe-webgpu', '--use-webgpu-adapter=swiftshader', '--enable-features=Vulkan', '--use-vulkan=swiftshader'];
const served = [];

function check(condition, text) {
    if (!condition) throw new Error(text);
}

/** Starts `ffgs view`; its address. */
function serve(folder) {
    const server = spawn(program, ['view', folder], { stdio: ['ignore', 'pipe', 'inherit'] });
    served.push(server);
    return new Promise((resolve, reject) => {
        server.stdout.once('data', (text) => resolve(String(text).trim()));
        server.once('exit', (code) => reject(new Error(`ffgs view ${folder} ended with ${code}`)));
    });
}

const state = (page, name) => page.evaluate((key) => document.body.dataset[key], name);
// The document may not have begun to load.
const ready = (page) => page.waitForFunction(() => document.body?.dataset.state === 'ready' && Number(document.body.dataset.coloured) === globalThis.player.at);
/** Clicks without waiting for pictures, of which software draws few. */
const press = (page, id) => page.evaluate((name) => document.getElementById(name).click(), id);
const shot = (page, name) => shots && page.screenshot({ path: join(shots, `${name}.png`) });

async function open(browser, url, size = { width: 640, height: 360 }) {
    const page = await browser.newPage({ viewport: size });
    page.setDefaultTimeout(60000);
    page.on('pageerror', (error) => {
        page.failure = error;
    });
    await page.goto(url, { waitUntil: 'commit' });
    return page;
}

/** Compares the page at an address with our own renderer; whether it draws by WebGPU. */
async function compare(browser, url) {
    const reference = await readFile(picture);
    const page = await open(browser, url, { width: reference.readUInt32BE(16), height: reference.readUInt32BE(20) });
    await ready(page);
    await page.addStyleTag({ content: '#bar, #legend { display: none !important }' });
    await page.evaluate((name) => globalThis.player.choose(String(globalThis.player.capture.views.findIndex((v) => v.name === name))), camera);
    await page.waitForFunction(() => document.body.dataset.sky === 'ready' && document.body.dataset.quality === 'full');
    // Splats are sorted by a worker, some pictures later.
    await page.waitForTimeout(1500);
    const own = (await page.screenshot()).toString('base64');
    const psnr = await page.evaluate(async (pictures) => {
        const pixels = async (text) => {
            const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
            const image = await createImageBitmap(new Blob([bytes], { type: 'image/png' }));
            const context = new OffscreenCanvas(image.width, image.height).getContext('2d');
            context.drawImage(image, 0, 0);
            return context.getImageData(0, 0, image.width, image.height).data;
        };
        const [a, b] = await Promise.all(pictures.map(pixels));
        let sum = 0;
        for (let i = 0; i < a.length; i++) sum += (a[i] - b[i]) ** 2;
        return 10 * Math.log10(255 ** 2 / (sum / (a.length * 0.75)));
    }, [reference.toString('base64'), own]);
    console.log(`page against renderer: ${psnr.toFixed(2)} dB`);
    check(psnr >= LEAST_PSNR, `the page differs from our renderer: ${psnr.toFixed(2)} dB`);
    if (page.failure) throw page.failure;
    return page.evaluate(() => globalThis.player.app.graphicsDevice.isWebGPU);
}

const tests = {
    async 'seeks, steps and plays'(browser, url) {
        const page = await open(browser, url);
        await ready(page);
        await page.keyboard.press('End');
        await page.waitForFunction(() => Number(document.body.dataset.frame) === globalThis.player.count - 1);
        await press(page, 'back');
        await page.waitForFunction(() => Number(document.body.dataset.frame) === globalThis.player.count - 2);
        await page.fill('#time', '0');
        await page.waitForFunction(() => document.body.dataset.frame === '0');
        await page.keyboard.press(' ');
        await page.waitForFunction(() => document.body.dataset.frame !== '0');
        if (page.failure) throw page.failure;
    },

    async 'follows what moves, and time stands still in bullet time'(browser, url) {
        const page = await open(browser, url);
        await ready(page);
        await page.keyboard.press('c');
        const targets = [];
        for (const at of [0, 1]) {
            await page.evaluate((to) => globalThis.player.seek(to), at);
            await ready(page);
            targets.push(await page.evaluate(() => [...globalThis.player.target.toArray(), globalThis.player.middle.distance(globalThis.player.target)]));
        }
        check(targets.every((t) => t[3] === 0) && String(targets[0]) !== String(targets[1]), `followed to ${targets}`);
        await page.keyboard.press('b');
        const yaw = await page.evaluate(() => globalThis.player.orbit.yaw);
        await page.waitForFunction((from) => globalThis.player.orbit.yaw > from, yaw);
        check((await state(page, 'frame')) === '1', 'time went on');
        if (page.failure) throw page.failure;
    },

    async 'compares with the photograph and shows overlays'(browser, url) {
        const page = await open(browser, url);
        await ready(page);
        await page.keyboard.press(']');
        await press(page, 'compare');
        await page.waitForFunction(() => !document.getElementById('photo').hidden && document.getElementById('photograph').naturalWidth > 0);
        await page.evaluate(() => document.getElementById('photograph').decode());
        // A screenshot of the photograph also shows what lies under and over it, and the render is still refined.
        const alone = await page.addStyleTag({ content: '#canvas, #bar, #legend, #edge { visibility: hidden }' });
        const photograph = page.locator('#photograph');
        const before = (await photograph.screenshot()).toString('base64');
        const middle = await page.evaluate(() => {
            const view = globalThis.player.view();
            const own = view.exposures;
            const frame = globalThis.player.stream.entries[globalThis.player.at].frame;
            view.exposures = [...Array(frame).fill([0, 0, 0]), [2, 0, -2]];
            globalThis.player.showPhotograph();
            view.exposures = own;
            return [...document.querySelectorAll('#exposure feComponentTransfer > *')].map((f) => Number(f.getAttribute('tableValues').split(' ')[32]));
        });
        // Odds of one half, divided by e^2, by 1 and by e^-2.
        check(middle.every((v, c) => Math.abs(v - [0.1192, 0.5, 0.8808][c]) < 1e-3), `exposures of ${middle}`);
        check((await photograph.screenshot()).toString('base64') !== before, 'the exposure of the photograph stayed');
        await page.evaluate(() => globalThis.player.showPhotograph());
        check((await photograph.screenshot()).toString('base64') === before, 'the photograph keeps an exposure that is not its own');
        await alone.evaluate((style) => style.remove());
        await page.keyboard.press('.');
        for (const [overlay, legend] of [['uncertainty', 'standard deviation'], ['motion', 'per second']]) {
            await page.selectOption('#overlay', overlay);
            await page.waitForFunction((text) => document.getElementById('legend').textContent.includes(text), legend);
            await shot(page, overlay);
        }
        if (page.failure) throw page.failure;
    },

    async 'draws what our renderer draws'(browser, url) {
        await compare(browser, `${url}#frame=1`);
    },

    async 'draws the same on WebGPU'(_, url) {
        const browser = await chromium.launch({ executablePath, args: [...ARGUMENTS, ...WEBGPU] });
        try {
            const page = await open(browser, url);
            const has = await page.evaluate(async () => Boolean(await globalThis.navigator.gpu?.requestAdapter()));
            if (has) check(await compare(browser, `${url}#frame=1&device=webgpu`), 'the page did not take WebGPU');
            else console.log('skipped: this Chromium has no WebGPU in software');
        } finally {
            await browser.close();
        }
    },

    async 'draws less while pictures are slow, and everything at rest'(browser, url) {
        const page = await open(browser, url);
        await ready(page);
        // Pictures become slow on any machine.
        await page.evaluate(() => globalThis.player.app.on('prerender', () => {
            for (const end = performance.now() + 120; performance.now() < end;);
        }));
        await page.keyboard.press('b');
        await page.waitForFunction(() => document.body.dataset.quality === 'reduced');
        await page.waitForFunction(() => globalThis.player.picture.splats < globalThis.player.picture.seen);
        await page.waitForFunction(() => document.getElementById('canvas').width < innerWidth);
        await shot(page, 'reduced');
        const whole = () => {
            const { picture, stream } = globalThis.player;
            return document.body.dataset.quality === 'full' && picture.splats === stream.state.still.count + stream.state.moving.count && document.getElementById('canvas').width === innerWidth;
        };
        await page.keyboard.press('b');
        await page.waitForFunction(whole);
        await page.selectOption('#quality', 'full');
        await page.keyboard.press('b');
        await page.waitForTimeout(2500);
        check(await page.evaluate(whole), 'less is drawn although everything was asked for');
        if (page.failure) throw page.failure;
    },

    async 'keeps everything where pictures are fast'(browser, url) {
        const page = await open(browser, url);
        const limits = await page.evaluate(async () => {
            const { Quality } = await import('./quality.js');
            const play = (quality, from, pictures, time) => {
                for (let now = from, i = 0; i < pictures; i++, now += time) {
                    quality.drawn(now, time, Math.min(quality.budget, 1e5), 1e5);
                    quality.tick(now, true);
                }
                return quality.budget;
            };
            const [fast, slow, slower] = [new Quality(), new Quality(), new Quality()];
            const out = { fast: play(fast, 0, 200, 1000 / 30), slow: play(slow, 0, 60, 80), slower: play(slower, 0, 10, 900) };
            slow.tick(1e5, false);
            slow.tick(1e5 + 1000, false);
            return { ...out, rest: slow.budget, again: play(slow, 2e5, 2, 80) };
        });
        check(limits.fast === Infinity && limits.rest === Infinity, `everything is not drawn: ${JSON.stringify(limits)}`);
        check(limits.slow < 1e5 && limits.slower < 1e5, `slow pictures are kept: ${JSON.stringify(limits)}`);
        // The next motion starts with what the last has found.
        check(limits.again < 1e5, `the limit is forgotten: ${JSON.stringify(limits)}`);
        if (page.failure) throw page.failure;
    },

    async 'names a damaged file, and plays the others'(browser, url) {
        const page = await open(browser, 'about:blank');
        await page.route('**/000001.4df', async (route) => {
            const body = await (await route.fetch()).body();
            body[body.length >> 1] ^= 1;
            await route.fulfill({ body });
        });
        await page.goto(url);
        await ready(page);
        await page.keyboard.press('.');
        await page.waitForFunction(() => document.getElementById('message').textContent.includes('000001.4df is damaged'));
        await page.keyboard.press('Home');
        await page.waitForFunction(() => document.body?.dataset.state === 'ready');
        if (page.failure) throw page.failure;
    },

    async 'waits for a run that has just begun'(browser, url) {
        const page = await open(browser, 'about:blank');
        let begun = false;
        await page.route('**/manifest.json', (route) => (begun ? route.continue() : route.fulfill({ status: 404 })));
        await page.goto(url);
        await page.waitForFunction(() => document.getElementById('message').textContent.includes('No frame is finished yet'));
        begun = true;
        await ready(page);
        if (page.failure) throw page.failure;
    },

    async 'needs nothing from elsewhere'(browser, url) {
        const page = await open(browser, 'about:blank');
        const foreign = [];
        page.on('request', (request) => /^(http|ws)/.test(request.url()) && !request.url().startsWith(url) && foreign.push(request.url()));
        await page.goto(url);
        await ready(page);
        await shot(page, 'desktop');
        check(foreign.length === 0, `asked for ${foreign}`);
        await page.setViewportSize({ width: 390, height: 844 });
        const widths = await page.evaluate(() => [document.getElementById('bar').scrollWidth, innerWidth]);
        check(widths[0] <= widths[1], `the bar is ${widths[0]} px wide on a phone`);
        await page.waitForTimeout(500);
        await shot(page, 'phone');
        if (page.failure) throw page.failure;
    },

    async 'records a video'(browser, url) {
        const page = await open(browser, url);
        await ready(page);
        await page.keyboard.press('r');
        await page.waitForTimeout(1200);
        // On a busy machine little is drawn in that time, and nothing recorded.
        await page.evaluate(() => new Promise((done) => {
            let left = 30;
            const drawn = () => (left-- > 0 ? requestAnimationFrame(drawn) : done());
            drawn();
        }));
        const [download] = await Promise.all([page.waitForEvent('download'), page.keyboard.press('r')]);
        const bytes = await readFile(await download.path());
        check(bytes.length > 0, 'nothing was recorded');
        check(bytes.readUInt32BE(0) === 0x1a45dfa3, 'the video is no WebM file');
        if (page.failure) throw page.failure;
    },

    async 'shows a capture without a run'(browser) {
        const page = await open(browser, await serve(capture));
        await ready(page);
        check(await page.evaluate(() => globalThis.player.stream.state.still.count > 0), 'no points');
        await shot(page, 'capture');
        if (page.failure) throw page.failure;
    },
};

const browser = await chromium.launch({ executablePath, args: ARGUMENTS });
let failed = 0;
try {
    const url = await serve(run);
    for (const [name, test] of Object.entries(tests)) {
        const start = Date.now();
        const error = await test(browser, url).then(() => null, (e) => e);
        // Pages that draw on would slow the next one.
        for (const context of browser.contexts()) await context.close();
        console.log(`${error ? 'FAILED' : 'ok'}  ${name}  ${((Date.now() - start) / 1000).toFixed(1)} s${error ? `\n${error.stack}` : ''}`);
        failed += error ? 1 : 0;
    }
} finally {
    await browser.close();
    served.forEach((server) => server.kill());
}
console.log(`test result: ${failed ? 'FAILED' : 'ok'}. ${Object.keys(tests).length - failed} passed; ${failed} failed`);
process.exit(failed ? 1 : 0);
