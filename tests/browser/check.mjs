// node check.mjs REPORT.html OUT-DIR: opens a report in headless Chromium as a reader would. Fails on any
// console error, on any request but for the file itself, if the view does not turn, if no point is found
// under the pointer, or if the page is wider than the window. Keeps screenshots.
import { chromium } from 'playwright-core';
import { mkdirSync } from 'node:fs';
import { resolve } from 'node:path';
import { pathToFileURL } from 'node:url';

const [report, out] = process.argv.slice(2);
if (!report || !out) { console.error('usage: node check.mjs REPORT.html OUT-DIR'); process.exit(2); }
mkdirSync(out, { recursive: true });
const url = pathToFileURL(resolve(report)).href, faults = [];
const fault = (text) => { faults.push(text); console.error(`FAULT: ${text}`); };

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--disable-quic', '--no-first-run',
    '--disable-background-networking', '--disable-component-update', '--disable-sync'],
});
for (const [name, width, scheme] of [['wide', 1280, 'light'], ['narrow', 400, 'light'], ['dark', 1280, 'dark']]) {
  const page = await browser.newPage({ viewport: { width, height: 900 }, colorScheme: scheme, hasTouch: name === 'narrow' });
  page.on('console', (m) => { if (m.type() === 'error') fault(`${name}: console: ${m.text()}`); });
  page.on('pageerror', (e) => fault(`${name}: ${e.message}`));
  page.on('request', (r) => { if (r.url() !== url && !r.url().startsWith('data:')) fault(`${name}: request for ${r.url()}`); });
  await page.goto(url);
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
    await changes('first view', () => page.locator('.scene button').click());
    await canvas.scrollIntoViewIfNeeded();
    if (!(await look()).equals(before)) fault('the first view does not come back');
    // Frames while turning: smooth even on a software renderer.
    const ms = await page.evaluate(async () => {
      const c = document.querySelector('.view-3d canvas'), r = c.getBoundingClientRect(), t0 = performance.now();
      for (let k = 0; k < 10; k++) {
        c.dispatchEvent(new WheelEvent('wheel', { deltaY: k % 2 ? 20 : -20, clientX: r.x + 50, clientY: r.y + 50, bubbles: true, cancelable: true }));
        await new Promise(requestAnimationFrame);
      }
      return (performance.now() - t0) / 10;
    });
    console.log(`${points} points, ${ms.toFixed(1)} ms a frame (software rendering)`);
    await page.pdf({ path: `${out}/report.pdf`, format: 'A4' });
  }
  if (name === 'narrow') {
    // One finger turns, two zoom.
    const touch = await page.context().newCDPSession(page);
    const send = (type, points) => touch.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([dx, dy], id) => ({ x: x + dx, y: y + dy, id })) });
    const gesture = async (what, from, to) => {
      const before = await canvas.screenshot();
      await send('touchStart', from);
      for (let k = 1; k <= 5; k++) await send('touchMove', from.map(([fx, fy], i) => [fx + (to[i][0] - fx) * k / 5, fy + (to[i][1] - fy) * k / 5]));
      await send('touchEnd', []);
      await page.waitForTimeout(200);
      if (before.equals(await canvas.screenshot())) fault(`${what} does nothing`);
    };
    await gesture('a finger', [[0, 0]], [[70, 20]]);
    await gesture('two fingers', [[-20, 0], [20, 0]], [[-70, 0], [70, 0]]);
  }
  const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  if (over > 0) fault(`${name}: the page is ${over} px wider than the window`);
  await page.screenshot({ path: `${out}/${name}.png`, fullPage: true });
  await page.close();
}
await browser.close();
console.log(faults.length ? `${faults.length} faults` : 'the report is sound: no console error, no request, the view turns');
process.exit(faults.length ? 1 : 0);
