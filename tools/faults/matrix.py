"""All cases of the matrix, spread over the cores."""

from __future__ import annotations

import gc
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

from faults import realtime, strangers
from faults.backends import (
    BACKENDS,
    BARE,
    BOARD,
    CHIP,
    CHIP_ENCODER,
    CHIP_STROKES,
    MODBUS,
    PICO,
    PICO_ENCODER,
    PLAIN,
    SERVOS,
    TCP,
    Backend,
)
from faults.case import Found, measure, times, undisturbed
from faults.kept import Key, Line
from faults.realtime import DEVICES, REAL_ROWS, EndedBefore, RealDevice, RealFound, RealRow
from faults.rows import ROWS, Row
from faults.stages import ARMING, BY_KEY, CYCLE, OTHER_STAGES, PAUSE, START, Stage
from shared.cases import in_order, spread

PHASES = 4  # of the limit cycle
OTHERS_SHARE = 0.25
# rows that are the loop's own matter: what device is behind it makes no difference
ALIKE = (
    "host SIGINT", "host SIGTERM", "host overloaded", "clock stepped", "disk full", "folder unwritable",
    "folder unwritable, in the run", "recorder killed", "stop flag cut short", "config changed in the run",
    "friction too high to start",
    *strangers.ACTS,
)  # fmt: skip

# what is tried on a servo
OF_SERVO = (
    "cable out", "port gone", "garbage", "bit flips, to the host", "one bit flip", "truncated replies",
    "duplicated replies", "replies late", "replies too late", "one reply lost", "replies lost", "replies stale",
    "another master", "device reset", "sensor jumps", "host SIGINT", "host SIGTERM", "host SIGSTOP, 1 s",
)  # fmt: skip


class Unmeasured(NamedTuple):
    """A row in real time whose runs all ended before anything was done to them."""

    row: str
    device: str
    why: str


_BY_KEY = {backend.key: backend for backend in BACKENDS}
_BY_NAME = {row.name: row for row in ROWS}


def is_alike(row: Row) -> bool:
    """Whether one device stands for all."""
    return row.name in ALIKE or row.early


def stages_of(row: Row, backend: Backend) -> tuple[Stage, ...]:
    """The stages in which a row is tried on a device.

    What happens to the host alone: the board and the Uno's chip. Every other row on every device: the relay cycle; but
    what is the loop's own matter not on those whose board or test alone is another, and on the Pico with an encoder
    only what an encoder changes. The board: all stages. Other devices: also the stages in which they differ from the
    board. These are the chip's own inputs and resets, what a block without limits does not see, and on the I/O block
    all that may happen while it is disarmed or armed again, since its requests differ then from those of a tick.
    A servo: ``OF_SERVO``, in the relay cycle.
    """
    is_own = any(trait in ("encoder", "pico") for trait in (*row.only, *row.other))
    is_for_one = is_alike(row) and "encoder" not in row.only
    if backend in SERVOS:
        return (CYCLE,) if row.name in OF_SERVO and row.is_for(CYCLE.traits(backend.traits)) else ()
    if row.name in strangers.ACTS and backend not in (BOARD, CHIP):
        stages: tuple[Stage, ...] = ()
    elif (backend in (CHIP_STROKES, PICO, PICO_ENCODER) and is_for_one) or (backend is PICO_ENCODER and not is_own):
        stages = ()
    elif row.early:
        stages = (START,)
    elif backend is BOARD:
        stages = (CYCLE, *OTHER_STAGES)
    elif backend is MODBUS:
        stages = (CYCLE, *(OTHER_STAGES if _is_contact(row) else (PAUSE, ARMING)))
    elif (backend is CHIP and (_is_contact(row) or "chip" in row.other)) or (backend is BARE and "bare" in row.other):
        stages = (CYCLE, *OTHER_STAGES)
    elif backend is TCP and row.only:
        stages = (CYCLE, PAUSE, ARMING)
    elif backend is CHIP_ENCODER and row.only == ("encoder",):
        stages = (CYCLE, *OTHER_STAGES)
    else:
        stages = (CYCLE,)
    return tuple(stage for stage in stages if row.is_for(stage.traits(backend.traits)))


def _is_contact(row: Row) -> bool:
    return "board" in row.absent


def phases_of(backend: Backend, stage: Stage, phases: int = PHASES) -> int:
    """Number of phases tried in a stage, where the limit cycle has ``phases`` on the devices of ``PLAIN``."""
    if stage not in (START, CYCLE):
        return stage.phases
    return phases if backend in PLAIN else max(round(OTHERS_SHARE * phases), 1)


def phase_at(k: int, phases: int) -> float:
    """The k-th of so many phases, 0 to 1."""
    return (k + 0.5) / phases


def in_virtual_time(
    rows: Sequence[Row],
    backends: Sequence[Backend],
    phases: int,
    stages: Sequence[Stage] | None = None,
    without: Collection[Key] = (),
) -> list[Line]:
    """Each row on each device in each stage that it is tried in, or in these; in the cycle at so many phases.

    without  lines that are left out
    """
    places = [
        (row, backend, stage)
        for backend in backends
        for row in rows
        for stage in stages_of(row, backend)
        if (stages is None or stage in stages) and (row.name, backend.key, stage.key) not in without
    ]
    cases = [
        (row.name, backend.key, stage.key, k, phases_of(backend, stage, phases))
        for row, backend, stage in places
        for k in range(phases_of(backend, stage, phases))
    ]
    found = in_order(_virtual, cases, batch=4)
    return [
        Line(
            row.on(stage.traits(backend.traits)),
            backend,
            stage,
            times(backend, stage.course),
            tuple(one for one in found if (one.row, one.backend, one.stage) == (row.name, backend.key, stage.key)),
        )
        for row, backend, stage in places
    ]


def real_places(rows: Sequence[RealRow] = REAL_ROWS) -> list[tuple[RealRow, RealDevice]]:
    """Each row in real time on each device that it is tried on."""
    return [(row, device) for row in rows for device in DEVICES if row.is_for(device)]


def in_real_time(places: Sequence[tuple[RealRow, RealDevice]], phases: int) -> Iterator[RealFound | Unmeasured]:
    """Faults of the host's process and its link, at so many phases of the limit cycle, as they get ready.

    Two cases run at a time, since they mostly sleep. Cases that load the machine run alone.
    """
    cases = [(REAL_ROWS.index(row), DEVICES.index(device), k, phases) for row, device in places for k in range(phases)]
    together = [case for case in cases if not REAL_ROWS[case[0]].alone]
    yield from (found for _, found in spread(_real, together, jobs=2))
    yield from (_real(*case) for case in cases if case not in together)


def _virtual(name: str, key: str, stage_key: str, k: int, phases: int) -> Found:
    """One case; the first phase of the cycle, or from the start, also tries the next run."""
    stage = BY_KEY[stage_key]
    _warm(key)
    restarts = k == 0 and stage in (START, CYCLE)
    return measure(_BY_NAME[name], _BY_KEY[key], phase_at(k, phases), stage, restarts)


def _real(number: int, which: int, k: int, phases: int) -> RealFound | Unmeasured:
    row, device = REAL_ROWS[number], DEVICES[which]
    try:
        return realtime.measure(row, device, phase_at(k, phases), restarts=k == 0)
    except EndedBefore as error:
        return Unmeasured(row.name, device.key, str(error))


@lru_cache
def _warm(key: str) -> None:
    """Freeze what is loaded by now: to collect it before each arming would take 0.15 s for nothing."""
    undisturbed(_BY_KEY[key], "relay")
    gc.freeze()
