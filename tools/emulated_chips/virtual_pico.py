"""The Raspberry Pi Pico's emulated chip in virtual time: the very .uf2 that is flashed, on rp2040js and node."""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import weakref
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, NotRequired, TypedDict

from typing_extensions import override

from emulated_chips.truth import ChipTruth, Contact
from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.plug import Until
from rig.backends.serial.emulated.virtual_device import PortAndClock

if TYPE_CHECKING:  # it loads slowly
    from pydantic import JsonValue

    from rig.core.strict_json import JsonObject
    from rig.model.bench import DriveWiring, SensorWiring

_END_S = 10.0

PicoHang = Literal["main loop", "everything", "tick", "converter", "counter"]


class _Said(TypedDict):
    """What the emulator answers."""

    received: str
    now_ns: int
    results: list[Any]
    error: NotRequired[str]


PicoStall = Literal["main loop", "tick"]


class VirtualPico(PortAndClock):
    """One emulated Pico, powered on at virtual time 0: wire, clock and bench in one. Any number may live side by side.

    parameters  as ``pico_parameters`` gives them
    emulator    a process that another one has left; None: one of its own, which takes some 0.2 s to get going
    Raises EmulationError if a parameter is out of range.
    """

    def __init__(self, parameters: Mapping[str, Any], emulator: subprocess.Popen[bytes] | None = None) -> None:
        super().__init__("virtual Pico")
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

    # ------------------------------------------------------------------ what may happen to a bench

    def rewire(self, drive: DriveWiring = "ok", sensor: SensorWiring = "ok") -> None:
        """Change the wiring from now on. Raises EmulationError for wiring that there is not."""
        self._call("rewire", drive, sensor)

    def place(self, y_rad: float, v_rad_per_s: float = 0.0) -> None:
        """Put the shaft somewhere, as a hand would."""
        self._call("place", y_rad, v_rad_per_s)

    @override
    def reset(self, cause: int, boot_s: float = 0.0) -> None:
        """Reset the chip: 1 power-on, 2 external, 4 brown-out; then stay in the boot program, pins floating."""
        self._call("reset", cause, boot_s)

    def contact(self, which: Contact, is_open: bool) -> None:
        """Open or close a contact; all are closed at power on."""
        self._call("contact", which, is_open)

    def hang(self, what: PicoHang = "main loop") -> None:
        """Stop the main loop, that and all interrupts, the tick's interrupt, the converter, or an encoder's counter."""
        self._call("hang", what)

    def stall(self, what: PicoStall, duration_s: float) -> None:
        """Let the main loop's next round, or the next tick, take so much longer, s; interrupts go on."""
        self._call("stall", what, round(1e9 * duration_s))

    # ------------------------------------------------------------------ what is true of it

    @override
    def truth(self) -> ChipTruth:
        return ChipTruth(**self._call("look"))

    def stack_bytes(self) -> int:
        """Greatest depth of the stack since power on."""
        return int(self._call("stack_bytes"))

    def broken_rule(self) -> str:
        """The first rule of the data sheet that the program has broken, or the first thing that the emulator lacks."""
        return str(self._call("broken_rule"))

    def longest_pulse_s(self) -> float:
        """Longest time for which the bridge has conducted without a break, edge by edge, since the last call, s."""
        return float(self._call("longest_pulse_s"))

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
        self._ask({"until_ns": until_ns, "until": until, "calls": []})

    def _call(self, method: str, *given: JsonValue) -> Any:
        return self._ask({"until_ns": None, "until": Until.TIME, "calls": [[method, *given]]})[0]

    def _ask(self, what: JsonObject) -> list[Any]:
        said = self._say({"send": self._to_send.hex(), **what})
        self._to_send = b""
        self._received += bytes.fromhex(said["received"])
        self._at_ns = said["now_ns"]
        return said["results"]

    def _say(self, what: JsonObject) -> _Said:
        """One line there and one back. Raises EmulationError with the emulator's words where it fails."""
        assert self._process.stdin is not None and self._process.stdout is not None
        if self._process.stdin.closed:
            raise EmulationError("this emulated Pico has ended")
        try:
            self._process.stdin.write(json.dumps(what).encode() + b"\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except OSError:
            line = b""
        if not line:
            raise EmulationError(f"the Pico's emulator ended, status {self._process.wait(_END_S)}: its words are above")
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
