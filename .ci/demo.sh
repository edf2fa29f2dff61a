#!/usr/bin/env bash
# demo.sh DIR: the README's demo, and whether it keeps its word: at most 60 s, errors against the truth of its
# scene within limits (the worst of the README's nominal recordings, and half as much again).
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet -p cannula
./target/release/cannula demo --seed 1 --out "$1"
node - "$1/errors.json" <<'JS'
const said = JSON.parse(require("fs").readFileSync(process.argv[2]));
const limits = {
    "light planes, mean over the volume": [0.045, "mm"],
    "plane, normal": [0.054, "deg"],
    "needle, axis": [0.117, "deg"],
    "entry point": [0.126, "mm"],
};
let bad = 0;
const check = (what, value, limit, unit) => {
    const good = value <= limit; // false for what is no number, too
    if (!good) bad += 1;
    console.log(`${good ? "within" : "BEYOND"}  ${what}: ${value} ${unit}, limit ${limit}`);
};
for (const [quantity, [limit, unit]] of Object.entries(limits)) {
    const row = said.errors.find((e) => e.quantity === quantity) ?? {};
    check(quantity, row.unit === unit ? row.error : NaN, limit, unit);
}
check("time", said.seconds, 60, "s");
process.exit(bad ? 1 : 0);
JS
