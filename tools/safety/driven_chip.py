"""An emulated board that drives a shaft at a steady speed, kept at it by a host's loop or by a law in the device.

The bench, its limits and its largest speed are those of config/demo.yaml, for the Pico of demo-pico.yaml; the
potentiometer has no offset, so that a limit is where it reads.
"""

from __future__ import annotations

import math
import random
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

from emulated_chips.pico_parameters import pico_parameters
from emulated_chips.truth import ChipTruth, UnoTruth
from emulated_chips.virtual_chip import VirtualChip
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.backend import truth_of
from rig.backends.serial.driver import setup_for
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.frames import (
    MAX_STROKE_TICKS,
    STATUS_FAULT,
    Code,
    DeviceState,
    FrameReader,
    Kind,
    Packet,
    RelaySetup,
    Setup,
    StrokesSetup,
    encode,
    pack_ack,
    pack_arm,
    pack_drive,
    pack_zero,
)
from rig.config.schema import Experiment
from rig.core.calibration import ALL_COUNTS, Calibration, DriveMap
from rig.model.bench import BenchParameters
from rig.running.preflight import check

TICK_S = 1e-3
SESSION = 1
COUNTS_PER_TURN = 3200  # of an encoder instead of the potentiometer

_FLOOD_S = 2e-3  # of garbage a write
_ASK_S = 0.05
_START_RAD = 0.9
_HAND_S = 0.2  # for the encoder of a shaft that is put elsewhere: it turns by 20,000 edges a second
_LARGEST_Z = 2**30

Board = Literal["uno", "pico"]
Where = Literal["host", "device", "strokes"]
Voice = Literal["drives", "reads", "garbage", "none"]


class Stand(NamedTuple):
    """What a board drives, and the limits that it is told.

    full  units of its drive at full duty
    """

    board: Board
    experiment: Experiment
    full: int
    curve: Calibration
    bench: BenchParameters
    setup: Setup

    def limit_rad(self, direction: int) -> float:
        """Where the reading passes the hard limit, rad, without noise."""
        last = self.setup.hard_hi + 0.5 if direction > 0 else self.setup.hard_lo - 0.5
        return self.curve.to_rad(last)

    def steady(self, direction: int) -> tuple[int, float]:
        """The largest drive that keeps the shaft below limits.max_speed_rad_s, units, and its speed, rad/s.

        Both are signed.
        """
        motor = self.bench.motor
        friction_V = motor.friction.plus_V if direction > 0 else motor.friction.minus_V
        against_V = friction_V - direction * motor.bias_V
        unit_V = self.bench.supply_V / self.full
        units = math.floor((self.experiment.limits.max_speed_rad_s / motor.K_rad_s_V + against_V) / unit_V)
        return direction * units, direction * motor.K_rad_s_V * (units * unit_V - against_V)


def _stand(board: Board, config: str, full: int) -> Stand:
    e = check(Path(__file__).resolve().parents[2] / "config" / config)[0]
    truth = truth_of(e.device)
    assert truth is not None
    drive_map = DriveMap(e.drive.supply_V, full_units=full)
    setup = setup_for(e.device.arming, e.sensor.curve, drive_map, e.sensor.rails, SESSION)
    return Stand(board, e, full, e.sensor.curve, replace(truth, offset_rad=0.0), setup)


def _with_encoder(stand: Stand) -> Stand:
    e = stand.experiment
    curve = Calibration([(0, 0.0), (COUNTS_PER_TURN, math.tau)])
    drive_map = DriveMap(e.drive.supply_V, full_units=stand.full)
    bench = replace(
        stand.bench, encoder=True, rad_per_count=math.tau / COUNTS_PER_TURN, centre_counts=0.0, noise_rad=0.0
    )
    return stand._replace(
        curve=curve, bench=bench, setup=setup_for(e.device.arming, curve, drive_map, ALL_COUNTS, SESSION)
    )


UNO = _stand("uno", "demo.yaml", 400)
PICO = _stand("pico", "demo-pico.yaml", 6250)
UNO_ENCODER, PICO_ENCODER = _with_encoder(UNO), _with_encoder(PICO)
PERIOD_S = UNO.experiment.period_s
WATCHDOG_S = UNO.experiment.device.arming.watchdog_s


