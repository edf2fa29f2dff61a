// node check.mjs REPORT.html OUT-DIR [PAGE.html …]: opens a report in headless Chromium as a reader would.
// Fails on any console error, on any request but for the file itself, if the view does not turn, if no point
// is found under the pointer, or if the page is wider than the window. Keeps screenshots. Further pages
// (refused ones, a calibration's, a puncture's) are opened likewise, with no more asked of their view than
// that it is drawn.
import { chromium } from 'playwright-core';
import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { resolve } from 'node:path';
import { pathToFileURL } from 'node:url';

const [report, out, ...others] = process.argv.slice(2);
if (!report || !out) { console.error('usage: node check.mjs REPORT.html OUT-DIR [PAGE.html ...]'); process.exit(2); }
mkdirSync(out, { recursive: true });
const url = pathToFileURL(resolve(report)).href, faults = [];
const fault = (text) => { faults.push(text); console.error(`FAULT: ${text}`); };

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--disable-quic', '--no-first-run',
    '--disable-background-networking', '--disable-component-update', '--disable-sync'],
});
const windows = [['wide', 1280, 'light'], ['narrow', 400, 'light'], ['dark', 1280, 'dark']];
const open = async (url, name, width, scheme) => {
  const page = await browser.newPage({ viewport: { width, height: 900 }, colorScheme: scheme, hasTouch: width < 600 });
  page.on('console', (m) => { if (m.type() === 'error') fault(`${name}: console: ${m.text()}`); });
  page.on('pageerror', (e) => fault(`${name}: ${e.message}`));
  page.on('request', (r) => { if (r.url() !== url && !r.url().startsWith('data:')) fault(`${name}: request for ${r.url()}`); });
  await page.goto(url);
  return page;
};
const close = async (page, name) => {
  const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  if (over > 0) fault(`${name}: the page is ${over} px wider than the window`);
  // In pieces: above 8192 px the browser's picture begins again from the top.
  const { width, height } = await page.evaluate(() => ({ width: document.documentElement.clientWidth, height: document.documentElement.scrollHeight }));
  for (let y = 0, k = 1; y < height; y += 6000, k += 1) {
    const clip = { x: 0, y, width, height: Math.min(6000, height - y) };
    await page.screenshot({ path: `${out}/${name}${k > 1 ? `-${k}` : ''}.png`, fullPage: true, clip });
  }
  await page.close();
};
for (const [k, other] of others.entries()) {
  for (const [window, width, scheme] of windows) {
    const name = `page-${k + 1}-${window}`, page = await open(pathToFileURL(resolve(other)).href, name, width, scheme);
    if (await page.locator('.view-3d').count()) await page.locator('.view-3d[data-ready=yes]').waitFor({ timeout: 30000 });
    await close(page, name);
  }
}
for (const [name, width, scheme] of windows) {
  const page = await open(url, name, width, scheme);
  const view = page.locator('.view-3d');
  await page.locator('.view-3d[data-ready=yes]').waitFor({ timeout: 30000 });
  const points = Number(await view.getAttribute('data-points'));
  if (!(points > 1000)) fault(`${name}: the view holds ${points} points`);
  const canvas = page.locator('.view-3d canvas');
  await canvas.scrollIntoViewIfNeeded();
  const box = await canvas.boundingBox(), x = box.x + box.width / 2, y = box.y + box.height / 2;
  if (name === 'wide') {
    // A point under the pointer, somewhere along a line across the view.
    let seen = '';
    for (let k = 0; k < 60 && !seen; k++) {
      await page.mouse.move(box.x + box.width * (0.2 + 0.01 * k), y + ((k * 37) % 80) - 40);
      await page.waitForTimeout(40);
      seen = await page.locator('.under-pointer').textContent();
    }
    if (!/^X .* mm$/.test(seen)) fault('no measured point is given under the pointer');
    await page.mouse.move(2, 2); // no point under the pointer
    await page.waitForTimeout(200);
    const before = await canvas.screenshot({ path: `${out}/view-first.png` });
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + 140, y + 60, { steps: 8 });
    await page.mouse.up();
    await page.mouse.move(2, 2);
    await page.waitForTimeout(300);
    const after = await canvas.screenshot({ path: `${out}/view-turned.png` });
    if (before.equals(after)) fault('the view does not turn');
    // Every control does something, and the first view comes back.
    const look = async () => { await page.mouse.move(2, 2); await page.waitForTimeout(200); return canvas.screenshot(); };
    let last = after;
    const changes = async (what, act) => {
      await act();
      const now = await look();
      if (now.equals(last)) fault(`${what} changes nothing`);
      last = now;
    };
    await changes('colour by brightness', () => page.locator('.scene select').selectOption('brightness'));
    if (!/dark/.test(await page.locator('.scale').textContent())) fault('the scale does not follow the colour');
    for (const box of await page.locator('.scene input[data-layer]').all()) {
      await changes(`layer ${await box.getAttribute('data-layer')}`, () => box.uncheck());
      await changes(`layer ${await box.getAttribute('data-layer')} again`, () => box.check());
    }
    await changes('colour by height', () => page.locator('.scene select').selectOption('height'));
    if (!/mm/.test(await page.locator('.scale').textContent())) fault('heights have no unit');
    const drag = async (button, keys) => {
      for (const k of keys) await page.keyboard.down(k);
      await page.mouse.move(x, y);
      await page.mouse.down({ button });
      await page.mouse.move(x + 60, y + 40, { steps: 5 });
      await page.mouse.up({ button });
      for (const k of keys) await page.keyboard.up(k);
    };
    await changes('panning by the right button', () => drag('right', []));
    await changes('panning by shift', () => drag('left', ['Shift']));
    await changes('the wheel', async () => { await page.mouse.move(x, y); await page.mouse.wheel(0, -200); });
    await changes('first view', () => page.locator('.scene button').click());
    await canvas.scrollIntoViewIfNeeded();
    if (!(await look()).equals(before)) fault('the first view does not come back');
    await page.pdf({ path: `${out}/report.pdf`, format: 'A4' });
  }
  if (name === 'narrow') {
    // One finger turns, two apart zoom, two side by side pan.
    const touch = await page.context().newCDPSession(page);
    const send = (type, points) => touch.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([dx, dy], id) => ({ x: x + dx, y: y + dy, id })) });
    const gesture = async (what, from, to) => {
      // From the first view each time: a gesture must not be judged by where the one before led.
      await page.evaluate(() => document.querySelector('.scene button').click());
      await page.waitForTimeout(300);
      const before = await canvas.screenshot();
      await send('touchStart', from);
      for (let k = 1; k <= 5; k++) await send('touchMove', from.map(([fx, fy], i) => [fx + (to[i][0] - fx) * k / 5, fy + (to[i][1] - fy) * k / 5]));
      await send('touchEnd', []);
      await page.waitForTimeout(200);
      if (before.equals(await canvas.screenshot())) fault(`${what} does nothing`);
    };
    await gesture('a finger', [[0, 0]], [[70, 20]]);
    await gesture('two fingers apart', [[-20, 0], [20, 0]], [[-70, 0], [70, 0]]);
    await gesture('two fingers side by side', [[-30, 0], [30, 0]], [[10, 50], [70, 50]]);
  }
  await close(page, name);
}

