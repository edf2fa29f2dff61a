// The PIO model against the datasheet's own statements: instruction timings, FIFOs, flags.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Pio } from './pio.mjs';

const OUT = (where, n) => 0x6000 | (where << 5) | (n & 31);
const SET = (where, v, d = 0) => 0xe000 | (d << 8) | (where << 5) | v;
const JMP = (cond, to, d = 0) => (d << 8) | (cond << 5) | to;
const WAIT = (polarity, source, index) => 0x2000 | (polarity << 7) | (source << 5) | index;
const PULL = 0x80a0, PULL_NOBLOCK = 0x8080, PUSH = 0x8020;
const MOV = (to, from, op = 0) => 0xa000 | (to << 5) | (op << 3) | from;
const IRQ = (n, wait = 0) => 0xc000 | (wait << 5) | n;
const PINS = 0, X = 1, Y = 2, ISR = 6, OSR = 7, XDEC = 2, YDEC = 4;

/** A block whose pins are watched; `program` at 0, wrapped, on machine 0. */
function block(program, { autopull = false, join = false, machine = 0 } = {}) {
  const levels = new Uint8Array(32), edges = [], interrupts = {};
  const clock = { cycle: 0 };
  const mcu = {
    clock,
    dma: { setDREQ() {}, clearDREQ() {} },
    setInterrupt: (n, on) => { interrupts[n] = on; },
  };
  const pads = {
    driven(mask, t) {
      for (let pin = 0; pin < 30; pin++) if (mask >>> pin & 1) edges.push([t, pin, (pio.pinValues >>> pin) & 1]);
    },
    input: (pin, t, delay) => !!levels[pin],
    inputs: () => levels.reduce((all, l, pin) => all | (l << pin), 0),
    pending: () => Infinity,
  };
  const pio = new Pio(mcu, 0, 7, pads);
  program.forEach((op, i) => pio.writeUint32(0x48 + 4 * i, op));
  const base = 0xc8 + 0x18 * machine;
  pio.writeUint32(base + 4, ((program.length - 1) << 12) >>> 0);
  pio.writeUint32(base + 8, ((3 << 18) | (autopull ? 1 << 17 : 0) | (join ? 1 << 30 : 0)) >>> 0);
  pio.writeUint32(base + 0x14, (1 << 26) | (5 << 5)); // SET pin 5
  const run = (to) => { pio.advance(to); clock.cycle = to; };
  return { pio, clock, levels, edges, interrupts, run, base, start: () => pio.writeUint32(0, 1 << machine) };
}

test('one instruction a cycle, delays on top', () => {
  const b = block([SET(PINS, 1, 3), SET(PINS, 0)]);
  b.start();
  b.run(20);
  // First instruction in cycle 1, on the pad in 2; high for 1 + 3 cycles, low for 1.
  assert.deepEqual(b.edges.slice(0, 4), [[2, 5, 1], [6, 5, 0], [7, 5, 1], [11, 5, 0]]);
});

test('a counted loop takes its rounds, jumped over or not', () => {
  const b = block([SET(Y, 9), JMP(YDEC, 1), SET(PINS, 1), JMP(0, 3)]);
  b.start();
  b.run(100);
  // set y in 1, then 10 rounds (9 taken, the tenth falls through) in 2 to 11, set pins in 12.
  assert.deepEqual(b.edges, [[13, 5, 1]]);
});

test('autopull: a word that waits costs nothing, a machine that stalls says so', () => {
  const b = block([OUT(X, 16), OUT(Y, 16), SET(PINS, 1), SET(PINS, 0)], { autopull: true });
  b.pio.writeUint32(0x10, 1);
  b.pio.writeUint32(0x10, 2);
  b.start();
  b.run(30);
  const rising = b.edges.filter((e) => e[2]).map((e) => e[0]);
  // The very first OUT finds the OSR empty: one cycle for the refill. After that rounds of 4.
  assert.deepEqual(rising, [5, 9]);
  assert.equal((b.pio.readUint32(8) >>> 24) & 1, 1, 'TXSTALL');
});

test('a joined FIFO holds eight, another four', () => {
  for (const [join, depth] of [[false, 4], [true, 8]]) {
    const b = block([PULL], { join });
    for (let i = 0; i < 10; i++) b.pio.writeUint32(0x10, i);
    assert.equal(b.pio.readUint32(0xc) & 15, depth);
    assert.equal((b.pio.readUint32(8) >>> 16) & 1, 1, 'TXOVER');
  }
});

test('PULL NOBLOCK without a word copies X', () => {
  const b = block([SET(X, 21), PULL_NOBLOCK, MOV(ISR, OSR), PUSH, JMP(0, 4)]);
  b.start();
  b.run(10);
  assert.equal(b.pio.readUint32(0x20), 21);
});

test('a flag is seen a cycle later and falls with the wait', () => {
  const b = block([WAIT(1, 2, 4), SET(PINS, 1), JMP(0, 2)]);
  b.start();
  b.run(10);
  b.pio.writeUint32(0x34, 1 << 4);
  b.run(20);
  assert.deepEqual(b.edges, [[13, 5, 1]]); // forced in 10, seen in 11, set in 12, pad in 13
  assert.equal(b.pio.readUint32(0x30), 0);
});

test('IRQ WAIT stands until the CPU clears the flag', () => {
  const b = block([IRQ(0, 1), SET(PINS, 1), JMP(0, 2)]);
  b.pio.writeUint32(0x138, 1 << 8);
  b.start();
  b.run(50);
  assert.deepEqual(b.edges, []);
  assert.equal(b.interrupts[8], true);
  b.pio.writeUint32(0x30, 1);
  b.run(60);
  assert.deepEqual(b.edges, [[53, 5, 1]]); // cleared in 50, seen in 51, set in 52
  assert.equal(b.interrupts[8], false);
});

test('an injected jump leaves a stall, a restart forgets it', () => {
  const b = block([PULL, SET(PINS, 1), JMP(0, 2)]);
  b.start();
  b.run(5);
  b.pio.writeUint32(b.base + 0x10, JMP(0, 1));
  b.run(10);
  assert.deepEqual(b.edges, [[7, 5, 1]]); // injected in 5, set in 6
});

test('a disabled machine stands still', () => {
  const b = block([SET(PINS, 1), SET(PINS, 0)]);
  b.start();
  b.run(3);
  b.pio.writeUint32(0, 0);
  const seen = b.edges.length;
  b.run(100);
  assert.equal(b.edges.length, seen);
});
