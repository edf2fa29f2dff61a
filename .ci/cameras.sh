#!/usr/bin/env bash
# Industrial and bench cameras: installs what the features aravis and v4l need (Debian), checks both
# builds, and tests GenICam against the fake GigE camera over the loopback.
set -euo pipefail
cd "$(dirname "$0")/.."

need=()
for package in pkg-config libaravis-dev aravis-tools libusb-1.0-0-dev libclang-dev; do
    dpkg -s "$package" >/dev/null 2>&1 || need+=("$package")
done
if [ ${#need[@]} -gt 0 ]; then
    export DEBIAN_FRONTEND=noninteractive
    apt-get -qq -o DPkg::Lock::Timeout=300 update
    apt-get -qq -o DPkg::Lock::Timeout=300 install -y --no-install-recommends "${need[@]}" >/dev/null
fi

cargo clippy -q -p cannula --features aravis,v4l --all-targets -- -D warnings
cargo test -q -p cannula --features v4l --lib rig::uvc
cargo test -q -p cannula-tests --features aravis --test rig_genicam
