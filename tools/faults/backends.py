"""The devices that the matrix is run against, each in virtual time, with the same bench behind it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from faults.bounds import Times
from faults.language import Language, ModbusLanguage, SerialLanguage
from faults.stand import Stand
from rig.bench import emulated_io_block, truth_of
from rig.config.link_budget import bits_per_byte, block_share, link_budget, longest_transaction_s, silence_s
from rig.config.modbus import is_tcp
from rig.config.schema import Experiment
from rig.daq import frames
from rig.daq.frames import BLOCK_ROWS, Kind
from rig.emulate.firmware_build import UnoOptions
from rig.emulate.virtual_board import VirtualBoard
from rig.emulate.virtual_chip import VirtualChip
from rig.emulate.virtual_io_block import VirtualIoBlock
from rig.emulate.virtual_tcp_block import VirtualTcpBlock
from rig.model.bench import BenchParameters
from rig.model.motor import State

ROOT = Path(__file__).resolve().parents[2]
GAINS_V = (0.45, 0.9)
CYCLES = 3
RAMP_V_S = 0.8
_CHIP_UNITS = 400
_BOARD_UNITS = 799
_MODBUS_UNITS = 10000
_STOP_BYTES = 8  # of FC06
_BYTE_BITS = 11
_BROWN_OUT, _BOOT_S = 4, 0.05
_LOOKS_APART = 25  # ticks between two looks at the recorder


@dataclass(frozen=True, eq=False)
class Backend:
    """One of the devices.

    key, title   short, and as the table has it
    traits       by which rows tell devices apart, from the general to the particular
    changes      of config/demo.yaml, section by section
    stop_s       that the frame that says stop takes, until it is executed
    hardware_s   from a hang until the chip resets itself, at most; nan where nothing can hang
    device       powers it on
    language     of its wire
    places       functions of rig.bench that give the loop its device, and what gives it the stand instead
    remark       what else is to be said of it
    """

    key: str
    title: str
    traits: tuple[str, ...]
    changes: Mapping[str, Any]
    stop_s: Callable[[Experiment], float]
    hardware_s: float
    device: Callable[[Experiment], Any]
    language: Callable[[Experiment], Language]
    places: Callable[[Stand], Mapping[str, Callable[..., Any]]]
    remark: str = ""

    def config(self) -> dict[str, Any]:
        """Of a relay test of a few cycles with given gains, on the bench of config/demo.yaml."""
        config: dict[str, Any] = yaml.safe_load((ROOT / "config" / "demo.yaml").read_text(encoding="utf-8"))
        del config["tracking"]
        config["name"] = f"fault-{self.key}"
        config["breakaway"]["ramp_V_s"] = RAMP_V_S
        config["relay"] = {"gains": [{"h1_V": GAINS_V[0], "h2_V": GAINS_V[1]}], "cycles": CYCLES}
        for section, change in self.changes.items():
            config[section] = config[section] | change if isinstance(change, Mapping) else change
        return config

    def spare_s(self, experiment: Experiment) -> float:
        """What the time-out leaves beside the longest question and its answer; all of it where blocks come unasked."""
        if experiment.relay.where == "device":
            return experiment.daq.timeout_s
        answer_s = longest_transaction_s(experiment) or _on_the_wire_s(experiment)
        return experiment.daq.timeout_s - answer_s

    def times(self, experiment: Experiment, cycle_s: float) -> Times:
        """What bounds are made of."""
        b = experiment.breakaway
        return Times(
            tick=0.001,
            period=experiment.period_s,
            timeout=experiment.daq.timeout_s,
            watchdog=experiment.daq.watchdog_s,
            frame=self.stop_s(experiment),
            exchange=_on_the_wire_s(experiment),
            hardware=self.hardware_s,
            cycle=cycle_s,
            check=_LOOKS_APART * experiment.period_s,
            breakaway=2.0 * b.max_V / b.ramp_V_s + 12.0 * b.rest_s,
            runaway=_runaway_s(experiment),
            block=BLOCK_ROWS * 0.001 if experiment.relay.where == "device" else math.nan,
        )


def _on_the_wire_s(experiment: Experiment) -> float:
    """A tick's question, answer and drive; of the relay in the device a block."""
    if experiment.relay.where == "device":
        return block_share(experiment.daq.baud) * BLOCK_ROWS * 0.001
    return link_budget(experiment).total_s


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
    """A virtual I/O block, as the stand looks at a device; what else it can is the block's own."""

    def __init__(self, block: VirtualIoBlock | VirtualTcpBlock) -> None:
        self._block = block

    def __getattr__(self, name: str) -> Any:
        return getattr(self._block, name)

    def truth(self) -> BlockTruth:
        """What is really the case."""
        truth = self._block.truth()
        return BlockTruth(
            self._block.now_s(), truth.output_V, truth.y_rad, truth.v_rad_per_s, self._block.outputs[-1][0]
        )

    def reset(self, cause: int) -> None:
        """Its supply fails for a moment; a brown-out lets it start anew, which only a network sees."""
        if isinstance(self._block, VirtualTcpBlock):
            self._block.reset(_BOOT_S if cause == _BROWN_OUT else 0.0)
        else:
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
    """Two silences of the line: before the frame, and the one that ends it. Of a network the turnaround alone."""
    modbus = experiment.daq.modbus
    if modbus is None:
        raise ValueError("the config has no section daq.modbus")
    if is_tcp(experiment.daq.port):
        return modbus.turnaround_s
    wire_s = _STOP_BYTES * bits_per_byte(modbus) / experiment.daq.baud
    return wire_s + 2.0 * silence_s(modbus, experiment.daq.baud) + modbus.turnaround_s


