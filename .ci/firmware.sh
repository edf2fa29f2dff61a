#!/usr/bin/env bash
# Builds the motion board's binary for the RP2040 and says how much flash and RAM it takes.
# Uses rustup's thumb target where there is one, else the toolchain of ../shared/tools, else says so.
set -euo pipefail
cd "$(dirname "$0")/.."
target=thumbv6m-none-eabi
cargo=cargo
if rustup target list --installed 2>/dev/null | grep -qx "$target"; then
  :
elif [ -x ../shared/tools/install-thumb.sh ]; then
  ../shared/tools/install-thumb.sh
  eval "$(../shared/tools/install-thumb.sh env)"
  cargo=$THUMB_CARGO
else
  echo "skipped:no-$target"
  [ "${CANNULA_REQUIRE_EMULATOR:-0}" = 1 ] && exit 1
  exit 0
fi
export CARGO_TARGET_DIR=$PWD/target/thumb
"$cargo" build --locked -p cannula-firmware --features rp2040 --target "$target" --profile firmware
elf=$CARGO_TARGET_DIR/$target/firmware/motion-board
# Sections with what they take of flash (load image) and RAM; the ring buffers are in .bss.
node - "$elf" <<'JS'
const b = require('fs').readFileSync(process.argv[2]);
const u32 = (o) => b.readUInt32LE(o), u16 = (o) => b.readUInt16LE(o);
let flash = 0, ram = 0;
for (let i = 0, o = u32(32); i < u16(48); i++, o += u16(46)) {
  const type = u32(o + 4), flags = u32(o + 8), address = u32(o + 12), size = u32(o + 20);
  if (!(flags & 2)) continue; // not in memory at run time
  if (type !== 8) flash += size; // in the image, .data too
  if (address >= 0x20000000 && address < 0x21000000) ram += size;
}
const kib = (n) => (n / 1024).toFixed(1) + ' KiB';
console.log(`firmware: flash ${flash} bytes (${kib(flash)} of 2048), RAM ${ram} bytes (${kib(ram)} of 264), the rest of RAM is stack`);
if (flash > 1024 * 1024 || ram > 200 * 1024) { console.error('firmware: too large'); process.exit(1); }
JS
