// The pads: what the pins' drivers, external resistors and outside signals make of each pin, when it
// changed, and what the PIO's inputs see of it after the synchroniser.

const PINS = 30;
// rp2040js' GPIOPinState.
const LOW = 0, HIGH = 1;

export class Pads {
  /** @param external level of a pin that nothing drives, by external resistors: { pin: 0 | 1 } */
  constructor(mcu, external) {
    this.mcu = mcu;
    this.clock = mcu.clock;
    this.external = external;
    this.level = new Uint8Array(PINS);
    /** Recent changes of each pin: [cycle, level], newest last. */
    this.changes = Array.from({ length: PINS }, () => []);
    this.watched = 0;
    this.pio = [];
    this.onEdge = () => {};
    /** What the outside drives, if anything. */
    this.outside = new Array(PINS).fill(null);
    this.driving = 0;
  }

  /** After the blocks are in place: pins as they are now, and every change from now on. */
  attach() {
    for (let pin = 0; pin < PINS; pin++) {
      this.level[pin] = this.value(pin);
      this.mcu.gpio[pin].rawInputValue = !!this.level[pin];
      this.mcu.gpio[pin].addListener(() => this.settle(pin, this.driving || this.clock.cycle));
    }
  }

  value(pin) {
    const state = this.mcu.gpio[pin].value;
    if (state === HIGH) return 1;
    if (state === LOW) return 0;
    if (this.outside[pin] !== null) return this.outside[pin];
    if (pin in this.external) return this.external[pin];
    return state === 3 ? 1 : 0; // internal pull-up, else taken as low
  }

  settle(pin, t) {
    const now = this.value(pin);
    if (now === this.level[pin]) return;
    this.level[pin] = now;
    const changes = this.changes[pin];
    changes.push([t, now]);
    if (changes.length > 6) changes.shift();
    // Pins that the CPU reads or has an interrupt on see the pad as well.
    this.mcu.gpio[pin].setInputValue(!!now);
    this.onEdge(pin, now, t);
    for (const pio of this.pio) pio.inputChanged(1 << pin, t);
  }

  /** A PIO block drives other levels on these pins from cycle `t` on. */
  driven(mask, t) {
    this.driving = t;
    for (let pin = 0; mask; pin++, mask >>>= 1) if (mask & 1) this.mcu.gpio[pin].checkForUpdates();
    this.driving = 0;
  }

  /** The outside world sets a pin (null: lets it go). */
  set(pin, level) {
    this.outside[pin] = level;
    this.settle(pin, this.clock.cycle);
    for (const pio of this.pio) pio.schedule();
  }

  /** The level that an instruction of cycle `t` sees through `delay` flip-flops. */
  input(pin, t, delay) {
    const changes = this.changes[pin];
    let level = this.level[pin];
    for (let i = changes.length - 1; i >= 0 && changes[i][0] > t - delay; i--) level = 1 - changes[i][1];
    return !!level;
  }

  /** When the next change that is under way arrives, for an instruction that waits since `t`. */
  pending(pin, t, delay) {
    for (const [at] of this.changes[pin]) if (at + delay > t) return at + delay;
    return Infinity;
  }

  inputs(t, delay) {
    let all = 0;
    for (let pin = 0; pin < PINS; pin++) if (this.input(pin, t, delay)) all |= 1 << pin;
    return all >>> 0;
  }
}