// The same page with a cloud of 100 000 points: the time of a frame while the view turns, drawn by the
// processor (a graphics card is faster), and of finding the point under the pointer.
const many = 100000, large = resolve(out, 'large.html');
const text = readFileSync(resolve(report), 'utf8'), mark = /(<script type="application\/json" id="scene-data">)(.*?)(<\/script>)/s;
const scene = JSON.parse(text.match(mark)[2]), from = Buffer.from(scene.positions, 'base64');
const few = new Float32Array(from.buffer.slice(from.byteOffset, from.byteOffset + from.length)), points = new Float32Array(3 * many);
for (let i = 0; i < 3 * many; i++) points[i] = few[i % few.length] + ((i * 7919) % 1000) / 2000 * Math.floor(i / few.length) / 4;
scene.positions = Buffer.from(points.buffer).toString('base64');
scene.brightness = Buffer.alloc(many, 128).toString('base64');
writeFileSync(large, text.replace(mark, (_, head, __, tail) => head + JSON.stringify(scene) + tail));
const page = await browser.newPage({ viewport: { width: 1280, height: 900 } });
await page.goto(pathToFileURL(large).href);
await page.locator('.view-3d[data-ready=yes]').waitFor({ timeout: 30000 });
if (Number(await page.locator('.view-3d').getAttribute('data-points')) !== many) fault('the large cloud is not drawn whole');
await page.locator('.view-3d canvas').scrollIntoViewIfNeeded();
const ms = await page.evaluate(async () => {
  const c = document.querySelector('.view-3d canvas'), r = c.getBoundingClientRect(), gl = c.getContext('webgl2'), times = [];
  const send = (type, x) => c.dispatchEvent(new PointerEvent(type, { pointerId: 1, pointerType: 'mouse', isPrimary: true, button: 0, buttons: 1, clientX: r.x + x, clientY: r.y + 200, bubbles: true }));
  c.setPointerCapture = () => {}; c.releasePointerCapture = () => {}; // synthetic pointers can't be captured
  send('pointerdown', 300);
  for (let k = 0; k < 30; k++) {
    const t = performance.now();
    send('pointermove', 300 + 8 * k);
    await new Promise(requestAnimationFrame);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits until it is drawn
    times.push(performance.now() - t);
  }
  send('pointerup', 540);
  return times.sort((a, b) => a - b)[8]; // the lower quartile: other work on the machine counts less
});
console.log(`${many} points: ${ms.toFixed(1)} ms a frame while turning (lower quartile, software rendering)`);
// 130 ms on two processor cores that also do other work, without a graphics card: what takes much longer
// is a fault.
if (ms > 350) fault(`a frame of ${many} points takes ${ms.toFixed(0)} ms`);
await page.locator('.view-3d canvas').screenshot({ path: `${out}/large.png` });
await browser.close();
console.log(faults.length ? `${faults.length} faults` : 'the report is sound: no console error, no request, the view turns');
process.exit(faults.length ? 1 : 0);
