"""A drive that has to be promised anew all the time: how it ends."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rig.control.leased_jog import LeasedDrive
from rig.core.signals import Sample


@pytest.mark.parametrize(
    ("promised", "ends_s"),
    [
        (lambda t_s: 0.5, 4.0),
        (lambda t_s: 0.5 if t_s < 1.0 else 0.0, 3.0),
        (lambda t_s: 0.5 if t_s < 1.0 else None, 1.0),
    ],
)
def test_a_jog_by_leases_ends_at_its_time_when_idle_or_when_told(
    promised: Callable[[float], float | None], ends_s: float
) -> None:
    now_s = 0.0
    changes: list[float | None] = []
    law = LeasedDrive(lambda: promised(now_s), changes.append, longest_s=4.0, idle_s=2.0)
    drives = []
    while not law.finished:
        drives.append(law.step(Sample(now_s, 0.0, 512)))
        now_s += 0.25
    assert now_s - 0.25 == ends_s
    assert drives[0] == 0.5 and drives[-1] == 0.0
    assert changes == ([0.5] if ends_s == 4.0 else [0.5, promised(now_s)])
