// A cycle-true RP2040 PIO block (datasheet, chapter 3) in the place of rp2040js' own, which runs
// free of the system clock, has no joined FIFOs, and looks at pins without the synchroniser's delay.
//
// Every effect of one machine on another takes at least a cycle, so the order in which machines of
// the same cycle are executed does not matter:
//   a pin written in cycle t is on the pad in t + 1 and passes the two flip-flops of the input
//   synchroniser: an instruction sees it from t + 3 on; a flag raised in t is seen from t + 1 on;
//   a word written into a FIFO in t likewise.
// Edges are recorded with the cycle of the instruction that made them.

const NEVER = Infinity;
const PAD = 1; // from a write to the pad
const SYNCHRONISER = 2; // from the pad to an instruction

// Offsets of registers.
const CTRL = 0x000, FSTAT = 0x004, FDEBUG = 0x008, FLEVEL = 0x00c, TXF0 = 0x010, RXF0 = 0x020;
const IRQ = 0x030, IRQ_FORCE = 0x034, SYNC_BYPASS = 0x038, PADOUT = 0x03c, PADOE = 0x040, CFGINFO = 0x044;
const INSTR_MEM = 0x048, SM = 0x0c8, INTR = 0x128, INTE = [0x12c, 0x138], INTF = [0x130, 0x13c], INTS = [0x134, 0x140];

class Fifo {
  words = [];
  constructor(depth) {
    this.depth = depth;
  }
  get full() {
    return this.words.length >= this.depth;
  }
}

class Machine {
  enabled = false;
  x = 0; y = 0; isr = 0; osr = 0; isrCount = 0; osrCount = 32; pc = 0;
  clkdiv = 1 << 16; execctrl = 0x1f << 12; shiftctrl = 0b11 << 18; pinctrl = 5 << 26;
  tx = new Fifo(4);
  rx = new Fifo(4);
  /** The cycle in which the next instruction runs; NEVER while it waits for something. */
  next = NEVER;
  /** What it waits for: 'tx', 'rx', a flag's number, or a pin's as 32 + pin. */
  waiting = null;
  /** An instruction written to INSTR that stalled. */
  forced = -1;
  /** An IRQ WAIT has raised its flag and waits for it to fall. */
  raised = false;
  constructor(index) {
    this.index = index;
  }
}

export class Pio {
  rawWriteValue = 0;
  // rp2040js' pins look into these.
  pinValues = 0;
  pinDirections = 0;
  machines_ = [0, 1, 2, 3].map((i) => new Machine(i));
  machines = [];

  /** `pads` tells about pads and is told of outputs; see pico.mjs. */
  constructor(mcu, index, firstIrq, pads) {
    this.mcu = mcu;
    this.index = index;
    this.firstIrq = firstIrq;
    this.pads = pads;
    this.clock = mcu.clock;
    this.memory = new Uint16Array(32);
    this.flags = 0;
    /** When each flag was raised last. */
    this.flagAt = new Float64Array(8);
    this.fdebug = 0;
    this.bypass = 0;
    this.inte = [0, 0];
    this.intf = [0, 0];
    this.next = NEVER;
    for (const m of this.machines_) this.requests(m);
  }

  // --- the bus

  readUint32(offset) {
    const m = this.machines_;
    if (offset >= SM && offset < INTR) {
      const s = m[Math.floor((offset - SM) / 0x18)];
      switch ((offset - SM) % 0x18) {
        case 0x00: return s.clkdiv;
        case 0x04: return (s.execctrl | (s.forced >= 0 ? 1 << 31 : 0)) >>> 0;
        case 0x08: return s.shiftctrl;
        case 0x0c: return s.pc;
        case 0x10: return this.memory[s.pc];
        case 0x14: return s.pinctrl;
      }
    }
    const four = (f) => m.reduce((v, s) => v | (f(s) ? 1 << s.index : 0), 0);
    switch (offset) {
      case CTRL: return four((s) => s.enabled);
      case FSTAT:
        return ((four((s) => !s.tx.words.length) << 24) | (four((s) => s.tx.full) << 16) |
          (four((s) => !s.rx.words.length) << 8) | four((s) => s.rx.full)) >>> 0;
      case FDEBUG: return this.fdebug;
      case FLEVEL: return m.reduce((v, s) => v | ((s.tx.words.length | (s.rx.words.length << 4)) << (8 * s.index)), 0) >>> 0;
      case RXF0: case RXF0 + 4: case RXF0 + 8: case RXF0 + 12: return this.pull(m[(offset - RXF0) >> 2]);
      case IRQ: return this.flags;
      case IRQ_FORCE: return 0;
      case SYNC_BYPASS: return this.bypass;
      case PADOUT: return this.pinValues;
      case PADOE: return this.pinDirections;
      case CFGINFO: return 0x200404;
      case INTR: return this.raw();
    }
    for (const i of [0, 1]) {
      if (offset === INTE[i]) return this.inte[i];
      if (offset === INTF[i]) return this.intf[i];
      if (offset === INTS[i]) return (this.raw() & this.inte[i]) | this.intf[i];
    }
    return 0;
  }

