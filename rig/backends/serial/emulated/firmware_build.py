"""Builds the firmware from its sources, for the emulated board, the Uno and the Pico, each with its own compiler.

A build that takes longer than ``SAY_AFTER_S`` says so, on a terminal and in the file that the panel reads.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from rig.backends.emulated.errors import EmulationError
from rig.core.package import FOLDER, firmware_folders

GOES_ON: Final = "rig: building {0}, once after an installation or a change of its sources: {1:.0f} s so far"
SAY_AFTER_S, SAY_EVERY_S = 2.0, 5.0

_BUILT: Final = {
    "host": "the emulated board's firmware",
    "uno": "the Uno's firmware",
    "chip": "the Uno's firmware and its emulated chip",
    "pico": "the Pico's firmware",
    "pico-chip": "the Pico's firmware and its emulated chip",
}
_PACKAGE = FOLDER
_TOOLS = str(FOLDER.parent / "tools")  # of the repository: emulated_chips is there
AVR_PACKAGES = "gcc-avr avr-libc binutils-avr"
_NO_HEADER: Final = {  # what the compiler says: a library that Debian packs apart from what needs it
    "avr/io.h: No such file": f"avr-gcc has no C library: install it (Debian: apt-get install {AVR_PACKAGES})",
    "error: simavr/": "the emulated chip lacks simavr: install it (Debian: apt-get install libsimavr-dev)",
}
_EMULATORS: Final = (  # ports that begin with, what is emulated there, a source of it
    ("emulated-chip", "chip", "emulator/chip.c"),
    ("emulated-pico", "Pico", "emulator/pico/chip.js"),
)
PICO_TOOLS = {"arm-none-eabi-gcc": "apt-get install gcc-arm-none-eabi"}


class Variant(NamedTuple):
    """What a board's firmware is built with (firmware/boards/variant.mk); the defaults are the plain ``rig_uno.hex``.

    bridge  "PWM_DIR" or "IN1_IN2"
    baud    115200 or 1000000
    tachometer, supply, end_switches  whether they are wired
    encoder  instead of the potentiometer
    """

    bridge: str = "PWM_DIR"
    baud: int = 115200
    tachometer: bool = False
    supply: bool = False
    end_switches: bool = False
    encoder: bool = False

    @property
    def name(self) -> str:
        """Of the Uno's file, without its ending."""
        return self.name_for("uno")

    def name_for(self, board: str) -> str:
        """Of the file for a board, "uno" or "pico", without its ending."""
        parts = [f"rig_{board}"]
        if self.bridge != "PWM_DIR":
            parts.append(self.bridge.lower())
        if self.baud != 115200:
            parts.append(str(self.baud))
        words = {
            "tachometer": self.tachometer,
            "supply": self.supply,
            "ends": self.end_switches,
            "encoder": self.encoder,
        }
        return "-".join(parts + [word for word, wired in words.items() if wired])

    def variables(self) -> list[str]:
        """For make."""
        flags = f"TACHOMETER={self.tachometer:d}", f"SUPPLY={self.supply:d}", f"END_SWITCHES={self.end_switches:d}"
        return [f"BRIDGE={self.bridge}", f"BAUD={self.baud}", *flags, f"ENCODER={self.encoder:d}"]


PLAIN_VARIANT = Variant()


def source_folder() -> Path:
    """Folder of the firmware's sources: in the repository, else as packaged with rig.

    Raises EmulationError if neither is there.
    """
    candidates = firmware_folders(_PACKAGE)
    for folder in candidates:
        if (folder / "Makefile").is_file() and (folder / "core" / "rig_core.c").is_file():
            return folder
    raise EmulationError(f"no firmware sources in {candidates[0]} or {candidates[1]}: install rig again")


def require_emulator(port: str | None) -> None:
    """Make the package ``emulated_chips`` one that can be imported, where ``port`` names an emulated chip.

    Raises EmulationError where this rig has none: what is installed has no chip. A command asks before anything slow.
    """
    for begins, chip, source in _EMULATORS:
        if port is None or not port.startswith(begins):
            continue
        if not (source_folder() / source).is_file():
            raise EmulationError(
                f"the emulated {chip} is in rig's repository only\n"
                "run this command in a clone of it; without one: `rig config copy simulated`"
            )
        if _TOOLS not in sys.path:
            sys.path.append(_TOOLS)


