"""A copy of the firmware's sources, to put a defect in."""

from __future__ import annotations

import shutil
from pathlib import Path

from rig.backends.serial.emulated.firmware_build import source_folder


def copied_firmware(folder: Path) -> Path:
    """That folder, which is new; what npm has installed there stays out."""
    return shutil.copytree(source_folder(), folder, ignore=shutil.ignore_patterns("node_modules"))
