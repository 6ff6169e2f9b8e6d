"""Write the firmware to a Raspberry Pi Pico: find its drive, copy the .uf2 to it, explain what is in the way.

While its button BOOTSEL is held as it gets power, a Pico is a USB drive. Its own boot program, which nothing can erase,
writes a .uf2 that is copied there to the flash, and starts it.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable
from pathlib import Path

from rig.backends.serial.flash import FlashError

LABEL = "RPI-RP2"
BOOTSEL = (
    f"unplug it, hold its button BOOTSEL, plug it in, then let go: a drive {LABEL} appears. Where no desktop mounts "
    f"it: `udisksctl mount -b /dev/disk/by-label/{LABEL}`; or name its folder: --drive FOLDER"
)
AT_REST = {
    "pwm-dir": "PWM (GP16) must be at 0 V",
    "in1-in2": "IN1 (GP16) and IN2 (GP17) must be at 3.3 V; with a bridge that has PWM and DIR inputs this is full "
    "drive",
}
_BLOCK = 512
_UF2 = struct.pack("<II", 0x0A324655, 0x9E5D5157)  # a block of such a file begins so
_RP2040 = struct.pack("<I", 0xE48BFF56)  # and has its chip's number here
_CHIP = slice(28, 32)
_ABOUT = "INFO_UF2.TXT"  # on the drive of every board that takes .uf2 files
_OURS = "leave --uf2 out: then rig builds it"
_MOUNTS = Path("/proc/mounts")
_RESTART_S = 10.0
_POLL_S = 0.1


def _about(folder: Path) -> str | None:
    """What the drive says of its board; None where it is no such drive."""
    try:
        return (folder / _ABOUT).read_text(encoding="ascii", errors="replace")
    except OSError:
        return None


def mounted(mounts: Path = _MOUNTS) -> list[Path]:
    """The folders of this machine's mounted drives that are a Pico in BOOTSEL mode."""
    try:
        lines = mounts.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    # in this file a space in a name is \040
    folders = [Path(line.split()[1].replace("\\040", " ")) for line in lines if line.startswith("/dev/")]
    return [folder for folder in folders if LABEL in (_about(folder) or "")]


def find_drive(given: Path | None, mounts: Path = _MOUNTS) -> Path:
    """The drive to copy to: the one given, else the only one there is.

    Raises FlashError where there is none, more than one, or another board's.
    """
    if given is None:
        found = mounted(mounts)
        if not found:
            raise FlashError("no Pico is there as a drive", BOOTSEL)
        if len(found) > 1:
            raise FlashError(f"several Picos: {', '.join(map(str, found))}", "name one: --drive FOLDER")
        return found[0]
    about = _about(given)
    if about is None:
        raise FlashError(f"{given} is no drive of a Pico: it has no {_ABOUT}", BOOTSEL)
    if LABEL not in about:
        words = next((line for line in about.splitlines() if line.startswith("Board-ID")), "another board")
        raise FlashError(
            f"the board at {given} is no Pico with an RP2040 ({words})", "a Pico 2 has another chip: use a Pico"
        )
    return given


def copy(uf2: Path, drive: Path, show: Callable[[str], None]) -> None:
    """Copy the .uf2 to the drive, and wait until the board has taken it: then it restarts, and the drive is gone.

    Raises FlashError where it cannot be read or written, or the board does not take it.
    """
    try:
        program = uf2.read_bytes()
    except OSError as error:
        raise FlashError(f"{uf2} cannot be read: {error.strerror}", _OURS) from error
    blocks = [program[at : at + _BLOCK] for at in range(0, len(program), _BLOCK)]
    if not blocks or any(b[:8] != _UF2 or b[_CHIP] != _RP2040 or len(b) != _BLOCK for b in blocks):
        raise FlashError(f"{uf2} is no .uf2 for the RP2040 of a Pico, or is not whole", _OURS)
    try:
        with (drive / uf2.name).open("wb") as file:
            file.write(program)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        if _about(drive) is not None:  # else the board has restarted already, in the middle of closing the file
            raise FlashError(
                f"{drive} cannot be written: {error.strerror}", "unplug the board and begin again with BOOTSEL held"
            ) from error
    show("copied; waiting for the board to restart ...")
    until_s = time.monotonic() + _RESTART_S
    while _about(drive) is not None:
        if time.monotonic() > until_s:
            raise FlashError(
                f"the board has not taken the file: {drive} is still there after {_RESTART_S:g} s",
                "try another cable or USB port",
            )
        time.sleep(_POLL_S)
