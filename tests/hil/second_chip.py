"""The Uno's firmware on another emulator, avr8js, in virtual time: to those who write, read and wait, a VirtualChip."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple, Self

from chip_host import UnoHost
from idle_node import IdleNode
from typing_extensions import override

from emulated_chips import build as chip_build
from emulated_chips.node_chip import NodeChip
from rig.backends.emulated.plug import Until
from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant, source_folder
from rig.model.bench import BenchParameters

_FOLDER = Path(__file__).parent / "avr8js"
_BYTE_NS = round(10e9 / 115200)
_IDLE = IdleNode()


class SecondTruth(NamedTuple):
    """What is the case at the pins and at the motor; ``pin_V`` is the mean since the last look."""

    t_s: float
    pin_V: float
    y_rad: float
    v_rad_per_s: float
    led: bool
    overruns: int
    resets: int


class SecondChip(NodeChip):
    """One Uno at 115200 baud, powered on at time 0; ends with the ``with`` block.

    bench    Coulomb and static friction, a potentiometer without noise, nothing else
    options  that the firmware is built with
    Raises RuntimeError where node or avr8js is missing.
    """

    def __init__(self, bench: BenchParameters, options: Variant = PLAIN_VARIANT) -> None:
        node = shutil.which("node")
        if node is None or not (_FOLDER / "node_modules" / "avr8js").is_dir():
            missing = "node" if node is None else "avr8js"
            raise RuntimeError(f"{missing} is missing, on which the second emulator runs: run `make setup`")
        m, f = bench.motor, bench.motor.friction
        if f.falls_with_speed or f.viscous_V_s_rad or bench.noise_rad or bench.offset_rad:
            raise ValueError("the second emulator's bench has neither Stribeck nor viscous friction, noise nor offset")
        motor = {
            "tau_s": m.tau_s, "K_rad_s_V": m.K_rad_s_V, "bias_V": m.bias_V, "start_rad": bench.start_rad,
            "fc_plus_V": f.plus_V, "fc_minus_V": f.minus_V,
            "fs_plus_V": f.static_plus_V, "fs_minus_V": f.static_minus_V,
        }  # fmt: skip
        names = ("rad_per_count", "centre_counts", "supply_V")
        chip = {
            "command": [node, str(source_folder() / "emulator/pico/main.js"), str(_FOLDER / "chip.js")],
            "hex": str(chip_build.build_chip(options).hex),
            "bridge": options.bridge,
            "byte_ns": _BYTE_NS,
            "motor": motor,
            "bench": {name: getattr(bench, name) for name in names},
        }
        super().__init__("second chip", chip, _IDLE.take())
        self.reads = Until.BYTE
        self._longest_pulse_s = 0.0
        self._truth = SecondTruth(0.0, 0.0, bench.start_rad, 0.0, False, 0, 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        _IDLE.keep(self.leave())

    @override
    def _run(self, until_ns: int, until: Until) -> None:
        (seen,) = self._ask_after(until_ns, until, "look")
        self._longest_pulse_s = max(self._longest_pulse_s, seen.pop("longest_pulse_s"))
        self._truth = SecondTruth(self.now_s(), **seen)

    def truth(self) -> SecondTruth:  # type: ignore[override]  # it knows less than others
        return self._truth

    def longest_pulse_s(self) -> float:
        """Longest time for which the bridge has conducted without a break since the last call, s."""
        longest_s, self._longest_pulse_s = self._longest_pulse_s, 0.0
        return longest_s

    def contact(self, is_open: bool) -> None:
        """Open or close the e-stop's contact."""
        self._call("contact", is_open)

    def hang(self) -> None:
        """Send the main loop into an endless one; interrupts go on."""
        self._call("hang")


class SecondHost(UnoHost[SecondChip]):
    """Frames to and from one Uno on this emulator."""

    def truth(self) -> SecondTruth:
        return self.board.truth()