  writeUint32Atomic(offset, value, type) {
    if (offset === IRQ || offset === FDEBUG) return this.writeUint32(offset, type === 0 || type === 2 ? value : 0);
    const old = type && !(offset >= TXF0 && offset < TXF0 + 16) ? this.readUint32(offset) : 0;
    const v = type === 1 ? old ^ value : type === 2 ? old | value : type === 3 ? old & ~value : value;
    this.writeUint32(offset, v >>> 0);
  }

  writeUint32(offset, value) {
    const now = this.clock.cycle;
    const m = this.machines_;
    if (offset >= INSTR_MEM && offset < SM) {
      this.memory[(offset - INSTR_MEM) >> 2] = value;
    } else if (offset >= SM && offset < INTR) {
      const s = m[Math.floor((offset - SM) / 0x18)];
      switch ((offset - SM) % 0x18) {
        case 0x00: s.clkdiv = value; break;
        case 0x04: s.execctrl = value & 0x7fffffff; break;
        case 0x08: this.setShift(s, value); break;
        case 0x10: this.force(s, value & 0xffff, now); break;
        case 0x14: s.pinctrl = value >>> 0; break;
      }
    } else if (offset >= TXF0 && offset < TXF0 + 16) {
      const s = m[(offset - TXF0) >> 2];
      if (s.tx.full) this.fdebug |= 1 << (16 + s.index);
      else s.tx.words.push(value >>> 0);
      if (s.waiting === 'tx') this.wake(s, now + 1);
      else if (s.enabled && s.shiftctrl & (1 << 17) && s.osrCount >= ((s.shiftctrl >>> 25 & 31) || 32)) this.refill(s);
      this.requests(s);
    } else if (offset === CTRL) {
      for (const s of m) {
        if (value & (16 << s.index)) { // restart
          s.isr = 0; s.isrCount = 0; s.osrCount = 32; s.waiting = null; s.forced = -1; s.raised = false;
          if (s.enabled) s.next = now + 1;
        }
        const on = !!(value & (1 << s.index));
        if (on && !s.enabled) { s.next = now + 1; s.waiting = null; }
        if (!on) { s.next = NEVER; s.waiting = null; }
        s.enabled = on;
      }
    } else if (offset === FDEBUG) {
      this.fdebug &= ~value;
      // A machine that stalls now shows it again in the next cycle.
      for (const s of m) {
        if (s.waiting === 'tx' && s.enabled) this.fdebug |= 1 << (24 + s.index);
        if (s.waiting === 'rx' && s.enabled) this.fdebug |= 1 << s.index;
      }
    } else if (offset === IRQ) {
      this.setFlags(this.flags & ~value, now);
    } else if (offset === IRQ_FORCE) {
      this.setFlags(this.flags | value, now);
    } else if (offset === SYNC_BYPASS) {
      this.bypass = value;
    } else {
      for (const i of [0, 1]) {
        if (offset === INTE[i]) this.inte[i] = value & 0xfff;
        if (offset === INTF[i]) this.intf[i] = value & 0xfff;
      }
    }
    this.interrupts();
    this.schedule();
  }

