"""The Uno's firmware on another emulator, avr8js, in virtual time: to those who write, read and wait, a VirtualChip."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple, Self

from chip_host import UnoHost
from idle_node import IdleNode

from emulated_chips import build as chip_build
from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant
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


class SecondChip:
    """One Uno at 115200 baud, powered on at time 0; ends with the ``with`` block.

    bench    Coulomb and static friction, a potentiometer without noise, nothing else
    options  that the firmware is built with
    Raises RuntimeError where node or avr8js is missing.
    """

    absolute = True  # of the clock

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
            "hex": str(chip_build.build_chip(options).hex),
            "bridge": options.bridge,
            "byte_ns": _BYTE_NS,
            "motor": motor,
            "bench": {name: getattr(bench, name) for name in names},
        }
        self._process = _IDLE.take() or subprocess.Popen(
            [node, str(_FOLDER / "main.js")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._say(chip)
        self._to_send = b""
        self._received = b""
        self._happens: list[str] = []
        self._now_ns = 0
        self._longest_pulse_s = 0.0
        self._truth = SecondTruth(0.0, 0.0, bench.start_rad, 0.0, False, 0, 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        _IDLE.keep(self._process)

    def write(self, data: bytes) -> None:
        self._to_send += data

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at least one byte; b"" after ``timeout_s`` of virtual time without any."""
        if not self._received:
            self._run(self._now_ns + math.ceil(1e9 * max(timeout_s, 0.0)), until_byte=True)
        data, self._received = self._received, b""
        return data

    def now_s(self) -> float:
        return self._now_ns / 1e9

    def sleep_until(self, t_s: float) -> float:
        self._run(math.ceil(1e9 * t_s), until_byte=False)
        return self.now_s()

    def truth(self) -> SecondTruth:
        return self._truth

    def longest_pulse_s(self) -> float:
        """Longest time for which the bridge has conducted without a break since the last call, s."""
        longest_s, self._longest_pulse_s = self._longest_pulse_s, 0.0
        return longest_s

    def open_estop(self) -> None:
        """Open the e-stop's contact."""
        self._happens.append("openEstop")

    def close_estop(self) -> None:
        """Close it again."""
        self._happens.append("closeEstop")

    def hang(self) -> None:
        """Send the main loop into an endless one; interrupts go on."""
        self._happens.append("hang")

    def _say(self, what: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(what) + "\n")
        self._process.stdin.flush()

    def _run(self, until_ns: int, until_byte: bool) -> None:
        self._say(
            {"until_ns": until_ns, "until_byte": until_byte, "send": self._to_send.hex(), "happens": self._happens}
        )
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the second emulator ended with status {self._process.wait(10.0)}; stderr has why")
        seen = json.loads(line)
        self._to_send, self._happens = b"", []
        self._received += bytes.fromhex(seen.pop("received"))
        self._now_ns = int(seen.pop("now_ns"))
        self._longest_pulse_s = max(self._longest_pulse_s, seen.pop("longest_pulse_s"))
        self._truth = SecondTruth(self.now_s(), **seen)


class SecondHost(UnoHost[SecondChip]):
    """Frames to and from one Uno on this emulator."""

    def truth(self) -> SecondTruth:
        return self.board.truth()
