"""A chip in virtual time whose emulator is a program of node (firmware/emulator/pico/main.js)."""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import weakref
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NotRequired, TypedDict

from typing_extensions import override

from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.plug import Until
from rig.backends.serial.emulated.virtual_device import PortAndClock

if TYPE_CHECKING:  # it loads slowly
    from pydantic import JsonValue

    from rig.core.strict_json import JsonObject

_END_S = 10.0


class _Said(TypedDict):
    """What the emulator answers."""

    received: str
    now_ns: int
    results: list[Any]
    error: NotRequired[str]


class NodeChip(PortAndClock):
    """One emulated chip, powered on at virtual time 0: wire, clock and bench in one. Any number may live side by side.

    device      what is unplugged, in the fault's words
    parameters  of the emulator, its command among them
    emulator    a process that another one has left; None: one of its own, which takes some 0.2 s to get going
    Raises EmulationError if a parameter is out of range.
    """

    def __init__(
        self, device: str, parameters: Mapping[str, Any], emulator: subprocess.Popen[bytes] | None = None
    ) -> None:
        super().__init__(device)
        self._process = emulator or subprocess.Popen(
            parameters["command"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._finalizer = weakref.finalize(self, _end, self._process)
        self._to_send = b""
        self._received = b""
        self._at_ns = 0
        self._say(dict(parameters))

    # ------------------------------------------------------------------ port

    @override
    def write(self, data: bytes) -> None:
        self._check_plug()
        self._to_send += data

    @override
    def read(self, timeout_s: float) -> bytes:
        self._check_plug()
        if not self._received:
            self._run(self._now_ns() + math.ceil(1e9 * max(timeout_s, 0.0)), self.reads)
        data, self._received = self._received, b""
        return data

    # ------------------------------------------------------------------ clock

    @override
    def _now_ns(self) -> int:
        return self._at_ns

    # ------------------------------------------------------------------ the process

    def end(self) -> None:
        """End the process. May be called twice."""
        self._finalizer()

    def leave(self) -> subprocess.Popen[bytes]:
        """Power the chip off for good; its process, for the next one: ``emulator``."""
        self._finalizer.detach()
        return self._process

    @override
    def _run(self, until_ns: int, until: Until) -> None:
        self._ask_after(until_ns, until)

    def _ask_after(self, until_ns: int, until: Until, *methods: str) -> list[Any]:
        """As ``_run``; what these methods of the chip tell then."""
        return self._ask({"until_ns": until_ns, "until": until, "calls": [[method] for method in methods]})

    def _call(self, method: str, *given: JsonValue) -> Any:
        return self._ask({"until_ns": None, "until": Until.TIME, "calls": [[method, *given]]})[0]

    def _ask(self, what: JsonObject) -> list[Any]:
        said = self._say({"send": self._to_send.hex(), **what})
        self._to_send = b""
        self._received += bytes.fromhex(said["received"])
        self._at_ns = int(said["now_ns"])
        return said["results"]

    def _say(self, what: JsonObject) -> _Said:
        """One line there and one back. Raises EmulationError with the emulator's words where it fails."""
        assert self._process.stdin is not None and self._process.stdout is not None
        if self._process.stdin.closed:
            raise EmulationError("this emulated chip has ended")
        try:
            self._process.stdin.write(json.dumps(what).encode() + b"\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except OSError:
            line = b""
        if not line:
            raise EmulationError(f"the chip's emulator ended, status {self._process.wait(_END_S)}: its words are above")
        said: _Said = json.loads(line)
        if "error" in said:
            raise EmulationError(said["error"])
        return said


def _end(process: subprocess.Popen[bytes]) -> None:
    """The process ends with its standard input."""
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()
    process.wait(_END_S)
