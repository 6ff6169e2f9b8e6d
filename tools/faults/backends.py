"""The devices that the matrix is run against, each in virtual time, with the same bench behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from faults.bounds import Times
from faults.language import Language, SerialLanguage
from rig.bench import truth_of
from rig.config.schema import Experiment
from rig.daq import frames
from rig.daq.frames import Kind
from rig.emulate.firmware_build import UnoOptions
from rig.emulate.virtual_board import VirtualBoard
from rig.emulate.virtual_chip import VirtualChip
from rig.experiment import RELAY_TIMEOUT_PERIODS
from rig.model.bench import BenchParameters
from rig.model.motor import State

ROOT = Path(__file__).resolve().parents[2]
GAINS_V = (0.45, 0.9)
CYCLES = 3
STUCK_S = 0.45
_CHIP_UNITS = 400
_BOARD_UNITS = 799
_BYTE_BITS = 11
_LOOKS_APART = 25  # ticks between two looks at the recorder


@dataclass(frozen=True, eq=False)
class Backend:
    """One of the devices.

    key, title   short, and as the table has it
    changes      of the config, by section
    hardware_s   from a hang until the chip resets itself, at most
    device       powers it on
    language     of its wire
    place        name in rig.bench of what gives the loop its device
    """

    key: str
    title: str
    changes: Mapping[str, Mapping[str, Any]]
    hardware_s: float
    device: Callable[[Experiment], Any]
    language: Callable[[Experiment], Language]
    place: str

    def config(self) -> dict[str, Any]:
        """Of a relay test of a few cycles with given gains, on the bench of config/demo.yaml."""
        config: dict[str, Any] = yaml.safe_load((ROOT / "config" / "demo.yaml").read_text(encoding="utf-8"))
        del config["tracking"]
        config["name"] = f"fault-{self.key}"
        config["breakaway"]["ramp_V_s"] = 0.8
        config["relay"] = {"gains": [{"h1_V": GAINS_V[0], "h2_V": GAINS_V[1]}], "cycles": CYCLES}
        for section, changes in self.changes.items():
            config[section] |= changes
        return config

    def times(self, experiment: Experiment, cycle_s: float) -> Times:
        """What bounds are made of."""
        b, byte_s = experiment.breakaway, _BYTE_BITS / experiment.daq.baud

        def wire_s(kind: Kind) -> float:
            return len(frames.encode(kind, 0x101, b"\1" * frames.BODY_LENGTH[kind])) * byte_s

        return Times(
            tick=0.001,
            period=experiment.period_s,
            timeout=experiment.daq.timeout_s,
            watchdog=experiment.daq.watchdog_s,
            frame=wire_s(Kind.DRIVE),
            exchange=wire_s(Kind.READ) + wire_s(Kind.STATE) + wire_s(Kind.DRIVE),
            hardware=self.hardware_s,
            cycle=cycle_s,
            stuck=STUCK_S,
            check=_LOOKS_APART * experiment.period_s,
            breakaway=2.0 * b.max_V / b.ramp_V_s + 12.0 * b.rest_s,
            relay=RELAY_TIMEOUT_PERIODS * CYCLES * 2.0,
            runaway=_runaway_s(experiment),
        )


def _bench(experiment: Experiment) -> BenchParameters:
    bench = truth_of(experiment)
    if bench is None or experiment.emulated is None:
        raise ValueError("the matrix needs an emulated bench")
    return bench


def _clock_error_ppm(experiment: Experiment) -> float:
    return 0.0 if experiment.emulated is None else experiment.emulated.clock_error_ppm


def _runaway_s(experiment: Experiment) -> float:
    low_rad, high_rad = experiment.limits.hard_rad
    motor = _bench(experiment).motor
    time_s, state = 0.0, State(-experiment.limits.max_speed_rad_s, low_rad)
    while state.y < high_rad:
        state, time_s = motor.advance(state, sum(GAINS_V), 0.001), time_s + 0.001
    return time_s


def _chip(experiment: Experiment) -> VirtualChip:
    options = UnoOptions(baud=experiment.daq.baud, end_switches=True)
    return VirtualChip(
        _bench(experiment), experiment.seed, clock_error_ppm=_clock_error_ppm(experiment), options=options
    )


def _board(experiment: Experiment) -> VirtualBoard:
    return VirtualBoard(
        _bench(experiment), experiment.seed, clock_error_ppm=_clock_error_ppm(experiment), baud=experiment.daq.baud
    )


_SERIAL = {"daq": {"port": "emulated-chip", "timeout_s": 0.02}}

CHIP = Backend(
    "chip",
    "the Uno's emulated chip",
    _SERIAL,
    0.150,
    _chip,
    lambda e: SerialLanguage(e.drive.supply_V / _CHIP_UNITS),
    "emulated_chip",
)
BOARD = Backend(
    "board",
    "the host-board device",
    _SERIAL,
    0.121,
    _board,
    lambda e: SerialLanguage(e.drive.supply_V / _BOARD_UNITS),
    "emulated_chip",
)
BACKENDS = (CHIP, BOARD)
