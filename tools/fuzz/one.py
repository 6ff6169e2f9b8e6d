"""One target under atheris, in a process of its own: python -m fuzz.one TARGET, then options of libFuzzer."""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["rig"]):
    from fuzz.targets import TARGETS


def main() -> None:
    """Feed the target until libFuzzer's options or an error end it."""
    target = TARGETS[sys.argv[1]]
    atheris.Setup([sys.argv[0], *sys.argv[2:]], target.feed)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
