"""All cases of the matrix, spread over the cores."""

from __future__ import annotations

import gc
import os
from collections.abc import Sequence
from functools import lru_cache

from joblib import Parallel, delayed

from faults import realtime
from faults.backends import BACKENDS, PLAIN, Backend
from faults.case import Found, measure, undisturbed
from faults.page import Line
from faults.realtime import DEVICES, REAL_ROWS, RealFound
from faults.rows import ROWS, Row

PHASES = 4  # of the limit cycle; `make faults` and `make bench` together are to stay below a quarter of an hour
OTHERS_SHARE = 0.25
_BY_KEY = {backend.key: backend for backend in BACKENDS}
_BY_NAME = {row.name: row for row in ROWS}


def in_virtual_time(rows: Sequence[Row], backends: Sequence[Backend], phases: int) -> list[Line]:
    """Each row on each device that it applies to, at so many phases of the limit cycle; fewer on ``OTHERS``."""
    pairs = [(row, backend) for backend in backends for row in rows if row.is_for(backend.traits)]
    cases = [
        (row.name, backend.key, k, phases_on(backend, phases))
        for row, backend in pairs
        for k in range(phases_on(backend, phases))
    ]
    found: list[Found] = Parallel(n_jobs=os.cpu_count() or 1, batch_size=4)(delayed(_virtual)(*case) for case in cases)
    return [
        Line(
            row.on(backend.traits),
            backend,
            undisturbed(backend).times,
            tuple(one for one in found if (one.row, one.backend) == (row.name, backend.key)),
        )
        for row, backend in pairs
    ]


def phases_on(backend: Backend, phases: int) -> int:
    """Of the limit cycle, where the devices of ``PLAIN`` have ``phases``."""
    return phases if backend in PLAIN else max(round(OTHERS_SHARE * phases), 1)


def in_real_time(phases: int) -> list[RealFound]:
    """What may happen to the host's process and its link, at so many phases of the limit cycle.

    Two at a time, they mostly sleep; those that load the machine alone.
    """
    cases = [
        (number, which, k, phases)
        for number, row in enumerate(REAL_ROWS)
        for which, device in enumerate(DEVICES)
        if not row.only or device.key in row.only
        for k in range(phases)
    ]
    together = [case for case in cases if not REAL_ROWS[case[0]].alone]
    found: list[RealFound] = Parallel(n_jobs=2)(delayed(_real)(*case) for case in together)
    return found + [_real(*case) for case in cases if case not in together]


def _virtual(name: str, key: str, k: int, phases: int) -> Found:
    """One case; the first phase also tries the next run."""
    _warm(key)
    return measure(_BY_NAME[name], _BY_KEY[key], (k + 0.5) / phases, restarts=k == 0)


def _real(number: int, which: int, k: int, phases: int) -> RealFound:
    return realtime.measure(REAL_ROWS[number], DEVICES[which], (k + 0.5) / phases, restarts=k == 0)


@lru_cache
def _warm(key: str) -> None:
    """What is loaded by now stays: collecting it before each arming takes 0.15 s for nothing."""
    undisturbed(_BY_KEY[key])
    gc.freeze()
