#!/bin/sh
# Sets up .venv. Run by make; does nothing where all is there.
#   tools/setup.sh running   rig and what it runs on, without root: needs Python, a C compiler and a network
#   tools/setup.sh           all that tests, checks and documents need, too; Debian packages by sudo
set -eu
cd "$(dirname "$0")/.."
COMPILER=${CC:-cc}
for_all=true
[ "${1:-}" != running ] || for_all=false

fail() {
    echo "setup: $1" >&2
    exit 1
}
fetch() { # fetch COMMAND...: one that needs a network; of what it complains the last line is shown
    complaint=$("$@" 2>&1 >/dev/null) || fail "the Python packages could not be fetched. Is there a network? $(
        echo "$complaint" | grep -v '^ *$' | tail -n 1)"
}
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
python_can() { "$PYTHON" -c "$1" >/dev/null 2>&1; }
venv='import ensurepip, venv' # Debian splits them from Python
new='import sys; sys.exit(sys.version_info < (3, 11))'

# The system's, if it will do: it is built with a profile. What pyenv builds as it is takes up to 1.4 times as long.
given=${PYTHON:-}
PYTHON=${given:-/usr/bin/python3}
[ -n "$given" ] || python_can "$new; $venv" || PYTHON=python3
python_can "$new" || fail \
    "rig needs Python 3.11 or newer, and $PYTHON is $("$PYTHON" --version 2>/dev/null || echo missing): install one, or name it: make PYTHON=/path/to/python3.11 ..."
if $for_all; then
    python_can "$venv" || need no-such-command python3-venv
    need cc gcc
    need /usr/include/stdio.h libc6-dev
    install_missing
fi
python_can "$venv" || fail \
    "$PYTHON has no module venv, which makes the environment that rig is installed into: install it (Debian: sudo apt-get install python3-venv)"
# shellcheck disable=SC2086  # a compiler may come with options
echo '#include <stdio.h>' | $COMPILER -E - >/dev/null 2>&1 || fail \
    "no C compiler that works: $COMPILER compiles the firmware of the emulated board. Install one (Debian: sudo apt-get install gcc libc6-dev)"

if $for_all; then
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
fi
# the second emulator of the Uno's chip, the Pico's, what drives the browser; npm keeps its own stamp of what it has
# installed
of_node() {
    for folder in tests/hil/avr8js firmware/emulator/pico tests/panel/browser; do
        [ "$folder/node_modules/.package-lock.json" -nt "$folder/package-lock.json" ] ||
            (cd "$folder" && npm ci --loglevel=error >/dev/null)
    done
    tools/uplot.sh
}
# while these are fetched and unpacked, so are the Python packages
{ install_missing && if $for_all; then of_node; fi; } &
others=$!

echo "setup: installing Python packages into .venv; the first time that takes a minute, or some on a slow network"
[ -x .venv/bin/python ] && [ -x .venv/bin/uv ] || {
    "$PYTHON" -m venv .venv
    fetch .venv/bin/python -m pip install -qq --disable-pip-version-check --no-compile --only-binary :all: "uv>=0.5,<1"
}
# the emulated board, for this machine; an outer make's job server and flags are none of this build's business
env -u MAKEFLAGS -u MFLAGS -u MAKELEVEL make -s -C firmware host CC="$COMPILER" &
board=$!
export VIRTUAL_ENV=.venv
# exactly the locked packages, by hash; uv itself stays
if $for_all; then
    fetch .venv/bin/uv pip install --require-hashes -r requirements.lock
else
    fetch .venv/bin/uv pip install --require-hashes --constraints requirements.lock -r pyproject.toml
fi
wait "$others"
fetch .venv/bin/uv pip install --no-deps --editable .
wait "$board"

# the motor's physics, for this machine; what a run loads is compiled to bytecode, of the packages a fifth. Where tests
# follow, `make compiled` does that
loaded=rig.model.library
$for_all ||
    loaded="$loaded, rig.cli, rig.api, rig.output.report.page, matplotlib.backends.backend_svg, scipy.optimize, scipy.stats"
env -u PYTHONDONTWRITEBYTECODE CC="$COMPILER" .venv/bin/python -c "import $loaded"
touch .venv/.running
if $for_all; then touch .venv/.ready; fi
