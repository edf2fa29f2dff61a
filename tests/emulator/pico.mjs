// An RP2040 with its flash image, in lock-step: CPU, PIO, DMA, timers and USB share one count of
// cycles. rp2040js 1.4.1 is used for the CPU, DMA, timers, USB and the rest, with these corrections:
//
// - PIO: replaced (pio.mjs); as shipped it runs free of the clock and has no joined FIFOs.
// - SEV: as shipped only logged; without the event a task that wakes another sleeps on.
// - USB: an OUT endpoint that is armed while the host has nothing to send stays armed (a host NAKs);
//   as shipped a zero-length packet answers. AVAILABLE stays set until the data has come.
// - Watchdog: resets the chip; as shipped nothing happens. Scratch registers and reason survive.
// - Boot: no boot ROM; the vector table is entered as boot2 would.
import { createRequire } from 'node:module';
import { Clock, HZ, NS } from './clock.mjs';
import { parseElf } from './elf.mjs';
import { Pads } from './pads.mjs';
import { Pio } from './pio.mjs';

const { RP2040, USBCDC } = createRequire(import.meta.url)('rp2040js');
export { HZ };

const PIO0_IRQ_0 = 7, PIO1_IRQ_0 = 9;
const FLASH = 0x10000000, BOOT2_SIZE = 0x100;

export class Pico {
  /**
   * @param elf path of the image
   * @param external resistors on the board: levels of pins that nobody drives
   */
  constructor(elf, external = {}) {
    this.image = parseElf(elf);
    this.external = external;
    this.clock = new Clock();
    this.edges = () => {};
    this.onData = () => {};
    this.outside = new Map();
    this.complaints = [];
    this.resets = 0;
    /** Cycles in which the CPU slept. */
    this.asleep = 0;
    this.#build();
  }

  get cycle() {
    return this.clock.cycle;
  }