  setShift(s, value) {
    // A change of either join bit flushes both FIFOs.
    if (((s.shiftctrl ^ value) >>> 30) & 3) { s.tx.words = []; s.rx.words = []; }
    s.shiftctrl = value >>> 0;
    const rx = value >>> 31, tx = (value >>> 30) & 1;
    s.tx.depth = tx ? 8 : rx ? 0 : 4;
    s.rx.depth = rx ? 8 : tx ? 0 : 4;
    this.requests(s);
  }

  /** DREQ lines: a place in TX, a word in RX. */
  requests(s) {
    const { dma } = this.mcu, base = 8 * this.index;
    s.tx.full ? dma.clearDREQ(base + s.index) : dma.setDREQ(base + s.index);
    s.rx.words.length ? dma.setDREQ(base + 4 + s.index) : dma.clearDREQ(base + 4 + s.index);
  }

  pull(s) {
    if (!s.rx.words.length) { this.fdebug |= 1 << (8 + s.index); return 0; }
    const word = s.rx.words.shift();
    this.requests(s);
    if (s.waiting === 'rx') this.wake(s, this.clock.cycle + 1);
    this.interrupts();
    this.schedule();
    return word;
  }

  raw() {
    let raw = (this.flags & 0xf) << 8;
    for (const s of this.machines_) {
      if (s.rx.words.length) raw |= 1 << s.index;
      if (!s.tx.full) raw |= 16 << s.index;
    }
    return raw;
  }

  interrupts() {
    const raw = this.raw();
    for (const i of [0, 1]) this.mcu.setInterrupt(this.firstIrq + i, !!((raw & this.inte[i]) | this.intf[i]));
  }

  // --- waiting and waking

  wake(s, at) {
    if (!s.enabled && s.forced < 0) return;
    s.waiting = null;
    s.next = at;
    if (at < this.next) this.next = at;
  }

  schedule() {
    let next = NEVER;
    for (const s of this.machines_) if (s.next < next) next = s.next;
    this.next = next;
  }

  setFlags(flags, t) {
    const changed = this.flags ^ flags;
    this.flags = flags & 0xff;
    for (let i = 0; i < 8; i++) {
      if (!(changed & (1 << i))) continue;
      this.flagAt[i] = t;
      for (const s of this.machines_) if (s.waiting === i) this.wake(s, t + 1);
    }
  }

  /** The pads' inputs changed in cycle `t` (mask of changed pins): machines waiting for them wake. */
  inputChanged(mask, t) {
    for (const s of this.machines_) {
      if (s.waiting >= 32 && mask & (1 << (s.waiting - 32))) this.wake(s, t + (this.bypass & (1 << (s.waiting - 32)) ? 0 : SYNCHRONISER));
    }
  }

  // --- execution

  /** Runs all instructions up to and including cycle `to`. */
  advance(to) {
    while (this.next <= to) {
      const t = this.next;
      for (const s of this.machines_) if (s.next === t) this.step(s, t);
      this.schedule();
    }
  }

  force(s, op, t) {
    const pc = s.pc, next = s.next, waiting = s.waiting;
    s.forced = op;
    const done = this.execute(s, op, t, true);
    if (done) {
      s.forced = -1;
      if (s.pc !== pc) s.raised = false;
      // The machine's own instruction goes on: a stalled one is looked at again.
      if (s.enabled) { s.next = s.pc !== pc || waiting !== null ? t + 1 : next; s.waiting = null; }
      else { s.next = NEVER; s.waiting = null; }
    }
  }

  step(s, t) {
    if (s.forced >= 0) {
      if (this.execute(s, s.forced, t, true)) { s.forced = -1; s.waiting = null; s.next = s.enabled ? t + 1 : NEVER; }
      return;
    }
    this.execute(s, this.memory[s.pc], t, false);
  }

