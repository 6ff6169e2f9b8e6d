"""A ready config with a wanted limit cycle, where its tests end when the motor is known: for tests of the search."""

from __future__ import annotations

import re
from pathlib import Path

CONFIGS = Path(__file__).parents[1] / "config"


def wanted_cycle(name: str) -> str:
    """The text of ``config/name`` with a target."""
    text = (CONFIGS / name).read_text(encoding="utf-8")
    changed = re.sub(r"  until: .*\n", "  target: {amplitude_rad: 0.5, period_s: 1.0}\n  cycles: 12\n", text)
    assert changed != text, f"{name} has no relay.until"
    return changed
