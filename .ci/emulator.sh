#!/usr/bin/env bash
# The shipped ELF in the emulator, driven over its USB by the host's link: all assertions in cycles.
# Needs node and npm; build the ELF first (.ci/firmware.sh).
set -euo pipefail
cd "$(dirname "$0")/.."
if ! command -v node >/dev/null || ! command -v npm >/dev/null; then
  echo "skipped:no-node"
  [ "${CANNULA_REQUIRE_EMULATOR:-0}" = 1 ] && exit 1
  exit 0
fi
(cd tests/emulator && npm ci --ignore-scripts --no-audit --no-fund)
node --test tests/emulator/*.test.mjs
# Two emulators at a time.
cargo test -p cannula-tests --test emulator -- --test-threads=2 --nocapture
