#!/usr/bin/env bash
# report.sh REPORT.html: the report in a real browser. Installs Chromium and Node's packages.
set -euo pipefail
report=$(realpath "$1")
cd "$(dirname "$0")/.."

need=()
command -v chromium >/dev/null || need+=(chromium)
command -v npm >/dev/null || need+=(nodejs npm)
if [ ${#need[@]} -gt 0 ]; then
    apt-get -qq -o DPkg::Lock::Timeout=300 update
    apt-get -qq -o DPkg::Lock::Timeout=300 install -y --no-install-recommends "${need[@]}" >/dev/null
fi

# The committed bundle is what its source gives.
(cd host/report-viewer && npm ci --silent --no-audit --no-fund && npm run --silent build 2>/dev/null)
git diff --exit-code --stat -- host/src/report/viewer.min.js

cd tests/browser
npm ci --silent --no-audit --no-fund
node check.mjs "$report" ../../target/report-check
