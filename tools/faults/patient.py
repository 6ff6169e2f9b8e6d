"""The recorder of a run in virtual time. Its writer is a process in real time, and virtual time waits for it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from faults.injector import FaultInjector
from rig.run_folder.recording import layout
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.sink import JsonScalar

_WAIT_S = 60.0
_MOMENT_S = 0.0005
_PROMPT_WRITER = f"""
import sys
import rig.run_folder.recording.writer as writer
writer.POLL_S = {_MOMENT_S}
sys.exit(writer.main(sys.argv[1:]))
"""


class PatientRecorder(Recorder):
    """As ``Recorder``, but no call depends on this machine's speed: each waits until all is written, or has failed.

    It reports stages and stops to the injector.
    """

    close_timeout_s = _WAIT_S
    stall_timeout_s = _WAIT_S
    writer = ("-c", _PROMPT_WRITER)  # it looks at the rows more often

    def __init__(self, injector: FaultInjector, folder: Path, stages: Sequence[str], **capacities: Any) -> None:
        super().__init__(folder, stages, **capacities)
        self._injector = injector
        injector.written = self.await_writer

    def check(self) -> None:
        """As that of ``Recorder``, after the writer has written everything."""
        self.await_writer()
        super().check()

    def event(self, t_s: float, kind: str, **fields: JsonScalar) -> None:
        """As that of ``Recorder``."""
        super().event(t_s, kind, **fields)
        if kind in ("stage", "stop"):
            self._injector.comes_to(kind if kind == "stop" else str(fields["name"]))

    def await_writer(self) -> None:
        """Wait until the writer has written each finished row and each event, or has ended, or has failed."""
        counters, deadline_s = self._counters, time.monotonic() + _WAIT_S
        while (
            counters[layout.STATE] == layout.READY
            and self._process.poll() is None
            and (
                counters[layout.ROWS_TAKEN] < self._finished_rows()
                or counters[layout.EVENT_BYTES_TAKEN] < counters[layout.EVENT_BYTES]
            )
        ):
            if time.monotonic() > deadline_s:
                raise RuntimeError(f"the recorder's writer has written nothing for {_WAIT_S:g} s")
            time.sleep(_MOMENT_S)