def build(build_folder: Path | None = None) -> Path:
    """Build what of the emulated board's library is not up to date. Processes that build at once wait for each other.

    build_folder  where to; default: ``build/firmware`` in the repository, a folder of the user's cache for an
                  installed rig
    Raises EmulationError if make or the C compiler is missing, or the build fails.
    """
    return make(["host"], {}, build_folder) / "host" / "librig_host.so"


def build_uno(options: Variant = PLAIN_VARIANT) -> Path:
    """Build the Uno's firmware, as ``build`` does; the .hex to flash.

    Raises EmulationError also where avr-gcc or its library is missing.
    """
    folder = make(["uno", *options.variables()], {"avr-gcc": f"apt-get install {AVR_PACKAGES}"})
    return folder / "uno" / f"{options.name}.hex"


def build_pico(options: Variant = PLAIN_VARIANT) -> Path:
    """Build the Pico's firmware, as ``build`` does; the .uf2 to copy.

    Raises EmulationError also where arm-none-eabi-gcc is missing.
    """
    folder = make(["pico", *options.variables()], PICO_TOOLS)
    return folder / "pico" / f"{options.name_for('pico')}.uf2"


def make(targets: list[str], tools: dict[str, str], build_folder: Path | None = None) -> Path:
    """Make the targets, as ``build`` does; the folder that they are in.

    tools  what they need besides a C compiler, and its cure

    Raises EmulationError.
    """
    try:
        import fcntl  # not everywhere
    except ImportError as error:
        raise EmulationError(
            "emulated devices are firmware that is compiled and run here, which takes Linux\n"
            "set daq.driver: simulated, as in config/simulated.yaml: it runs everywhere"
        ) from error
    sources = source_folder()
    folder = (_default_build_folder(sources) if build_folder is None else build_folder).absolute()
    compiler = os.environ.get("CC", "cc")
    cure = "apt-get install make gcc libc6-dev"
    for tool, package in ({"make": cure, compiler.split()[0]: cure} | tools).items():
        if shutil.which(tool) is None:
            raise EmulationError(
                f"the firmware is compiled on this machine, and `{tool}` is missing: install it (Debian: {package})"
            )
    # an outer make's job server and flags are none of this build's business
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "-s", "-C", str(sources), *targets, f"BUILD={_for_make(folder, sources)}", f"CC={compiler}"]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _said(_BUILT[targets[0]]), (folder / ".lock").open("wb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            made = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    except OSError as error:
        raise EmulationError(f"the firmware cannot be built in {folder}: {error}") from error
    for said, words in _NO_HEADER.items():
        if said in made.stderr:
            raise EmulationError(words)
    if made.returncode != 0:
        raise EmulationError(f"building the firmware failed: `{' '.join(command)}`\n{made.stderr.strip()}")
    return folder


@contextmanager
def _said(what: str) -> Iterator[None]:
    """Say every now and then that ``what`` is built, while the block lasts; also while another process builds it."""
    done, began_s = threading.Event(), time.monotonic()

    def speak() -> None:
        wait_s = SAY_AFTER_S
        while not done.wait(wait_s):
            _say(GOES_ON.format(what, time.monotonic() - began_s))
            wait_s = SAY_EVERY_S

    speaker = threading.Thread(target=speak, daemon=True)
    speaker.start()
    try:
        yield
    finally:
        done.set()
        speaker.join()


def _say(words: str) -> None:
    """A line on standard error; not into a pipe, which a program reads."""
    try:
        kind = os.fstat(sys.stderr.fileno()).st_mode
        if sys.stderr.isatty() or stat.S_ISREG(kind):
            sys.stderr.write(f"{words}\n")
            sys.stderr.flush()
    except (OSError, ValueError):  # there is none
        return


def _for_make(folder: Path, sources: Path) -> str:
    """The folder as seen from the sources: no name that make builds may hold a blank, and what is above both may."""
    name = os.path.relpath(folder.resolve(), sources.resolve())
    if any(character in name for character in " \t:#$%;"):
        raise EmulationError(
            f"make cannot build in {folder}: there is a blank, or one of : # $ % ;, in its name\n"
            "in a clone rename the folder; else set XDG_CACHE_HOME to a folder without"
        )
    return name


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
