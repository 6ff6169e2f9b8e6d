"""The devices that the matrix is run against, each in virtual time, with the same bench behind it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from faults.bounds import Times
from faults.language import Language, ModbusLanguage, SerialLanguage
from rig.bench import emulated_io_block, truth_of
from rig.config.link_budget import bits_per_byte, link_budget, silence_s
from rig.config.schema import Experiment
from rig.daq import frames
from rig.daq.frames import Kind
from rig.emulate.firmware_build import UnoOptions
from rig.emulate.virtual_board import VirtualBoard
from rig.emulate.virtual_chip import VirtualChip
from rig.emulate.virtual_io_block import VirtualIoBlock
from rig.experiment import RELAY_TIMEOUT_PERIODS
from rig.model.bench import BenchParameters
from rig.model.motor import State

ROOT = Path(__file__).resolve().parents[2]
GAINS_V = (0.45, 0.9)
CYCLES = 3
RAMP_V_S = 0.8
STUCK_S = 0.45
_CHIP_UNITS = 400
_BOARD_UNITS = 799
_MODBUS_UNITS = 10000
_STOP_BYTES = 8  # of FC06
_BYTE_BITS = 11
_LOOKS_APART = 25  # ticks between two looks at the recorder


@dataclass(frozen=True, eq=False)
class Backend:
    """One of the devices.

    key, title   short, and as the table has it
    daq          what the config's section has
    stop_s       that the frame that says stop takes, until it is executed
    hardware_s   from a hang until the chip resets itself, at most; nan where nothing can hang
    device       powers it on
    language     of its wire
    place        name in rig.bench of what gives the loop its device
    """

    key: str
    title: str
    daq: Mapping[str, Any]
    stop_s: Callable[[Experiment], float]
    hardware_s: float
    device: Callable[[Experiment], Any]
    language: Callable[[Experiment], Language]
    place: str

    def config(self) -> dict[str, Any]:
        """Of a relay test of a few cycles with given gains, on the bench of config/demo.yaml."""
        config: dict[str, Any] = yaml.safe_load((ROOT / "config" / "demo.yaml").read_text(encoding="utf-8"))
        del config["tracking"]
        config["name"] = f"fault-{self.key}"
        config["breakaway"]["ramp_V_s"] = RAMP_V_S
        config["relay"] = {"gains": [{"h1_V": GAINS_V[0], "h2_V": GAINS_V[1]}], "cycles": CYCLES}
        config["daq"] |= self.daq
        return config

    def times(self, experiment: Experiment, cycle_s: float) -> Times:
        """What bounds are made of."""
        b = experiment.breakaway
        return Times(
            tick=0.001,
            period=experiment.period_s,
            timeout=experiment.daq.timeout_s,
            watchdog=experiment.daq.watchdog_s,
            frame=self.stop_s(experiment),
            exchange=link_budget(experiment).total_s,
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


class BlockOnStand:
    """The virtual I/O block, as the stand looks at a device."""

    def __init__(self, block: VirtualIoBlock) -> None:
        self._block = block
        self.write, self.read, self.rewire, self.place = block.write, block.read, block.rewire, block.place
        self.sleep_until, self.now_s = block.sleep_until, block.now_s

    def truth(self) -> BlockTruth:
        """What is really the case."""
        truth = self._block.truth()
        return BlockTruth(
            self._block.now_s(), truth.output_V, truth.y_rad, truth.v_rad_per_s, self._block.outputs[-1][0]
        )

    def reset(self, cause: int) -> None:
        """Its supply fails for a moment."""
        self._block.block.power_off()

    def forget(self) -> None:
        """Drop the log of executed drives and all but the last of the output's changes, which the block keeps."""
        self._block.executed.clear()
        del self._block.outputs[:-1]


class BlockTruth(NamedTuple):
    """As ``Truth`` of the stand; the pin is the output."""

    t_s: float
    pin_V: float
    y_rad: float
    v_rad_per_s: float
    pin_changed_s: float


def _serial_stop_s(experiment: Experiment) -> float:
    return len(frames.encode(Kind.STOP, 0x101)) * _BYTE_BITS / experiment.daq.baud


def _modbus_stop_s(experiment: Experiment) -> float:
    """Two silences of the line: before the frame, and the one that ends it."""
    modbus = experiment.daq.modbus
    if modbus is None:
        raise ValueError("the config has no section daq.modbus")
    wire_s = _STOP_BYTES * bits_per_byte(modbus) / experiment.daq.baud
    return wire_s + 2.0 * silence_s(modbus, experiment.daq.baud) + modbus.turnaround_s


def _modbus_daq() -> dict[str, Any]:
    daq: dict[str, Any] = yaml.safe_load((ROOT / "config" / "modbus-rtu.yaml").read_text(encoding="utf-8"))["daq"]
    return daq | {"port": "emulated-virtual"}


_SERIAL = {"port": "emulated-chip", "timeout_s": 0.02}

CHIP = Backend(
    "chip",
    "the Uno's emulated chip",
    _SERIAL,
    _serial_stop_s,
    0.150,
    _chip,
    lambda e: SerialLanguage(e.drive.supply_V / _CHIP_UNITS),
    "emulated_chip",
)
BOARD = Backend(
    "board",
    "the host-board device",
    _SERIAL,
    _serial_stop_s,
    0.121,
    _board,
    lambda e: SerialLanguage(e.drive.supply_V / _BOARD_UNITS),
    "emulated_chip",
)
MODBUS = Backend(
    "modbus",
    "the Modbus I/O block",
    _modbus_daq(),
    _modbus_stop_s,
    math.nan,
    lambda e: BlockOnStand(emulated_io_block(e)),
    lambda e: ModbusLanguage(e.drive.supply_V / _MODBUS_UNITS),
    "emulated_io_block",
)
BACKENDS = (CHIP, BOARD, MODBUS)
