"""Builds the emulated board from the firmware's sources with the machine's own compiler."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import rig

_PACKAGE = Path(rig.__file__).parent


class EmulationError(Exception):
    """The emulated board could not be built or started; the text says why and what to do."""


class HostFirmware(NamedTuple):
    """What the build gives: the program of the process, and the shared library for virtual time."""

    program: Path
    library: Path


def source_folder() -> Path:
    """Folder of the firmware's sources: in the repository, else as packaged with rig.

    Raises EmulationError if neither is there.
    """
    candidates = (_PACKAGE.parent / "firmware", _PACKAGE / "_firmware")
    for folder in candidates:
        if (folder / "Makefile").is_file() and (folder / "core" / "rig_core.c").is_file():
            return folder
    raise EmulationError(f"no firmware sources in {candidates[0]} or {candidates[1]}: install rig again")


def build(build_folder: Path | None = None) -> HostFirmware:
    """Build what is not up to date. Processes that build at the same time wait for each other.

    build_folder  where to; default: ``build/firmware`` in the repository, a folder of the user's cache for an
                  installed rig
    Raises EmulationError if make or the C compiler is missing, or the build fails.
    """
    sources = source_folder()
    folder = (_default_build_folder(sources) if build_folder is None else build_folder).absolute()
    compiler = os.environ.get("CC", "cc")
    for tool in ("make", compiler.split()[0]):
        if shutil.which(tool) is None:
            raise EmulationError(
                f"the emulated board is compiled on this machine, and `{tool}` is missing: install make and a C "
                "compiler (Debian: apt-get install make gcc libc6-dev)"
            )
    # an outer make's job server and flags are none of this build's business
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "-s", "-C", str(sources), "host", f"BUILD={folder}", f"CC={compiler}"]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / ".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            made = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    except OSError as error:
        raise EmulationError(f"the firmware cannot be built in {folder}: {error}") from error
    if made.returncode != 0:
        raise EmulationError(f"building the emulated board failed: `{' '.join(command)}`\n{made.stderr.strip()}")
    return HostFirmware(folder / "host" / "rig_host_board", folder / "host" / "librig_host.so")


def _default_build_folder(sources: Path) -> Path:
    if sources.parent != _PACKAGE:
        return sources.parent / "build" / "firmware"
    # Installed files carry no useful times, and their folder may not be writable: one folder for each content.
    digest = hashlib.sha256()
    for path in sorted(sources.rglob("*")):
        if path.is_file():
            digest.update(path.relative_to(sources).as_posix().encode() + b"\0" + path.read_bytes())
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "rig" / f"firmware-{digest.hexdigest()[:16]}"
