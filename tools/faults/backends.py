"""The devices that the matrix is run against, each in virtual time, with the same bench behind it."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from emulated_chips.pico_parameters import pico_parameters
from emulated_chips.truth import Contact
from emulated_chips.virtual_chip import VirtualChip
from emulated_chips.virtual_pico import VirtualPico
from faults.bounds import Times
from faults.injector import FaultInjector
from faults.language import Language, ModbusLanguage, SerialLanguage
from faults.servo import InjectableServo, ServoLanguage, told_by_driver
from faults.stages import Course
from rig.backends.backend import Line, truth_of
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.modbus.emulated.virtual_tcp_block import VirtualTcpBlock
from rig.backends.modbus.link_budget import bits_per_byte, longest_transaction_s, silence_s
from rig.backends.modbus.opening import emulated_io_block
from rig.backends.modbus.section import is_tcp
from rig.backends.registry import backend_of
from rig.backends.serial import frames
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import BLOCK_ROWS, Kind
from rig.backends.serial.link_budget import block_share
from rig.backends.servo.bus import Bus, bus_of
from rig.backends.servo.line import emulated_bus, servo_of, setup_of
from rig.backends.servo.models import ServoModel
from rig.config.schema import Experiment
from rig.control.guard import WINDOW_S, GuardSettings
from rig.control.known_motor import KnownMotor
from rig.control.motion import CycleWatch
from rig.control.relay import DualChannelRelay
from rig.control.tracking import linearising_drive
from rig.control.trajectory import SumOfSines
from rig.core.signals import Sample
from rig.model.bench import BenchParameters
from rig.model.motor import Motor, State
from rig.model.real_motor import Frame, FramedMotor, plain
from rig.running.experiment.tracked import FADE_S
from rig.running.preflight.breakaway_strokes import breakaway_strokes
from rig.running.preflight.room_to_stop import guard_settings_of

ROOT = Path(__file__).resolve().parents[2]
GAINS_V = (0.45, 0.9)
CYCLES = 5
RAMP_V_S = 0.8
TRACKING_S = 4.5
# a search that takes a step or two: it starts near a cycle that it is content with
SEARCH = {
    "target": {"amplitude_rad": 0.4, "period_s": 1.0, "tolerance": 0.25},
    "search": {"h1_start_V": 0.45, "h2_start_V": 0.8},
    "cycles": CYCLES,
}
_CHIP_UNITS = 400
_BOARD_UNITS = 799
_PICO_UNITS = 6250
_MODBUS_UNITS = 10000
_STOP_BYTES = 8  # of FC06
_BYTE_BITS = 11
_BITS_PER_BYTE = 10
_BROWN_OUT, _BOOT_S = 4, 0.05
_LOOKS_APART = 25  # ticks between two looks at the recorder
_STEP_S = 0.002  # of the model
_LONG_S = 60.0  # after which a motor has the speed of its drive
_SETTLED_S = 6.0  # by when the relay with GAINS_V has its cycle
OVERSPEED = 1.2  # times the largest speed: the guard's
_WELL_ABOVE = 1.4  # times static friction: as the guard has it
_LOOKS_S = 15.0  # of the reference
_STILL_COUNTS = 66  # of travel, after which a channel that stands still is a fault: docs/encoder.md
_APART = 10  # ticks between the instants that a shaft may stop at


@dataclass(frozen=True, eq=False)
class Backend:
    """One of the devices.

    key, title   short, and as the table has it
    traits       by which rows tell devices apart, from the general to the particular
    changes      of ``base``, section by section
    stop_s       that the frame that says stop takes, until it is executed
    hardware_s   from a hang until the chip resets itself, at most; nan where nothing can hang
    device       powers it on
    language     of its wire
    line         what a driver speaks over, with the injector as its device
    remark       what else is to be said of it
    base         the config that ``changes`` are of
    hangs        what of the program may stand still, by the emulator's names; empty where it has one hang alone
    told     while it is entered, the driver tells the language what its frames do not say
    """

    key: str
    title: str
    traits: tuple[str, ...]
    changes: Mapping[str, Any]
    stop_s: Callable[[Experiment], float]
    hardware_s: float
    device: Callable[[Experiment], Any]
    language: Callable[[Experiment], Language]
    line: Callable[[FaultInjector], Line]
    remark: str = ""
    base: str = "demo.yaml"
    hangs: tuple[str, ...] = ()
    told: Callable[[FaultInjector], AbstractContextManager[None]] = lambda _: nullcontext()

    def config(self, course: Course = "relay") -> dict[str, Any]:
        """Of a relay test of a few cycles with given gains, or of a stroke test, on the bench of ``base``.

        course  "search": the gains are searched; "run": a short tracking check follows
        """
        config: dict[str, Any] = yaml.safe_load((ROOT / "config" / self.base).read_text(encoding="utf-8"))
        tracking = config.pop("tracking", {})
        config["name"] = f"fault-{self.key}"
        config["breakaway"]["ramp_V_s"] = RAMP_V_S
        config["relay"] = {"gains": [{"h1_V": GAINS_V[0], "h2_V": GAINS_V[1]}], "cycles": CYCLES}
        if self.runs_strokes:
            config["relay"] = {"until": {"interval_percent": 0.4}}  # ``fixed_advice`` says what is driven
        for section, change in self.changes.items():
            config[section] = config[section] | change if isinstance(change, Mapping) else change
        if course == "search":
            config["relay"] = SEARCH
        if course == "run":
            config["tracking"] = tracking | {"duration_s": TRACKING_S, "methods": ["sampled-data"]}
        return config

    @property
    def runs_strokes(self) -> bool:
        """Whether its test is a stroke test in the device."""
        return "strokes" in self.traits

    @property
    def has_encoder(self) -> bool:
        """Whether it counts an encoder, whose zero somebody has to set."""
        return "encoder" in self.traits

    def spare_s(self, experiment: Experiment) -> float:
        """What the time-out leaves beside the longest question and its answer; all of it where blocks come unasked."""
        if experiment.relay.where == "device":
            return experiment.daq.timeout_s
        modbus = experiment.daq.modbus
        answer_s = _on_the_wire_s(experiment) if modbus is None else longest_transaction_s(experiment.daq, modbus)
        return experiment.daq.timeout_s - answer_s

    def too_late_s(self, experiment: Experiment) -> float:
        """By how much a reply comes too late: a loop that drives waits as long as the watchdog lets the drive act."""
        twice_s = 2.0 * self.spare_s(experiment)
        return twice_s if experiment.relay.where == "device" else max(twice_s, experiment.daq.watchdog_s)

    def times(self, experiment: Experiment, cycle_s: float) -> Times:
        """What bounds are made of."""
        strokes = breakaway_strokes(experiment)
        if strokes is None:
            raise ValueError("the breakaway check of the matrix's bench has no strokes")
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
            ramp=2.0 * sum(stroke_s + strokes.pause_s for stroke_s in strokes.strokes_s),
            window=1.5 * WINDOW_S,
            fling=_fling_s(experiment),
            reversal=_reversal_s(experiment, cycle_s),
            stuck=GuardSettings.stuck_s,
            unmoved=_unmoved_s(experiment),
            block=BLOCK_ROWS * 0.001 if experiment.relay.where == "device" else math.nan,
            crawl=_crawl_s(experiment),
        )


def _on_the_wire_s(experiment: Experiment) -> float:
    """A tick's question, answer and drive; of the relay in the device a block."""
    if experiment.relay.where == "device":
        return block_share(experiment.daq.baud) * BLOCK_ROWS * 0.001
    return backend_of(experiment.device).budget(experiment.device).total_s


