#!/usr/bin/env bash
# hard.sh DIR: a hard recording (blur, noise, strong speckle, hair, wet spots) end to end: errors against its
# truth within limits (the worst of the README's hard recordings, and half as much again) and within 4 σ as stated.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet -p cannula
./target/release/cannula simulate --session "$1/session" --profile hard --seed 1 --quiet
./target/release/cannula process "$1/session" --out "$1/out" --needle-angle 30 --quiet
node - "$1/out/result.json" "$1/session/truth.json" <<'JS'
const [result, truth] = process.argv.slice(2).map((f) => JSON.parse(require("fs").readFileSync(f)));
const less = (a, b) => a.map((x, i) => x - b[i]);
const degrees = (a, b) => (2 * Math.asin(Math.hypot(...less(a, b)) / 2) * 180) / Math.PI;
const [n, v] = [truth.plane.normal, truth.vein.direction];
const axis = v.map((x, i) => x * Math.cos(Math.PI / 6) + n[i] / 2);
let bad = 0;
const check = (what, error, limit, sigma, unit) => {
    const good = error <= limit && error <= 4 * sigma; // false for what is no number, too
    if (!good) bad += 1;
    console.log(`${good ? "within" : "BEYOND"}  ${what}: ${error.toFixed(4)} ${unit}, limit ${limit}, stated σ ${sigma}`);
};
check("plane, normal", degrees(result.plane.normal, n), 0.183, result.plane.normal_sigma_deg, "°");
check("needle, axis", degrees(result.needle.axis, axis), 0.285, result.needle.axis_sigma_deg, "°");
const entry = Math.hypot(...less(result.entry.point_mm, truth.entry.point_mm));
check("entry point", entry, 0.245, result.entry.sigma_mm, "mm");
process.exit(bad ? 1 : 0);
JS
