"""Compiles the C library of the motor's physics (firmware/motor) with the C compiler of this machine.

It imports nothing of rig: the hook that builds a wheel (firmware/wheel_hook.py) loads this file by its path.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

NAME = {"win32": "rig_motor.dll", "darwin": "librig_motor.dylib"}.get(sys.platform, "librig_motor.so")
SOURCES = (
    "plain_motor.c",
    "real_readings.c",
    "records.c",
    "coloured_noise.c",
    "steady_cycle.c",
    "windows.c",
)
# No contraction into fused operations, so that a motor moves the same on any machine.
OPTIONS = ("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-shared")
NO_COMPILER = (
    "the motor's physics is compiled once on this machine, and there is no C compiler: install one "
    "(Debian: apt-get install gcc libc6-dev), name it in CC, or `pip install ziglang`"
)


class CompileError(RuntimeError):
    """The library cannot be compiled; the message says what to do."""


def sources_in(folder: Path) -> list[Path]:
    """The files of the library in ``firmware/motor``."""
    return [folder / name for name in SOURCES]


def compiler() -> list[str]:
    """Command of a C compiler: CC, cc, gcc, clang, or the one that the package ziglang brings. [] without one."""
    for command in (shlex.split(os.environ.get("CC", "")), ["cc"], ["gcc"], ["clang"]):
        if command and shutil.which(command[0]):
            return command
    return [sys.executable, "-P", "-m", "ziglang", "cc"] if importlib.util.find_spec("ziglang") else []


def compiled(sources: Sequence[Path], folder: Path) -> Path:
    """The library of C files in ``folder``, compiled where there is none of just these C files, headers and options.

    Its name tells of what it is. By the times of files nobody could: a copy keeps them, and so an old library stayed.
    Raises CompileError.
    """
    digest = hashlib.sha256(repr((platform.machine(), OPTIONS, [source.name for source in sources])).encode())
    read = {*sources, *(file for source in sources for file in source.parent.glob("*.[ch]"))}
    for path in sorted(read):
        digest.update(path.name.encode() + path.read_bytes())
    name = Path(NAME)
    target = folder / f"{name.stem}-{digest.hexdigest()[:16]}{name.suffix}"
    if not target.is_file():
        compile_library(sources, target)
    return target


def compile_library(sources: Sequence[Path], target: Path, command: Sequence[str] = ()) -> None:
    """Compile C files to the library ``target``, in one move: who loads it meanwhile gets the old one or the new one.

    command  of a compiler, for another machine maybe; default: of this one's
    Raises CompileError without a compiler, or with what it says.
    """
    command = command or compiler()
    if not command:
        raise CompileError(NO_COMPILER)
    system = [] if target.suffix == ".dll" else ["-fPIC"]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent) as folder:
            made = Path(folder) / target.name
            line = [*command, *OPTIONS, *system, "-o", str(made), *map(str, sources), "-lm"]
            done = subprocess.run(line, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                raise CompileError(f"compiling the motor's physics failed: `{shlex.join(line)}`\n{done.stderr.strip()}")
            made.replace(target)
    except OSError as error:
        raise CompileError(f"the motor's physics cannot be compiled into {target.parent}: {error}") from error
