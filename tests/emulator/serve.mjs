// node serve.mjs ELF: the emulated board for a test in another process, in lock-step: the board runs
// only while it is told to, so a test sees the same cycles in every run. One line in, one line out.
//
//   run CYCLES [HEX]     bytes to the board, then run; ends early when the board has sent something
//   pin PIN 0|1          the outside drives a pin
//   at STEPS [DELAY] pin PIN 0|1 | freeze
//                        later: DELAY cycles after the so-manieth STEP edge from now
//   slide START TRAVEL   a slide that stands START steps from its home switch, the far limit TRAVEL
//                        steps from it: STEP and DIR move it, it moves the switches
//   camera DELAY LENGTH [MISSED]…
//                        a camera that answers each trigger by exposing, DELAY cycles later, but for
//                        the triggers that it misses (from 0, counted from now)
//   freeze               the CPU stops for good
//   hang                 the same, but the watchdog goes on
//   panic LINE           the program panics, as if by a division by zero in that line
//   fault                the CPU takes a hard fault
//   mark                 forgets the edges so far
//   edges FILE           writes them: u64 little-endian each, cycle · 64 + pin · 2 + level
//   log                  defmt's bytes since the last time, as hex
//   quit
//
// Answers: `CYCLE STEPS RESETS ASLEEP HEX` after `run`, `ok`, or `error …`. STEPS counts STEP edges
// since the start, ASLEEP the cycles in which the CPU slept.
import { writeFileSync } from 'node:fs';
import { createInterface } from 'node:readline';
import { NS, Pico } from './pico.mjs';

const STEP = 2, DIR = 3, TRIGGER = 6, HOME = 10, LIMIT = 11, EXPOSURE = 14;
/** Resistors and closed switches of a board at rest: ENABLE pulled up, LASER down, inputs closed. */
export const AT_REST = { 3: 0, 4: 1, 7: 0, 10: 0, 11: 0, 12: 0, 13: 0, 14: 0 };

class Edges {
  low = new Uint32Array(1 << 16);
  high = new Uint32Array(1 << 16);
  length = 0;
  push(pin, level, cycle) {
    if (this.length === this.low.length) {
      for (const name of ['low', 'high']) {
        const larger = new Uint32Array(2 * this.length);
        larger.set(this[name]);
        this[name] = larger;
      }
    }
    const word = cycle * 64 + pin * 2 + level; // below 2^53 for 13 days
    this.low[this.length] = word % 2 ** 32;
    this.high[this.length++] = Math.floor(word / 2 ** 32);
  }
  write(file) {
    const out = new Uint32Array(2 * this.length);
    for (let i = 0; i < this.length; i++) {
      out[2 * i] = this.low[i];
      out[2 * i + 1] = this.high[i];
    }
    writeFileSync(file, new Uint8Array(out.buffer));
  }
}

export class Session {
  steps = 0;
  edges = new Edges();
  /** What is to happen at a count of steps, or at a cycle. */
  later = [];

  constructor(elf) {
    const pico = (this.pico = new Pico(elf, AT_REST));
    pico.edges = (pin, level, cycle) => {
      this.edges.push(pin, level, cycle);
      if (pin === STEP && level) {
        this.steps++;
        for (const event of this.later) if (event.steps === this.steps) event.alarm.schedule(event.delay * NS);
        if (this.slide) this.move();
      }
      if (pin === TRIGGER && level && this.camera) this.expose();
    };
    this.received = [];
    pico.onData = (data) => this.received.push(...data);
  }

  move() {
    const { slide, pico } = this;
    slide.at += pico.pads.level[DIR] ? 1 : -1;
    const home = +(slide.at <= 0), limit = +(slide.at >= slide.travel);
    if (home !== slide.home) pico.set(HOME, (slide.home = home));
    if (limit !== slide.limit) pico.set(LIMIT, (slide.limit = limit));
  }

  expose() {
    const { delay, length, missed } = this.camera, { clock } = this.pico;
    if (missed.has(this.camera.triggers++)) return;
    const end = clock.createAlarm(() => this.pico.set(EXPOSURE, 0));
    clock.createAlarm(() => {
      this.pico.set(EXPOSURE, 1);
      end.schedule(length * NS);
    }).schedule(delay * NS);
  }

  run(cycles, bytes) {
    if (bytes.length) this.pico.send(bytes);
    this.received = [];
    this.pico.run(cycles, () => this.received.length > 0);
    return Buffer.from(this.received);
  }

  at(steps, delay, action) {
    const event = { steps: this.steps + steps, delay };
    event.alarm = this.pico.clock.createAlarm(action);
    this.later.push(event);
  }

  command(line) {
    const [name, ...rest] = line.trim().split(/\s+/);
    const { pico } = this;
    switch (name) {
      case 'run': {
        const out = this.run(Number(rest[0]), Buffer.from(rest[1] ?? '', 'hex'));
        if (pico.halted) return `error ${pico.halted}`;
        return `${pico.cycle} ${this.steps} ${pico.resets} ${pico.asleep} ${out.toString('hex')}`;
      }
      case 'pin':
        pico.set(Number(rest[0]), Number(rest[1]));
        return 'ok';
      case 'at': {
        const steps = Number(rest.shift());
        const delay = /^\d/.test(rest[0]) ? Number(rest.shift()) : 0;
        this.at(steps, delay, () => this.command(rest.join(' ')));
        return 'ok';
      }
      case 'slide':
        this.slide = { at: Number(rest[0]), travel: Number(rest[1]), home: 0, limit: 0 };
        return 'ok';
      case 'camera':
        this.camera = { delay: Number(rest[0]), length: Number(rest[1]), missed: new Set(rest.slice(2).map(Number)), triggers: 0 };
        return 'ok';
      case 'freeze':
        pico.freeze(true);
        return 'ok';
      case 'hang':
        pico.freeze(false);
        return 'ok';
      case 'panic':
        pico.panic(Number(rest[0]));
        return 'ok';
      case 'fault':
        pico.hardFault();
        return 'ok';
      case 'mark':
        this.edges.length = 0;
        return 'ok';
      case 'edges':
        this.edges.write(rest[0]);
        return 'ok';
      case 'log':
        return `ok ${pico.rtt().toString('hex')}`;
      default:
        return `error unknown command ${name}`;
    }
  }
}

if (process.argv[1]?.endsWith('serve.mjs')) {
  const session = new Session(process.argv[2]);
  const lines = createInterface({ input: process.stdin });
  for await (const line of lines) {
    if (line === 'quit') process.exit(0);
    let answer;
    try {
      answer = session.command(line);
    } catch (error) {
      answer = `error ${error.message.replaceAll('\n', ' ')}`;
    }
    process.stdout.write(`${answer}\n`);
  }
}
