"""The Raspberry Pi Pico's emulated chip in virtual time: the very .uf2 that is flashed, on rp2040js and node."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from typing_extensions import override

from emulated_chips.node_chip import NodeChip
from emulated_chips.truth import ChipTruth, Contact

if TYPE_CHECKING:  # it loads slowly
    from rig.model.bench import DriveWiring, SensorWiring

PicoHang = Literal["main loop", "everything", "tick", "converter", "counter"]
PicoStall = Literal["main loop", "tick"]


class VirtualPico(NodeChip):
    """One emulated Pico. ``parameters`` are as ``pico_parameters`` gives them; the rest as of ``NodeChip``."""

    def __init__(self, parameters: Mapping[str, Any], emulator: subprocess.Popen[bytes] | None = None) -> None:
        super().__init__("virtual Pico", parameters, emulator)

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
