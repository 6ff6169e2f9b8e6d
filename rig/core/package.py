"""The package itself: its version, its folder, its C sources. Any room may import this module; it imports none."""

from __future__ import annotations

from pathlib import Path

VERSION = "0.2.0"
FOLDER = Path(__file__).parents[1]


def firmware_folders(package: Path = FOLDER) -> tuple[Path, Path]:
    """Where the firmware's sources may be: in the repository around the package, else as packaged in it."""
    return package.parent / "firmware", package / "_firmware"
