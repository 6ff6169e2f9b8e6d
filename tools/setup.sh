#!/bin/sh
# Sets up .venv with the locked packages and rig itself. Run by make; does nothing where all is there.
set -eu
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}

missing=""
need() { # need COMMAND-OR-FILE PACKAGE...: Debian packages to install where a command or a file is missing
    command -v "$1" >/dev/null 2>&1 || [ -e "$1" ] && return
    echo "setup: $1 is missing; installing the Debian package $2"
    missing="$missing $2"
}
install_missing() { # of what Debian recommends with these nothing is needed
    [ -n "$missing" ] || return 0
    as_root=""
    [ "$(id -u)" = 0 ] || as_root="sudo"
    # shellcheck disable=SC2086  # one word a package
    $as_root apt-get update -qq && $as_root env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends $missing >/dev/null
    missing=""
}

if ! "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
    echo "setup: $PYTHON is older than 3.11; set PYTHON=/path/to/python3.11 or newer" >&2
    exit 1
fi
# Debian splits venv from Python
"$PYTHON" -c 'import ensurepip, venv' 2>/dev/null || need no-such-command python3-venv
install_missing

need cc gcc
need /usr/include/stdio.h libc6-dev
need make make
# the Uno's firmware, and the chip that tests run it on
need avr-gcc gcc-avr
need avr-objcopy binutils-avr
need /usr/lib/avr/include/avr/io.h avr-libc
need /usr/include/simavr/sim_avr.h libsimavr-dev
# static analysis and fuzzing of the firmware
need cppcheck cppcheck
need clang clang
need "$(clang -print-resource-dir 2>/dev/null)/lib/linux/libclang_rt.fuzzer-$(uname -m).a" libclang-rt-dev
# a Modbus master and a slave that are not ours
need mbpoll mbpoll
need /usr/include/modbus/modbus.h libmodbus-dev
# peer of the wake-up benchmark
need cyclictest rt-tests
# the Pico's firmware and the emulators that run on node
need arm-none-eabi-gcc gcc-arm-none-eabi
need node nodejs
need npm npm
# a browser, for the test of the panel's page
need chromium chromium
# loads what is exported for MATLAB
need octave-cli octave
# while these are fetched and unpacked, so are the Python packages
install_missing &
debian=$!

[ -x .venv/bin/python ] || "$PYTHON" -m venv .venv
[ -x .venv/bin/uv ] || .venv/bin/python -m pip install --quiet --disable-pip-version-check "uv>=0.5,<1"
# exactly the locked packages, by hash; uv itself stays
VIRTUAL_ENV=.venv .venv/bin/uv pip install --quiet --compile-bytecode --require-hashes -r requirements.lock
wait "$debian"
VIRTUAL_ENV=.venv .venv/bin/uv pip install --quiet --no-deps --editable .
# so that no first run waits for it
.venv/bin/python -m rig.experiment.ready &
compiled=$!
# the second emulator of the Uno's chip, the Pico's, what drives the browser; npm keeps its own stamp of what it has
# installed
for folder in tests/hil/avr8js firmware/emulator/pico tests/panel/browser; do
    [ "$folder/node_modules/.package-lock.json" -nt "$folder/package-lock.json" ] ||
        (cd "$folder" && npm ci --loglevel=error >/dev/null)
done
tools/uplot.sh
wait "$compiled"
touch .venv/.ready
