#!/usr/bin/env bash
# report.sh REPORT.html [PAGE.html …]: the report, and other pages, in a real browser. Needs Chromium, node
# and npm.
set -euo pipefail
report=$(realpath "$1")
shift
others=()
for page in "$@"; do others+=("$(realpath "$page")"); done
cd "$(dirname "$0")/.."

# The committed bundle is what its source gives.
(cd host/report-viewer && npm ci --silent --no-audit --no-fund && npm run --silent build 2>/dev/null)
git diff --exit-code --stat -- host/src/report/viewer.min.js

cd tests/browser
npm ci --silent --no-audit --no-fund
node check.mjs "$report" ../../target/report-check "${others[@]}"
