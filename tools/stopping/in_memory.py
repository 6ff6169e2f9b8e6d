"""A run that is kept in memory: thousands of them need no folder, no writer process and no report."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from typing_extensions import override

from rig.backends.registry import Bench
from rig.config import Experiment
from rig.control.guard import Guard
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.core.faults import Fault
from rig.identification import IdentifyError
from rig.run_folder.recording.recording import Recording, assembled
from rig.run_folder.recording.sink import NullSink, Row
from rig.run_folder.results import RealTimeReport, RunEvent, RunMeta
from rig.running.preflight.room_to_stop import guard_settings_of
from rig.running.session import Findings, Session

NAMES = ("t_s", "t_u_s", "y_rad", "u_V", "z_rad_s", "stage")


class MemoryRecord(NullSink):
    """Keeps what an estimate needs of every row."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, float, float, float, float, str]] = []
        self._open: tuple[float, float, float, str] | None = None
        self._decided: list[RunEvent] = []  # of the events only these tell an estimate something

    @override
    def event(self, t_s: float, kind: str, **fields: object) -> None:
        """Keep it if it is a decision."""
        if kind == "decided":
            self._decided.append(RunEvent.model_validate({"t_s": t_s, "kind": kind, **fields}))

    @override
    def sample(self, *row: *Row) -> None:
        """Open a row. One that is still open stays without a time of effect."""
        self._close(math.nan, 0.0)
        _, sample, stage, z_rad_s, _, u_V, *_ = row
        self._open, self._asked_V = (sample.t_s, sample.y_rad, z_rad_s, stage), u_V

    @override
    def complete(self, t_u_s: float, u_V: float, flags: int = 0) -> None:
        """Finish the open row."""
        self._close(t_u_s, u_V)

    def _close(self, t_u_s: float, u_V: float) -> None:
        if self._open is not None:
            t_s, y_rad, z_rad_s, stage = self._open
            self._rows.append((t_s, t_u_s, y_rad, u_V, z_rad_s, stage))
            self._open = None

    def recording(self) -> Recording:
        """The finished rows."""
        columns = dict(zip(NAMES, map(np.array, zip(*self._rows, strict=True)), strict=True))
        of_rows = assembled(Path("in-memory"), columns, range(1, len(self._rows) + 1), columns_present=NAMES)
        return replace(of_rows, events=tuple(self._decided))


def driven(e: Experiment, bench: Bench, script: Callable[[Session], None]) -> tuple[Session, Fault | None]:
    """The session after ``script`` has run on the bench, and the fault that ended it, if one did."""
    record = MemoryRecord()
    loop = Loop(bench.driver, bench.clock, Guard(guard_settings_of(e)), record, e.period_s, StopRequest())
    nothing_asked = Findings(real_time=RealTimeReport())  # time is virtual
    session = Session(e, Path("in-memory"), bench, record, loop, RunMeta(), nothing_asked)
    session.reads = lambda *_: record.recording()
    try:
        script(session)
    except Fault as fault:
        return session, fault
    except IdentifyError as error:
        return session, Fault("NOT_IDENTIFIED", f"{error.cause}; {error.cure}")
    finally:
        loop.close()
        bench.driver.close()
    return session, None
