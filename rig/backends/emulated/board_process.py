"""An emulated device in real time: a process behind a pseudo-terminal, or on a port of loopback."""

from __future__ import annotations

import base64
import os
import pickle
import select
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rig.backends.emulated.errors import EmulationError
from rig.core.halted import end_within

if TYPE_CHECKING:  # not on Windows
    from rig.backends.emulated.real_time import Served

_START_S = 10.0
_STOP_S = 3.0


class BoardProcess:
    """Starts and stops the process. Its port can be opened and closed like a serial device's, any number of times.

    The process ends with ``stop`` or with the ``with`` block; if this process dies, 0.3 s later.
    It has a session of its own: a Ctrl-C in the terminal does not reach it.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self.port = ""  # as daq.port takes it, once it is started

    def _launch(self, make: partial[Served], link: Path | None, trace: Path | None) -> str:
        """Start the process, in which ``make`` makes the device; the name of its port. Raises EmulationError."""
        if self._process is not None:
            raise EmulationError("this emulated board already runs")
        packed = base64.b64encode(pickle.dumps((make, link, trace))).decode("ascii")
        self._process = process = subprocess.Popen(
            [sys.executable, "-P", "-m", "rig.backends.emulated", packed],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert process.stdout is not None and process.stderr is not None
        ready = select.select([process.stdout], [], [], _START_S)[0]
        words = process.stdout.readline().split() if ready else []
        if len(words) == 2 and words[0] == "port":
            self.port = words[1]
            return self.port
        if ready:
            process.wait(_STOP_S)
            why = process.stderr.read().strip() or f"exit status {process.returncode}"
        else:
            why = f"it said nothing for {_START_S:g} s"
        self.stop()
        raise EmulationError(f"the emulated device did not start: {why}")

    @property
    def pid(self) -> int:
        """Process id. Raises EmulationError when none runs."""
        if self._process is None:
            raise EmulationError("this emulated board does not run")
        return self._process.pid

    def reset(self) -> None:
        """Press the device's reset button. Raises EmulationError when none runs."""
        os.kill(self.pid, signal.SIGUSR1)

    def check(self) -> None:
        """Raise EmulationError where the process has ended by itself, or runs no more."""
        process = self._process
        if process is None:
            raise EmulationError("this emulated board does not run")
        if (status := process.poll()) is not None:
            assert process.stderr is not None
            raise EmulationError(process.stderr.read().strip() or f"the emulated device ended, exit status {status}")

    def stop(self) -> None:
        """End the process (its drive goes to 0, its link is removed). May be called twice."""
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        end_within(process, _STOP_S)
        for stream in (process.stdin, process.stdout, process.stderr):
            if stream is not None:
                stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()
