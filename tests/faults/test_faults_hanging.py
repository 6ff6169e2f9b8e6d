"""A law that hangs, in real time: the drive of the device's own trace, and whether the run is read afterwards.

The bound is longer by what this machine was late in that run: device, loop, law and keeper.
"""

from __future__ import annotations

import pytest
from evidence import evidence

from faults import realtime
from faults.realtime import DEVICES, KILLED_LAW, NO_WATCHDOG, REAL_ROWS, RealDevice

pytestmark = [pytest.mark.realtime, pytest.mark.long]


@pytest.mark.parametrize(
    ("name", "device"),
    [
        ("law hangs in C, SIGINT twice", NO_WATCHDOG),
        *evidence(
            ("law hangs in C", DEVICES[0]),
            ("law hangs", NO_WATCHDOG),
            ("law sleeps", NO_WATCHDOG),
            ("law hangs, SIGTERM", NO_WATCHDOG),
            (KILLED_LAW.name, NO_WATCHDOG),
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else value.backend.key,
)
def test_a_law_that_hangs_leaves_no_drive(name: str, device: RealDevice) -> None:
    [row] = [row for row in (*REAL_ROWS, KILLED_LAW) if row.name == name]
    found = realtime.measure(row, device, 0.0)
    assert found.trouble == ()
