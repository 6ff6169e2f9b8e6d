"""The package itself: its version, and the folder that it is in. Any room may import this module; it imports none."""

from __future__ import annotations

from pathlib import Path

VERSION = "0.2.0"
FOLDER = Path(__file__).parents[1]