def _bench(experiment: Experiment) -> BenchParameters:
    bench = truth_of(experiment.device)
    if bench is None or experiment.emulated is None:
        raise ValueError("the matrix needs an emulated bench")
    return bench


def _clock_error_ppm(experiment: Experiment) -> float:
    return 0.0 if experiment.emulated is None else experiment.emulated.clock_error_ppm


def _fling_s(experiment: Experiment) -> float:
    """As ``Times.fling``; nan where that drive makes no shaft so fast."""
    motor, top_rad_s = _bench(experiment).motor, experiment.limits.max_speed_rad_s
    time_s, state = 0.0, State(-top_rad_s, 0.0)
    if motor.advance(state, 0.25 * experiment.drive.supply_V, _LONG_S).v < OVERSPEED * top_rad_s:
        return math.nan
    while state.v < OVERSPEED * top_rad_s:
        state, time_s = motor.advance(state, 0.25 * experiment.drive.supply_V, _STEP_S), time_s + _STEP_S
    return time_s


def _reversal_s(experiment: Experiment, cycle_s: float) -> float:
    """As ``Times.reversal``."""
    motor, settings = _bench(experiment).motor, guard_settings_of(experiment)
    low_rad, high_rad = settings.limits.hard_rad
    ahead_s = settings.reaction_s + settings.coast_tau_s

    def step(state: State, relay: DualChannelRelay, t_s: float, way: float) -> State:
        u_V, stop_rad = relay.step(Sample(t_s, state.y, 0)), state.y + ahead_s * state.v
        if not low_rad < stop_rad < high_rad:
            u_V = -math.copysign(settings.limits.max_u_V, stop_rad)  # the guard brakes
        return motor.advance(state, way * u_V, _STEP_S)

    def found_s(state: State, relay: DualChannelRelay, from_s: float) -> float:
        t_s, stood_s = from_s, 0.0
        while (
            abs(state.v) < OVERSPEED * settings.max_speed_rad_s
            and low_rad < state.y < high_rad
            and stood_s < CycleWatch.LEAST * cycle_s
        ):
            state, t_s = step(state, relay, t_s, -1.0), t_s + _STEP_S
            stood_s = stood_s + _STEP_S if state.v == 0.0 else 0.0
        return t_s - from_s

    state, relay, worst_s = State(), DualChannelRelay(*GAINS_V, math.inf), 0.0
    for k in range(round(_SETTLED_S / _STEP_S)):
        if k * _STEP_S >= _SETTLED_S - cycle_s and k % _APART == 0:
            worst_s = max(worst_s, found_s(state, copy.copy(relay), k * _STEP_S))
        state = step(state, relay, k * _STEP_S, 1.0)
    return worst_s


