#!/bin/sh
# Sets up .venv with the locked packages and rig itself. Run by make; does nothing where all is there.
set -eu
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}

need() { # need COMMAND PACKAGE: install a Debian package where a command is missing
    command -v "$1" >/dev/null 2>&1 && return
    echo "setup: $1 is missing; installing the Debian package $2"
    as_root=""
    [ "$(id -u)" = 0 ] || as_root="sudo"
    $as_root apt-get update -qq && $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "$2" >/dev/null
}

need cc gcc
need make make
if ! "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
    echo "setup: $PYTHON is older than 3.11; set PYTHON=/path/to/python3.11 or newer" >&2
    exit 1
fi
# Debian splits venv from Python
"$PYTHON" -c 'import ensurepip, venv' 2>/dev/null || need no-such-command python3-venv

[ -x .venv/bin/python ] || "$PYTHON" -m venv .venv
[ -x .venv/bin/uv ] || .venv/bin/python -m pip install --quiet --disable-pip-version-check "uv>=0.5,<1"
# exactly the locked packages, by hash; uv itself stays
VIRTUAL_ENV=.venv .venv/bin/uv pip install --quiet --require-hashes -r requirements.lock
VIRTUAL_ENV=.venv .venv/bin/uv pip install --quiet --no-deps --editable .
touch .venv/.ready
