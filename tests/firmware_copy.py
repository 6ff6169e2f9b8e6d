"""The firmware's sources: what make says of them, and a copy to put a defect in."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from rig.backends.serial.emulated.firmware_build import source_folder


def copied_firmware(folder: Path) -> Path:
    """That folder, which is new; what npm has installed there stays out."""
    return shutil.copytree(source_folder(), folder, ignore=shutil.ignore_patterns("node_modules"))


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """What `make` there has said, apart from a make that runs these tests."""
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "-s", "-C", str(folder), *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