def _known(motor: Motor) -> KnownMotor:
    """As a law knows it that makes up for Coulomb friction alone."""
    return KnownMotor(FramedMotor(plain(motor)._replace(static_V=0.0), Frame()))


def _unmoved_s(experiment: Experiment) -> float:
    """As ``Times.unmoved``: a shaft that stands where the reference is at some instant, and does not move on."""
    if experiment.tracking is None:
        return math.nan
    tracking, motor = experiment.tracking, _bench(experiment).motor
    known = _known(motor)
    reference = SumOfSines([(c.amplitude_rad, c.omega_rad_s) for c in tracking.trajectory], fade_s=FADE_S)
    gains = tracking.k1_1_s, tracking.k2_1_s2
    well_V = _WELL_ABOVE * max(motor.friction.static_plus_V, motor.friction.static_minus_V)
    times_s = [k * experiment.period_s for k in range(round(_LOOKS_S / experiment.period_s))]

    def until_s(from_s: float) -> float:
        held_s, side = 0.0, 0
        for t_s in (t for t in times_s if t >= from_s):
            at = reference.at(t_s)
            u_V = linearising_drive(known, known.at_rest(from_rad), at, gains, at.v_rad_s)
            now = (u_V > well_V) - (u_V < -well_V)
            held_s, side = (held_s + experiment.period_s if now == side != 0 else 0.0), now
            if held_s >= 2.0 * GuardSettings.stuck_s:
                return t_s - from_s
        raise ValueError("the tracking law never asks a shaft that stands for enough")

    worst_s = 0.0
    for from_s in times_s[: round(tracking.duration_s / experiment.period_s) : _APART]:
        from_rad = reference.at(from_s).y_rad
        worst_s = max(worst_s, until_s(from_s))
    return worst_s


def _crawl_s(experiment: Experiment) -> float:
    """As ``Times.crawl``."""
    if experiment.sensor.encoder is None:
        return math.nan
    far_rad = _STILL_COUNTS * abs(experiment.sensor.curve.lsb_rad)
    y_rad = _tracked_rad(experiment) if experiment.tracking is not None else _cycle_rad(experiment)
    gone_rad = list(itertools.accumulate((abs(b - a) for a, b in itertools.pairwise(y_rad)), initial=0.0))
    worst, end = 0, 0
    for begin, from_rad in enumerate(gone_rad):
        while end < len(gone_rad) and gone_rad[end] - from_rad < far_rad:
            end += 1
        if end == len(gone_rad):
            break
        worst = max(worst, end - begin)
    return worst * _STEP_S