  /** Runs one instruction; false if it stalls. */
  execute(s, op, t, injected) {
    const arg = (op >> 5) & 7, low = op & 31;
    let jump = -1;
    switch (op >> 13) {
      case 0: { // JMP
        let taken;
        switch (arg) {
          case 0: taken = true; break;
          case 1: taken = s.x === 0; break;
          case 2:
            // All rounds of `jmp x-- self` but the last at once.
            if (!injected && low === s.pc && s.x > 0) { s.next = t + s.x * (1 + this.delay(s, op)); s.x = 0; return true; }
            taken = s.x !== 0; s.x = (s.x - 1) >>> 0; break;
          case 3: taken = s.y === 0; break;
          case 4:
            if (!injected && low === s.pc && s.y > 0) { s.next = t + s.y * (1 + this.delay(s, op)); s.y = 0; return true; }
            taken = s.y !== 0; s.y = (s.y - 1) >>> 0; break;
          case 5: taken = s.x !== s.y; break;
          case 6: taken = this.pads.input(s.execctrl >>> 24 & 31, t, SYNCHRONISER); break;
          case 7: taken = s.osrCount < ((s.shiftctrl >>> 25 & 31) || 32); break;
        }
        if (taken) jump = low;
        break;
      }
      case 1: { // WAIT
        const polarity = arg >> 2, source = arg & 3;
        if (source === 2) {
          const flag = low & 16 ? (low & 4) | ((low + s.index) & 3) : low & 7;
          const up = this.flags >> flag & 1;
          if (up !== polarity || this.flagAt[flag] >= t) { s.waiting = flag; s.next = this.flagAt[flag] >= t && up === polarity ? t + 1 : NEVER; return false; }
          if (polarity) this.setFlags(this.flags & ~(1 << flag), t);
        } else {
          const pin = source === 0 ? low : (low + (s.pinctrl >>> 15 & 31)) & 31;
          if (+this.pads.input(pin, t, this.bypass >>> pin & 1 ? 0 : SYNCHRONISER) !== polarity) {
            s.waiting = 32 + pin;
            s.next = this.pads.pending(pin, t, SYNCHRONISER);
            return false;
          }
        }
        break;
      }
      case 2: { // IN
        const bits = low || 32;
        const value = this.source(s, arg, t);
        if (bits === 32) s.isr = value;
        else if (s.shiftctrl & (1 << 18)) s.isr = ((s.isr >>> bits) | (value << (32 - bits))) >>> 0;
        else s.isr = ((s.isr << bits) | (value & ((1 << bits) - 1))) >>> 0;
        s.isrCount = Math.min(32, s.isrCount + bits);
        if (s.shiftctrl & (1 << 16) && s.isrCount >= ((s.shiftctrl >>> 20 & 31) || 32)) {
          if (s.rx.full) throw new Error('autopush stall is not modelled');
          this.pushRx(s);
        }
        break;
      }
      case 3: { // OUT
        const auto = s.shiftctrl & (1 << 17), threshold = (s.shiftctrl >>> 25 & 31) || 32;
        if (auto && s.osrCount >= threshold) {
          // Empty: the refill takes this cycle, the OUT runs in the next.
          if (!this.refill(s)) { this.stall(s, 'tx'); return false; }
          s.next = t + 1;
          return true;
        }
        const bits = low || 32;
        let value;
        if (s.shiftctrl & (1 << 19)) { value = bits === 32 ? s.osr : s.osr & ((1 << bits) - 1); s.osr = bits === 32 ? 0 : s.osr >>> bits; }
        else { value = bits === 32 ? s.osr : s.osr >>> (32 - bits); s.osr = bits === 32 ? 0 : (s.osr << bits) >>> 0; }
        value >>>= 0;
        s.osrCount = Math.min(32, s.osrCount + bits);
        if (arg === 0) this.drive(s, value, s.pinctrl & 31, s.pinctrl >>> 20 & 63, false, t);
        else if (arg === 1) s.x = value;
        else if (arg === 2) s.y = value;
        else if (arg === 4) this.drive(s, value, s.pinctrl & 31, s.pinctrl >>> 20 & 63, true, t);
        else if (arg === 5) jump = value & 31;
        else if (arg === 6) { s.isr = value; s.isrCount = bits; }
        else if (arg === 7) throw new Error('OUT EXEC is not modelled');
        if (auto && s.osrCount >= threshold) this.refill(s);
        break;
      }
      case 4: { // PUSH, PULL
        const block = op >> 5 & 1;
        if (op & 0x40) throw new Error('PUSH IFFULL and PULL IFEMPTY are not modelled');
        if (op & 0x80) {
          if (s.tx.words.length) { s.osr = this.takeTx(s); s.osrCount = 0; }
          else if (block) { this.stall(s, 'tx'); return false; }
          else { s.osr = s.x; s.osrCount = 0; }
        } else if (!s.rx.full) this.pushRx(s);
        else if (block) { this.stall(s, 'rx'); return false; }
        else { this.fdebug |= 1 << s.index; s.isr = 0; s.isrCount = 0; }
        break;
      }
      case 5: { // MOV
        let value = this.source(s, op & 7, t);
        const how = op >> 3 & 3;
        if (how === 1) value = ~value >>> 0;
        if (how === 2) { let r = 0; for (let i = 0; i < 32; i++) r = (r << 1) | ((value >>> i) & 1); value = r >>> 0; }
        switch (arg) {
          case 0: this.drive(s, value, s.pinctrl & 31, s.pinctrl >>> 20 & 63, false, t); break;
          case 1: s.x = value; break;
          case 2: s.y = value; break;
          case 4: throw new Error('MOV EXEC is not modelled');
          case 5: jump = value & 31; break;
          case 6: s.isr = value; s.isrCount = 0; break;
          case 7: s.osr = value; s.osrCount = 0; break;
        }
        break;
      }
      case 6: { // IRQ
        const flag = low & 16 ? (low & 4) | ((low + s.index) & 3) : low & 7;
        if (op & 0x40) this.setFlags(this.flags & ~(1 << flag), t);
        else if (op & 0x20 && s.raised) { // IRQ WAIT: up to now it waited for the flag to fall
          if (this.flags >> flag & 1) { s.waiting = flag; s.next = NEVER; return false; }
          s.raised = false;
        } else {
          this.setFlags(this.flags | (1 << flag), t);
          if (op & 0x20) { s.raised = true; s.waiting = flag; s.next = NEVER; this.interrupts(); return false; }
        }
        this.interrupts();
        break;
      }
      case 7: // SET
        if (arg === 0) this.drive(s, low, s.pinctrl >>> 5 & 31, s.pinctrl >>> 26 & 7, false, t);
        else if (arg === 1) s.x = low;
        else if (arg === 2) s.y = low;
        else if (arg === 4) this.drive(s, low, s.pinctrl >>> 5 & 31, s.pinctrl >>> 26 & 7, true, t);
        break;
    }
    if (jump >= 0) s.pc = jump;
    else if (!injected) s.pc = s.pc === (s.execctrl >>> 12 & 31) ? s.execctrl >>> 7 & 31 : (s.pc + 1) & 31;
    if (!injected) s.next = t + 1 + this.delay(s, op);
    return true;
  }

