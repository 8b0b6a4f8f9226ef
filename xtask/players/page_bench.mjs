// Times our page in headless Chromium, where the processor draws: node page_bench.mjs CHROMIUM FFGS RUN [webgpu]
// in the folder that `cargo xtask setup` installs, target/players. Prints what was on screen beside the pictures per second.
import { spawn } from 'node:child_process';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { cwd } from 'node:process';

const { chromium } = createRequire(join(cwd(), 'package.json'))('playwright-core');
const [executablePath, program, run, webgpu] = process.argv.slice(2);
const ARGUMENTS = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'];
const WEBGPU = ['--enable-unsafe-webgpu', '--use-webgpu-adapter=swiftshader', '--enable-features=Vulkan', '--use-vulkan=swiftshader'];
/** Seconds of which pictures are counted, after as many that are not. */
const SECONDS = 8;
const OPENINGS = 4;

const server = spawn(program, ['view', run], { stdio: ['ignore', 'pipe', 'inherit'] });
const url = await new Promise((resolve) => server.stdout.once('data', (text) => resolve(String(text).trim())));
const browser = await chromium.launch({ executablePath, args: webgpu ? [...ARGUMENTS, ...WEBGPU] : ARGUMENTS });
const system = await browser.newBrowserCDPSession();
const page = await browser.newPage({ viewport: { width: 1280, height: 720 } });

/** Seconds that the processor has spent on drawing so far. */
async function spent() {
    const { processInfo } = await system.send('SystemInfo.getProcessInfo');
    return processInfo.filter((p) => p.type === 'GPU').reduce((sum, p) => sum + p.cpuTime, 0);
}

/** Seconds until the first picture has been shown. */
async function open() {
    await page.goto('about:blank');
    await page.waitForTimeout(2000);
    const start = Date.now();
    await page.goto(webgpu ? `${url}#device=webgpu` : url, { waitUntil: 'commit' });
    await page.waitForFunction(() => document.body?.dataset.state === 'ready' && Number(document.body.dataset.coloured) === globalThis.player?.at);
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
    return (Date.now() - start) / 1000;
}

async function pictures(name, begin, end) {
    await page.evaluate(begin);
    await page.waitForTimeout(1000 * SECONDS);
    const before = [await spent(), await page.evaluate(() => globalThis.pictures)];
    await page.waitForTimeout(1000 * SECONDS);
    const count = await page.evaluate(() => globalThis.pictures) - before[1];
    const cost = (1000 * (await spent() - before[0])) / count;
    const [splats, seen, width, height] = await page.evaluate(() => {
        const { picture, app } = globalThis.player;
        return [picture.splats, picture.seen, app.graphicsDevice.width, app.graphicsDevice.height];
    });
    await page.evaluate(end);
    console.log(`${name}: ${(count / SECONDS).toFixed(1)} pictures per second, ${cost.toFixed(0)} ms of processor each; ${splats} of ${seen} splats at ${width} x ${height}`);
}

try {
    const times = [];
    for (let i = 0; i < OPENINGS; i++) times.push((await open()).toFixed(2));
    console.log(`first picture after ${times.join(', ')} s`);
    await page.evaluate(() => {
        globalThis.pictures = 0;
        globalThis.player.app.on('postrender', () => { globalThis.pictures++; });
    });
    const play = () => document.getElementById('play').click();
    const turn = () => globalThis.player.freeze(!globalThis.player.bullet);
    await pictures('turning', turn, turn);
    await pictures('playing', play, play);
    await page.selectOption('#quality', 'full');
    await pictures('turning, full', turn, turn);
} finally {
    await browser.close();
    server.kill();
}