def _cycle_rad(experiment: Experiment) -> list[float]:
    """Where the shaft is in the limit cycle, each step of the model."""
    motor, relay, state, y_rad = _bench(experiment).motor, DualChannelRelay(*GAINS_V, math.inf), State(), []
    for k in range(round(2.0 * _SETTLED_S / _STEP_S)):
        state = motor.advance(state, relay.step(Sample(k * _STEP_S, state.y, 0)), _STEP_S)
        if k * _STEP_S >= _SETTLED_S:
            y_rad.append(state.y)
    return y_rad


def _tracked_rad(experiment: Experiment) -> list[float]:
    """Where the shaft is in the tracking, from its start at rest, each step of the model."""
    tracking, motor = experiment.tracking, _bench(experiment).motor
    assert tracking is not None
    known = _known(motor)
    gains = tracking.k1_1_s, tracking.k2_1_s2
    reference = SumOfSines([(c.amplitude_rad, c.omega_rad_s) for c in tracking.trajectory], fade_s=FADE_S)
    state, y_rad = State(), []
    for k in range(round(tracking.duration_s / _STEP_S)):
        at = reference.at(k * _STEP_S)
        shown = known.moved(known.at_rest(0.0), state.v, state.y)
        state = motor.advance(state, linearising_drive(known, shown, at, gains, at.v_rad_s), _STEP_S)
        y_rad.append(state.y)
    return y_rad


def _chip(experiment: Experiment) -> VirtualChip:
    bench = _bench(experiment)
    return VirtualChip(
        bench, experiment.seed, clock_error_ppm=_clock_error_ppm(experiment), options=_options(experiment, bench)
    )


def _pico(experiment: Experiment) -> VirtualPico:
    bench = _bench(experiment)
    return VirtualPico(
        pico_parameters(
            bench, experiment.seed, clock_error_ppm=_clock_error_ppm(experiment), options=_options(experiment, bench)
        )
    )


def _options(experiment: Experiment, bench: BenchParameters) -> Variant:
    return Variant(baud=experiment.daq.baud, end_switches=True, encoder=bench.encoder)


def _board(experiment: Experiment) -> VirtualBoard:
    return VirtualBoard(
        _bench(experiment), experiment.seed, clock_error_ppm=_clock_error_ppm(experiment), baud=experiment.daq.baud
    )


class InjectableBlock:
    """A virtual I/O block, as the injector looks at a device; what else it can is the block's own."""

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
            self._block.power_cycle()

    def contact(self, which: Contact, *, is_open: bool) -> None:
        """Open or close the e-stop, the only contact that the block has."""
        if which == "e_stop":
            self._block.block.e_stop_open = is_open
        elif is_open:
            raise ValueError(f"the block has no contact {which}")

    def forget(self) -> None:
        """Drop the log of executed drives and all but the last of the output's changes, which the block keeps."""
        self._block.executed.clear()
        del self._block.outputs[:-1]


class BlockTruth(NamedTuple):
    """As ``Truth`` of the injector; the pin is the output."""

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
    daq = _modbus_daq("modbus-rtu.yaml", "emulated")
    return daq | {"modbus": daq["modbus"] | {"requests": "separate"}}


def _bare() -> dict[str, Any]:
    """The block's registers without limits, rails, largest drive, status and control of its own."""
    daq = _modbus_daq("modbus-rtu.yaml", "emulated")
    kept = {name: daq["modbus"]["registers"][name] for name in ("drive", "sequence", "watchdog", "position")}
    return daq | {"modbus": daq["modbus"] | {"registers": kept}}


def _tcp_block(experiment: Experiment) -> InjectableBlock:
    if experiment.emulated is None or experiment.daq.modbus is None:
        raise ValueError("the matrix needs an emulated block")
    return InjectableBlock(VirtualTcpBlock(experiment.daq.modbus, experiment.emulated, experiment.seed))


def _through_injector(port: str) -> Callable[[FaultInjector], Line]:
    """The injector as the emulated device of that port."""
    return lambda injector: Line(injector, injector, port, emulated=True)


def _over_tcp(injector: FaultInjector) -> Line:
    """Each run connects anew, and lives in the injector's time."""
    return Line(injector.connected(), injector, "modbus:tcp://192.168.0.5")


