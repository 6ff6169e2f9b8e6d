#!/bin/sh
# Brings uPlot, which draws the panel's curves, to where the panel serves it from, with its license; a wheel that is
# built from here carries it. Needs npm.
set -eu
cd "$(dirname "$0")/.."
command -v npm >/dev/null 2>&1 || {
    echo "uplot: npm is missing, which fetches uPlot: install it (Debian: apt-get install npm)" >&2
    exit 1
}
folder=tools/uplot
# npm keeps its own stamp of what it has installed
[ "$folder/node_modules/.package-lock.json" -nt "$folder/package-lock.json" ] ||
    (cd "$folder" && npm ci --loglevel=error >/dev/null)
uplot=$folder/node_modules/uplot vendor=rig/panel/static/vendor
mkdir -p "$vendor"
cp "$uplot/dist/uPlot.esm.js" "$uplot/dist/uPlot.min.css" "$vendor/"
cp "$uplot/LICENSE" "$vendor/uPlot-LICENSE"
