// As much of ELF32 as a firmware image needs: loadable segments and symbols.
import { readFileSync } from 'node:fs';

export function parseElf(file) {
  const b = readFileSync(file);
  const u32 = (o) => b.readUInt32LE(o), u16 = (o) => b.readUInt16LE(o);
  if (b.toString('latin1', 1, 4) !== 'ELF' || b[4] !== 1 || u16(18) !== 40) throw new Error(`${file} is no 32-bit ARM ELF`);
  const segments = [], symbols = new Map();
  for (let i = 0, o = u32(28); i < u16(44); i++, o += u16(42)) {
    if (u32(o) === 1 && u32(o + 16)) segments.push({ address: u32(o + 12), data: b.subarray(u32(o + 4), u32(o + 4) + u32(o + 16)) });
  }
  const sections = [];
  for (let i = 0, o = u32(32); i < u16(48); i++, o += u16(46)) sections.push({ type: u32(o + 4), offset: u32(o + 16), size: u32(o + 20), link: u32(o + 24) });
  for (const s of sections.filter((s) => s.type === 2)) {
    for (let o = s.offset; o < s.offset + s.size; o += 16) {
      const name = sections[s.link].offset + u32(o);
      symbols.set(b.toString('latin1', name, b.indexOf(0, name)), u32(o + 4));
    }
  }
  return { segments, symbols };
}