def _frames_language(experiment: Experiment, units: int) -> SerialLanguage:
    return SerialLanguage(experiment.drive.supply_V / units, _BITS_PER_BYTE / experiment.daq.baud)


def _block_language(experiment: Experiment) -> ModbusLanguage:
    modbus = experiment.daq.modbus
    separate = modbus is not None and modbus.requests == "separate"
    tcp = is_tcp(experiment.daq.port)
    bare = modbus is not None and modbus.registers.control is None
    return ModbusLanguage(experiment.drive.supply_V / _MODBUS_UNITS, separate=separate, tcp=tcp, bare=bare)


def _servo_stop_s(experiment: Experiment) -> float:
    """With the ramp of the duty, from the largest drive to 0, as the servo comes."""
    table, bus = _servo_bus(experiment)
    slope = table.role("slope") if "slope" in table.roles else None
    ramp_s = 0.0 if slope is None else experiment.drive.max_V / ((slope.shipped or 0) * slope.scale)
    drive = table.role("drive")
    return bus.wire_s(len(bus.writing(drive.address, drive.pack(0), "").data)) + ramp_s


def _servo_language(experiment: Experiment) -> ServoLanguage:
    table, bus = _servo_bus(experiment)
    unit_V = experiment.drive.supply_V / table.full_drive
    return ServoLanguage(table, bus, unit_V, setup_of(experiment.device).zero_counts)


def _servo_bus(experiment: Experiment) -> tuple[ServoModel, Bus]:
    servo = servo_of(experiment.device)
    return servo.table, bus_of(servo.table, servo.id, experiment.daq.baud)


_SERIAL = {"daq": {"port": "emulated-chip", "timeout_s": 0.02}}
# samples are older: at the same limits a little less speed than with the host's relay
_RELAY = _SERIAL | {"relay": {"where": "device"}, "limits": {"max_speed_rad_s": 4.6}}