class Way(NamedTuple):
    """How the chip is driven.

    where   what drives: the host (DRIVE each 10 ms), the relay in the device (RELAY, and KEEP each 10 ms) or the
            strokes in it (STROKES, and KEEP)
    floods  the host fills the wire with garbage besides
    noisy   the potentiometer has the demo's noise
    full    with drive.max_V, else with the drive that keeps the speed
    stand   the board, and the bench behind it
    """

    where: Where = "host"
    baud: int = 115200
    floods: bool = False
    bridge: str = "PWM_DIR"
    end_switches: bool = False
    noisy: bool = True
    full: bool = False
    stand: Stand = UNO

    @property
    def encoder(self) -> bool:
        """Whether it counts an encoder instead of converting a potentiometer's voltage."""
        return self.stand.bench.encoder


class DrivenChip:
    """One chip, driven again and again.

    heard_s  when the last frame that keeps the drive alive had arrived whole
    """

    def __init__(self, way: Way, rng: random.Random) -> None:
        self.way = way
        options = Variant(bridge=way.bridge, baud=way.baud, end_switches=way.end_switches, encoder=way.encoder)
        self.stand = way.stand
        bench = self.stand.bench if way.noisy else replace(self.stand.bench, noise_rad=0.0)
        seed = rng.randrange(2**32)
        self.chip: VirtualChip | VirtualPico
        if self.stand.board == "uno":
            self.chip = VirtualChip(bench, seed, options=options)
        else:
            self.chip = VirtualPico(pico_parameters(bench, seed, options=options))
        self.heard_s = 0.0
        self.direction = 1
        self.speed_rad_s = 0.0
        self._rng = rng
        self._byte_s = 10.0 / way.baud
        self._free_s = 0.0  # of the wire
        self._next_s = 0.0
        self._units = 0
        self._seq = 0
        self.chip.sleep_until(0.01)

    # ------------------------------------------------------------------ wire

    def truth(self) -> ChipTruth:
        """What is the case at the pins and at the shaft."""
        return self.chip.truth()

    def write(self, data: bytes) -> None:
        """Bytes as they are."""
        self._free_s = max(self._free_s, self.chip.now_s()) + len(data) * self._byte_s
        self.chip.write(data)

    def wait_for_wire(self) -> None:
        """Until all has arrived, and the program has had time for it."""
        self.chip.sleep_until(max(self._free_s, self.chip.now_s()) + 5 * TICK_S)

    def send(self, kind: int, body: bytes = b"") -> int:
        """A frame; its number."""
        self._seq = (self._seq + 1) & 0xFFFF
        self.write(encode(kind, self._seq, body))
        return self._seq

    def ask(self, kind: int, body: bytes = b"") -> Packet:
        """A frame, and the answer to it. Raises RuntimeError without one."""
        while self.chip.read(0.0):
            pass
        seq = self.send(kind, body)
        reader = FrameReader()
        until_s = self.chip.now_s() + _ASK_S
        while (left_s := until_s - self.chip.now_s()) > 0.0:
            for packet in reader.feed(self.chip.read(left_s)):
                if packet.seq == seq and packet.kind != Kind.BLOCK:
                    return packet
        raise RuntimeError(f"the chip does not answer {Kind(kind).name}")

    def keep_alive(self) -> None:
        """The frame that the drive lives by."""
        if self.way.where == "host":
            self.send(Kind.DRIVE, pack_drive(self._units))
        else:
            self.send(Kind.KEEP)
        self.heard_s = self._free_s

    # ------------------------------------------------------------------ driving

    def start(self, direction: int, start_rad: float | None = None) -> None:
        """Arm, drive, and give the shaft the speed of ``steady``, at ``start_rad`` (default: far inside)."""
        self.direction = direction
        self._units, self.speed_rad_s = self.stand.steady(direction)
        if self.way.full:
            self._units = direction * self.stand.setup.max_drive
        far_rad = -direction * _START_RAD
        first_rad = start_rad if self.way.encoder and start_rad is not None else far_rad
        self.chip.place(first_rad)
        self.chip.sleep_until(self.chip.now_s() + (_HAND_S if self.way.encoder else 5 * TICK_S))
        self.arm()
        if self.way.where == "device":
            self._start_relay()
        elif self.way.where == "strokes":
            self._start_strokes()
        self.keep_alive()
        self._next_s = self.chip.now_s() + self._rng.uniform(0.2, 1.0) * PERIOD_S
        self.chip.sleep_until(self.chip.now_s() + 5 * TICK_S)
        if self.truth().pin_V == 0.0:
            raise RuntimeError("the chip does not drive")
        self.chip.place(far_rad if start_rad is None else start_rad, self.speed_rad_s)

    def arm(self) -> None:
        """Stop, set the limits, arm. Raises RuntimeError where it refuses."""
        state = DeviceState.unpack(self.ask(Kind.STOP).body)
        while state.status & STATUS_FAULT:
            state = DeviceState.unpack(self.ask(Kind.ACK, pack_ack(state.fault)).body)
        if self.ask(Kind.SETUP, self.stand.setup.pack()).kind != Kind.SETUP_REPLY:
            raise RuntimeError("the chip does not take the limits")
        if self.way.encoder:
            self.ask(Kind.ZERO, pack_zero(math.floor(self.stand.curve.to_counts(self.truth().y_rad) + 0.5)))
        if self.ask(Kind.ARM, pack_arm(SESSION)).body[0] != Code.NONE:
            raise RuntimeError("the chip does not arm")

    def _start_relay(self) -> None:
        """A relay that drives outward as long as the integral has not followed the position: beyond the limit."""
        u, centre = self._units, self.stand.setup.hard_hi if self.direction > 0 else self.stand.setup.hard_lo
        drive = (-u, u, -u, u) if self.direction > 0 else (u, -u, u, -u)
        if self.ask(Kind.RELAY, RelaySetup(drive, 16 * centre, _LARGEST_Z, 1, 10).pack()).kind != Kind.RELAY_REPLY:
            raise RuntimeError("the chip does not start the relay")

    def _start_strokes(self) -> None:
        """A stroke outward up to the limit; the way back is never driven."""
        u, low, high = self._units, self.stand.setup.hard_lo, self.stand.setup.hard_hi
        to, fro = (high, low) if self.direction > 0 else (low, high)
        strokes = StrokesSetup(((u, to), (-u, fro)), MAX_STROKE_TICKS, MAX_STROKE_TICKS, 5, 10)
        if self.ask(Kind.STROKES, strokes.pack()).kind != Kind.STROKES_REPLY:
            raise RuntimeError("the chip does not start the strokes")

    def go_on(self, until_s: float, voice: Voice = "drives") -> None:
        """Let time pass while the host's loop goes on: drives, reads alone, sends nothing but garbage, or is silent."""
        if voice == "none":
            self.chip.sleep_until(until_s)
            return
        floods = self.way.floods or voice == "garbage"
        while self._next_s < until_s:
            self.chip.sleep_until(self._next_s)
            if voice == "drives":
                self.keep_alive()
            if floods:
                left_s = self._next_s + _FLOOD_S - self._free_s
                self.write(b"\0" + self._rng.randbytes(max(int(left_s / self._byte_s) - 2, 0)) + b"\0")
            elif voice == "reads" or self.way.where == "host":
                self.send(Kind.READ)
            self.chip.read(0.0)
            self._next_s += _FLOOD_S if floods else PERIOD_S
        self.chip.sleep_until(until_s)

    def is_sound(self) -> bool:
        """Whether the program has neither left its code nor broken a rule of the data sheet. The chip's last act."""
        truth = self.truth()
        kept = self.chip.broken_rule() == "" and not (isinstance(truth, UnoTruth) and truth.crashed)
        if isinstance(self.chip, VirtualPico):
            self.chip.end()
        return kept

    def stop(self) -> None:
        """Off, and all that has been broken is whole again."""
        self.chip.rewire()
        for contact in ("e_stop", "end_low", "end_high"):
            self.chip.contact(contact, is_open=False)
        self.wait_for_wire()
        self.write(b"\0")
