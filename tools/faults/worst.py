"""The worst that was recorded of each row, on each device, in each stage: docs/evidence/fault-worst.json.

Bounds follow from the config, and are wide where a design needs it; what takes half as long again as it ever did is a
change that somebody should look at.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from faults.case import Found
from rig.run_folder.recording.folder import write_whole

PLACE = Path(__file__).resolve().parents[2] / "docs" / "evidence" / "fault-worst.json"
LONGER = 1.5
GRAIN_S = 0.001  # of what is measured, about: a tick of the device


class Longer(UserWarning):
    """A drive that was on for longer than was ever recorded."""


def key(found: Found) -> str:
    """Row, device and stage."""
    return f"{found.row} | {found.backend} | {found.stage}"


def worst_s(found: Iterable[Found]) -> dict[str, float]:
    """The longest time that the drive was on, by ``key``, s."""
    worst: dict[str, float] = {}
    for one in found:
        worst[key(one)] = max(worst.get(key(one), 0.0), one.off_s)
    return worst


def recorded(path: Path = PLACE) -> dict[str, float]:
    """What was recorded, s; nothing where there is no file."""
    if not path.exists():
        return {}
    recorded_ms: Mapping[str, float] = json.loads(path.read_text(encoding="utf-8"))
    return {name: 1e-3 * ms for name, ms in recorded_ms.items()}


def is_longer(now_s: float, before_s: float) -> bool:
    """Whether the drive was on for ``LONGER`` times what was recorded, and at least a tick more."""
    return now_s > max(LONGER * before_s, before_s + GRAIN_S)


def longer(found: Iterable[Found], before_s: Mapping[str, float]) -> list[str]:
    """One line for each of which that is so."""
    return [
        f"{name}: drive on for {1e3 * now_s:.1f} ms; recorded are {1e3 * before_s[name]:.1f} ms at most"
        for name, now_s in worst_s(found).items()
        if name in before_s and is_longer(now_s, before_s[name])
    ]


def write(found: Iterable[Found], before_s: Mapping[str, float], path: Path = PLACE, *, others: bool = False) -> None:
    """Record these, and no others; what is longer than before stays as it was, so that it is said again.

    others  those recorded before stay, too: of a part of the matrix
    """
    new_s = {
        name: before_s[name] if name in before_s and is_longer(now_s, before_s[name]) else now_s
        for name, now_s in worst_s(found).items()
    }
    if others:
        new_s = recorded(path) | new_s
    in_ms = {name: round(1e3 * s, 2) for name, s in sorted(new_s.items())}
    write_whole(path, (json.dumps(in_ms, indent=0) + "\n").encode("ascii"))