def _modbus_daq(name: str, port: str) -> dict[str, Any]:
    daq: dict[str, Any] = yaml.safe_load((ROOT / "config" / name).read_text(encoding="utf-8"))["daq"]
    return daq | {"port": port}


def _separate() -> dict[str, Any]:
    daq = _modbus_daq("modbus-rtu.yaml", "emulated-virtual")
    return daq | {"modbus": daq["modbus"] | {"requests": "separate"}}


def _tcp_block(experiment: Experiment) -> BlockOnStand:
    if experiment.emulated is None or experiment.daq.modbus is None:
        raise ValueError("the matrix needs an emulated block")
    emulated = experiment.emulated.model_dump()
    return BlockOnStand(VirtualTcpBlock(experiment.daq.modbus.model_dump(), emulated, experiment.seed))


def _instead(name: str) -> Callable[[Stand], Mapping[str, Callable[..., Any]]]:
    """The stand for what one function of rig.bench gives."""
    return lambda stand: {name: lambda experiment: stand}


def _over_tcp(stand: Stand) -> Mapping[str, Callable[..., Any]]:
    """Each run connects anew, and lives in the stand's time."""
    return {"_modbus_transport": lambda experiment, port: stand.connected(), "_clock_of": lambda experiment: stand}


def _block_language(experiment: Experiment) -> ModbusLanguage:
    modbus = experiment.daq.modbus
    separate = modbus is not None and modbus.requests == "separate"
    tcp = is_tcp(experiment.daq.port)
    return ModbusLanguage(experiment.drive.supply_V / _MODBUS_UNITS, separate=separate, tcp=tcp)


_SERIAL = {"daq": {"port": "emulated-chip", "timeout_s": 0.02}}
# samples are older: at the same limits a little less speed than with the host's relay
_RELAY = _SERIAL | {"relay": {"where": "device", "cycles": CYCLES + 2}, "limits": {"max_speed_rad_s": 4.6}}

CHIP = Backend(
    "chip",
    "the Uno's emulated chip",
    ("serial", "chip"),
    _SERIAL,
    _serial_stop_s,
    0.150,
    _chip,
    lambda e: SerialLanguage(e.drive.supply_V / _CHIP_UNITS),
    _instead("emulated_chip"),
)
BOARD = Backend(
    "board",
    "the host-board device",
    ("serial", "board"),
    _SERIAL,
    _serial_stop_s,
    0.121,
    _board,
    lambda e: SerialLanguage(e.drive.supply_V / _BOARD_UNITS),
    _instead("emulated_chip"),
)
MODBUS = Backend(
    "modbus",
    "the Modbus I/O block",
    ("modbus", "rtu", "fc23"),
    {"daq": _modbus_daq("modbus-rtu.yaml", "emulated-virtual")},
    _modbus_stop_s,
    math.nan,
    lambda e: BlockOnStand(emulated_io_block(e)),
    _block_language,
    _instead("emulated_io_block"),
)
_IN_DEVICE = (
    "`relay.where: device`, 115200 baud, largest speed 4.6 rad/s ([device-relay.md](device-relay.md)). The rows come\n"
    "in blocks of ten; the host's only word is KEEP, one each period. Where the run goes on, *drive 0* is the longest\n"
    "time between two of these that arrived."
)
CHIP_RELAY = replace(
    CHIP,
    key="chip-relay",
    title="the Uno's emulated chip, whose own relay drives",
    traits=(*CHIP.traits, "relay"),
    changes=_RELAY,
    remark=_IN_DEVICE,
)
BOARD_RELAY = replace(
    BOARD,
    key="board-relay",
    title="the host-board device, whose own relay drives",
    traits=(*BOARD.traits, "relay"),
    changes=_RELAY,
    remark=_IN_DEVICE,
)
SEPARATE = replace(
    MODBUS,
    key="separate",
    title="the Modbus I/O block, asked by FC03 and then FC16",
    traits=("modbus", "rtu", "separate"),
    changes={
        "daq": _separate(),
        "period_s": 0.016,
        "relay": {"cycles": CYCLES + 2},
        "limits": {"max_speed_rad_s": 4.8},
    },
    remark="RTU with `requests: separate`, for a device without FC23: two transactions a tick, a period of 16 ms.",
)
TCP = replace(
    MODBUS,
    key="tcp",
    title="the Modbus I/O block on TCP",
    traits=("modbus", "fc23", "tcp"),
    changes={"daq": _modbus_daq("modbus-tcp.yaml", "tcp://192.168.0.5"), "relay": {"cycles": CYCLES + 2}},
    device=_tcp_block,
    remark="A network in virtual time, 10 Mbit/s: what it loses is sent again after 0.2 s, and what follows waits.\n"
    "Its ways may be blocked, connections end. No frame is damaged; a gateway may be late or silent, or answer twice.",
    places=_over_tcp,
)
PLAIN = (CHIP, BOARD, MODBUS)
OTHERS = (CHIP_RELAY, BOARD_RELAY, SEPARATE, TCP)  # which differ from these in the link, or in where the relay runs
BACKENDS = PLAIN + OTHERS