  #build(kept) {
    this.clock.alarms = [];
    this.clock.refresh();
    const mcu = (this.mcu = new RP2040(this.clock));
    const complain = (name, message) => {
      if (this.complaints.length < 100) this.complaints.push(`${name}: ${message}`);
    };
    mcu.logger = {
      debug() {},
      info: (name, message) => {
        if (message === 'SEV') mcu.core.eventRegistered = true;
      },
      warn: complain,
      error: complain,
    };
    for (const { address, data } of this.image.segments) {
      if (address >= FLASH && address < FLASH + 0x1000000) mcu.flash.set(data, address - FLASH);
    }
    mcu.core.VTOR = FLASH + BOOT2_SIZE;
    mcu.core.reset();
    mcu.onBreak = (code) => {
      this.halted = `breakpoint ${code} at ${mcu.core.PC.toString(16)}`;
    };
    const levels = this.pads?.level;
    const changes = this.pads?.changes;
    const pads = (this.pads = new Pads(mcu, this.external));
    if (changes) pads.changes = changes;
    pads.onEdge = (pin, level, t) => this.edges(pin, level, t);
    for (const [pin, level] of this.outside) pads.outside[pin] = level;
    const blocks = [
      [0, PIO0_IRQ_0, 0x50200],
      [1, PIO1_IRQ_0, 0x50300],
    ];
    for (const [index, irq, place] of blocks) {
      const pio = new Pio(mcu, index, irq, pads);
      mcu.pio[index] = pio;
      mcu.peripherals[place] = pio;
      pads.pio.push(pio);
    }
    pads.attach();
    // What a reset does to the pins is an edge too.
    if (levels) for (let pin = 0; pin < 30; pin++) if (levels[pin] !== pads.level[pin]) this.edges(pin, pads.level[pin], this.cycle);
    // CHAN_ABORT reads as done; as shipped it reads all ones.
    const dma = mcu.dma.readUint32.bind(mcu.dma);
    mcu.dma.readUint32 = (offset) => (offset === 0x444 ? 0 : dma(offset));
    const watchdog = mcu.peripherals[0x40058];
    if (kept) {
      watchdog.scratchData.set(kept.scratch);
      watchdog.reason = kept.reason;
    }
    // CHIP_RESET: power-on, unless the watchdog did it.
    const chip = mcu.peripherals[0x40064];
    chip.readUint32 = (offset) => (offset === 8 ? (kept ? 0 : 1 << 8) : 0);
    watchdog.onWatchdogTrigger = () => {
      // As shipped the alarm would find itself due again and again.
      watchdog.alarm.enable = false;
      this.rebooting = true;
    };
    this.frozen = false;
    this.#usb();
  }

  /** USB host: enumerates the CDC function, then passes bytes both ways. */
  #usb() {
    const u = this.mcu.usbCtrl;
    const cdc = (this.cdc = new USBCDC(u));
    this.toDevice = [];
    this.armed = [];
    this.connected = false;
    cdc.onSerialData = (data) => this.onData(data);
    cdc.onDeviceConnected = () => {
      this.connected = true;
    };
    const dpram = this.mcu.usbDPRAMView, updated = u.DPRAMUpdated.bind(u), finish = u.finishRead.bind(u);
    const AVAILABLE = 1 << 10, OUT1 = 0x8c, OUT15 = 0xfc;
    u.DPRAMUpdated = (offset, value) => {
      updated(offset, value);
      if (value & AVAILABLE && offset >= OUT1 - 8 && offset <= OUT15 && offset & 4) dpram.setUint32(offset, dpram.getUint32(offset, true) | AVAILABLE, true);
    };
    u.finishRead = (endpoint, bytes) => {
      const register = OUT1 - 8 + endpoint * 8;
      finish(endpoint, bytes);
      dpram.setUint32(register, dpram.getUint32(register, true) & ~AVAILABLE, true);
    };
    u.onEndpointRead = (endpoint, size) => {
      if (endpoint !== cdc.outEndpoint) return;
      this.armed.push(size);
      this.#pump();
    };
  }

  #pump() {
    while (this.armed.length && this.toDevice.length) {
      const size = Math.min(this.armed.shift(), this.toDevice.length);
      this.mcu.usbCtrl.endpointReadDone(this.cdc.outEndpoint, Uint8Array.from(this.toDevice.splice(0, size)));
    }
  }

  /** Bytes from the host to the board. */
  send(bytes) {
    for (const byte of bytes) this.toDevice.push(byte);
    this.#pump();
  }

  /** The outside drives a pin. */
  set(pin, level) {
    this.outside.set(pin, level);
    this.pads.set(pin, level);
  }

  /** Runs for so many cycles, or until `until()`. */
  run(cycles, until) {
    const { clock } = this;
    const end = clock.cycle + cycles;
    while (clock.cycle < end) {
      if (this.rebooting) {
        this.rebooting = false;
        this.resets++;
        const watchdog = this.mcu.peripherals[0x40058];
        this.#build({ scratch: watchdog.scratchData, reason: watchdog.reason });
      }
      const { core, pio } = this.mcu;
      if (core.waiting || this.frozen || this.halted) {
        // Asleep: on to the next thing that can happen.
        const next = Math.min(end, clock.due, pio[0].next, pio[1].next);
        if (next > clock.cycle) {
          this.asleep += next - clock.cycle;
          clock.cycle = next;
        }
      } else {
        clock.cycle += core.executeInstruction();
      }
      if (clock.cycle >= clock.due) clock.run();
      if (clock.cycle >= pio[0].next) pio[0].advance(clock.cycle);
      if (clock.cycle >= pio[1].next) pio[1].advance(clock.cycle);
      if (until?.()) break;
    }
  }

  /**
   * The CPU stops as if it had died: everything else goes on. The watchdog would reset the chip soon;
   * without it the laser's lease and the starving of the motion are seen alone.
   */
  freeze(withoutWatchdog) {
    this.frozen = true;
    if (withoutWatchdog) this.mcu.peripherals[0x40058].alarm.enable = false;
  }

  /** The program goes on in the runtime's panic for a division by zero, with a location that names `line`. */
  panic(line) {
    const { core } = this.mcu;
    const name = [...this.image.symbols.keys()].find((s) => s.includes('panic_const_div_by_zero'));
    if (!name) throw new Error('the image has no panic for a division by zero');
    // core::panic::Location { file: &str, line: u32, col: u32 }, in RAM between the statics and the stack.
    const location = 0x20030000;
    [FLASH + BOOT2_SIZE, 1, line, 1].forEach((word, i) => this.mcu.writeUint32(location + 4 * i, word));
    core.waiting = false;
    core.registers[0] = location;
    core.PC = this.image.symbols.get(name) & ~1;
  }

  /** The CPU takes a hard fault where it is. */
  hardFault() {
    const { core } = this.mcu;
    core.waiting = false;
    core.exceptionEntry(3);
  }

  /** defmt-rtt's up buffer, raw. */
  rtt() {
    const address = this.image.symbols.get('_SEGGER_RTT'), { mcu } = this;
    if (!address) return Buffer.alloc(0);
    const up = address + 24;
    const buffer = mcu.readUint32(up + 4), size = mcu.readUint32(up + 8), write = mcu.readUint32(up + 12);
    let read = mcu.readUint32(up + 16);
    const out = [];
    while (read !== write) {
      out.push(mcu.readUint8(buffer + read));
      read = (read + 1) % size;
    }
    mcu.writeUint32(up + 16, read);
    return Buffer.from(out);
  }
}

export const cyclesOf = (seconds) => Math.round(seconds * HZ);
export { NS };