  delay(s, op) {
    if (s.pinctrl >>> 29) throw new Error('side-set is not modelled');
    return op >> 8 & 31;
  }

  stall(s, what) {
    s.waiting = what;
    s.next = NEVER;
    this.fdebug |= 1 << (s.index + (what === 'tx' ? 24 : 0));
  }

  takeTx(s) {
    const word = s.tx.words.shift();
    this.requests(s);
    return word;
  }

  refill(s) {
    if (!s.tx.words.length) return false;
    s.osr = this.takeTx(s);
    s.osrCount = 0;
    return true;
  }

  pushRx(s) {
    s.rx.words.push(s.isr);
    s.isr = 0;
    s.isrCount = 0;
    this.requests(s);
    this.interrupts();
  }

  source(s, which, t) {
    switch (which) {
      case 0: {
        const base = s.pinctrl >>> 15 & 31, all = this.pads.inputs(t, SYNCHRONISER);
        return base ? ((all << (32 - base)) | (all >>> base)) >>> 0 : all;
      }
      case 1: return s.x;
      case 2: return s.y;
      case 3: return 0;
      case 5: throw new Error('STATUS is not modelled');
      case 6: return s.isr;
      case 7: return s.osr;
    }
    return 0;
  }

  drive(s, value, base, count, directions, t) {
    const mask = (count >= 32 ? 0xffffffff : ((1 << count) - 1) << base) & 0x3fffffff;
    const old = directions ? this.pinDirections : this.pinValues;
    const now = (old & ~mask) | ((value << base) & mask);
    if (now === old) return;
    if (directions) this.pinDirections = now;
    else this.pinValues = now;
    this.pads.driven(old ^ now, t + PAD);
  }
}