CHIP = Backend(
    "chip",
    "the Uno's emulated chip",
    ("serial", "chip"),
    _SERIAL,
    _serial_stop_s,
    0.150,
    _chip,
    lambda e: _frames_language(e, _CHIP_UNITS),
    _through_injector("emulated-chip"),
    hangs=("main loop", "everything", "clock", "converter"),
)
BOARD = Backend(
    "board",
    "the host-board device",
    ("serial", "board"),
    _SERIAL,
    _serial_stop_s,
    0.121,
    _board,
    lambda e: _frames_language(e, _BOARD_UNITS),
    _through_injector("emulated-chip"),
)
MODBUS = Backend(
    "modbus",
    "the Modbus I/O block",
    ("modbus", "rtu", "fc23"),
    {"daq": _modbus_daq("modbus-rtu.yaml", "emulated")},
    _modbus_stop_s,
    math.nan,
    lambda e: InjectableBlock(emulated_io_block(e.device)),
    _block_language,
    _through_injector("emulated"),
)
_IN_DEVICE = (
    "`relay.where: device`, 115200 baud, largest speed 4.6 rad/s ([device-relay.md](../device-relay.md)). The rows\n"
    "come in blocks of ten; the host's only word is KEEP, one each period. Where the run goes on, *drive 0* is the\n"
    "longest time between two of these that arrived."
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
        "limits": {"max_speed_rad_s": 4.8},
    },
    remark="RTU with `requests: separate`, for a device without FC23: two transactions a tick, a period of 16 ms.",
)
TCP = replace(
    MODBUS,
    key="tcp",
    title="the Modbus I/O block on TCP",
    traits=("modbus", "fc23", "tcp"),
    changes={"daq": _modbus_daq("modbus-tcp.yaml", "tcp://192.168.0.5")},
    device=_tcp_block,
    remark="A network in virtual time, 10 Mbit/s: what it loses is sent again after 0.2 s, and what follows waits.\n"
    "Its ways may be blocked, connections end. No frame is damaged; a gateway may be late or silent, or answer twice.",
    line=_over_tcp,
)
BARE = replace(
    MODBUS,
    key="bare",
    title="a Modbus I/O block without limits of its own",
    traits=("modbus", "rtu", "fc23", "bare"),
    changes={"daq": _bare()},
    remark="Registers for drive, its number, position and output time-out are all there is: no limits, rails, largest\n"
    "drive, status or control. What is beyond a limit only the loop sees; the watchdog is all that the block knows.",
)
CHIP_STROKES = replace(
    CHIP,
    key="chip-strokes",
    title="the Uno's emulated chip, which runs strokes",
    traits=(*CHIP.traits, "relay", "strokes"),
    changes=_RELAY,
    remark=(
        "`relay.where: device` and `relay.until` ([device-relay.md](../device-relay.md)); otherwise as where its own\n"
        "relay drives. The test is always the same: strokes to and fro, planned by nobody. A *cycle* is two strokes.\n"
        "Rows of host and recording are the loop's own: they are tried on the devices above."
    ),
)
PICO = replace(
    CHIP,
    key="pico",
    title="the Pico's emulated chip",
    traits=(*CHIP.traits, "pico"),
    changes={"daq": {"port": "emulated-pico", "timeout_s": 0.02}},
    hardware_s=0.121,
    device=_pico,
    language=lambda e: _frames_language(e, _PICO_UNITS),
    line=_through_injector("emulated-pico"),
    remark=(
        "The bench of [config/demo-pico.yaml](../../config/demo-pico.yaml): 12 bits, 6,250 units of drive. Rows of\n"
        "host and recording are the loop's own: they are tried on the devices above."
    ),
    base="demo-pico.yaml",
    hangs=("main loop", "everything", "tick", "converter"),
)
_ENCODER = (
    "The bench of [config/encoder.yaml](../../config/encoder.yaml): 3,200 counts a turn, 1 Mbaud. `rig home` has set\n"
    "the zero; where the fault ends it, the next run is refused until `rig home` has set it again\n"
    "([encoder.md](../encoder.md))."
)
CHIP_ENCODER = replace(
    CHIP,
    key="chip-encoder",
    title="the Uno's emulated chip with an encoder",
    traits=(*CHIP.traits, "encoder"),
    remark=_ENCODER,
    base="encoder.yaml",
    hangs=("main loop", "everything", "clock", "tick"),
)
PICO_ENCODER = replace(
    PICO,
    key="pico-encoder",
    title="the Pico's emulated chip with an encoder",
    traits=(*PICO.traits, "encoder", "pico-encoder"),
    remark=f"{_ENCODER} Only what an encoder, or a Pico, changes is tried.",
    base="encoder.yaml",
    hangs=("main loop", "everything", "tick", "counter"),
)
SERVO = Backend(
    "servo",
    "a Dynamixel XL330 on its bus",
    ("servo",),
    {"breakaway": {"ramp_V_s": 0.2}},
    _servo_stop_s,
    math.nan,
    lambda e: InjectableServo(emulated_bus(e.device)),
    _servo_language,
    _through_injector("emulated"),
    remark=(
        "[config/servo.yaml](../../config/servo.yaml), 1 Mbaud, a watchdog that works. The drive is the voltage\n"
        "at its motor. The limits are the host's alone; the keeper is tried in real time, by\n"
        "`tests/backends/servo/test_servo_keeper.py`. The relay cycle only, and the rows of wire, servo and host.\n"
        "*frame* holds the ramp of the duty, from `drive.max_V` to 0."
    ),
    base="servo.yaml",
    told=told_by_driver,
)
SERVO_FEETECH = replace(
    SERVO,
    key="servo-feetech",
    title="a Feetech STS3215 on its bus",
    traits=("servo", "feetech"),
    remark=(
        "[config/servo-sts3215.yaml](../../config/servo-sts3215.yaml), 1 Mbaud: no watchdog, no clock, a check sum of\n"
        "one byte. What ends with the loop alive is tried; a host or a cable that is gone is the keeper's, in\n"
        "`tests/backends/servo/test_servo_keeper.py`, or nobody's."
    ),
    base="servo-sts3215.yaml",
)
SERVOS = (SERVO, SERVO_FEETECH)
PLAIN = (CHIP, BOARD, MODBUS)
OTHERS = (
    CHIP_RELAY,
    BOARD_RELAY,
    SEPARATE,
    TCP,
    BARE,
    CHIP_STROKES,
    PICO,
    CHIP_ENCODER,
    PICO_ENCODER,
    *SERVOS,
)  # which differ from these in the link, in the board or the sensor, or in where the test runs
BACKENDS = PLAIN + OTHERS
