"""The bench around the motor: potentiometer or encoder, drive stage, mechanical stops, wiring faults.

The emulated board has the same bench in C (firmware/boards/host/bench.c). A test compares the two.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.model.real_motor import Frame, MovingMotor, RealMotor

DriveWiring = Literal["ok", "reversed", "dead", "stuck_on"]
SensorWiring = Literal["ok", "reversed", "broken_low", "broken_high", "stuck", "jumped", "noisy", "still", "still_a"]

_LEAST_SHARE = 1e-6  # of the time connected: its braking is beyond any measurement
NOISY_COUNTS = 25.0  # standard deviation that a "noisy" sensor adds to its own noise


@dataclass(frozen=True)
class BenchParameters:
    """The true parameters of a simulated bench.

    motor            plant, friction and bias
    start_rad        position of the shaft at the start
    stop_rad         mechanical stops (low, high); the velocity is zero at a stop
    rad_per_count, centre_counts, counts_max, noise_rad, offset_rad   potentiometer and ADC
    encoder          the position is an encoder's: ``rad_per_count`` of a quarter of its period, and no other key of the
                     potentiometer but ``offset_rad``; it has no noise and no end
    end_rad          (low, high): beyond them an end switch is open; None: there are none
    estop_open_s     an encoder's board alone: for so long from power on the e-stop is open, as when a hand tries it
    supply_V, drive_counts   motor supply, and the counts of full duty
    bridge_drop_V    lost in the bridge while it drives
    dead_band_plus, dead_band_minus   duty up to which the bridge gives 0 V, for positive and for negative counts
    coasting         the bridge lets the motor run free while PWM is low; then it has no parts (see ``coasting``)
    reversed         positive counts turn the shaft to falling positions
    tachometer_rad_s_per_count, tachometer_zero_counts, gear_ratio   velocity channel; None where there is none
    drive, sensor    their wiring: "ok" or a fault
    drive_delay_s    from the pin to the motor; no device sees it
    fault_after_s    time from the first arming until the wiring faults begin
    real, frame      the motor with its parts, which moves instead of ``motor``, and what they refer to; drift runs from
                     the first arming. None: it has no parts
    """

    motor: Motor
    start_rad: float = 0.0
    stop_rad: tuple[float, float] = (-2.6, 2.6)
    rad_per_count: float = 4.2 / 1024
    centre_counts: float = 512.0
    counts_max: int = 1023
    noise_rad: float = 0.0
    offset_rad: float = 0.0
    encoder: bool = False
    end_rad: tuple[float, float] | None = None
    estop_open_s: float = 0.0
    supply_V: float = 12.0
    drive_counts: int = 799
    bridge_drop_V: float = 0.0
    dead_band_plus: float = 0.0
    dead_band_minus: float = 0.0
    coasting: bool = False
    reversed: bool = False
    tachometer_rad_s_per_count: float | None = None
    tachometer_zero_counts: float = 0.0
    gear_ratio: float = 1.0
    drive: DriveWiring = "ok"
    sensor: SensorWiring = "ok"
    drive_delay_s: float = 0.0
    fault_after_s: float = 0.0
    real: RealMotor | None = None
    frame: Frame = field(default=Frame())


def coasting(motor: Motor, share: float) -> Motor:
    """The motor behind a bridge that connects it for a ``share`` of the time, 0 to 1, and else lets it run free.

    An example is an L298 with PWM on its enable. While the motor runs free no current flows, so nothing but friction
    brakes it. The current is taken to end with the pulse. Then the mean of the motion is, with the supply's U,
    tau dv/dt = share (K U - v) - K f(v): a motor with tau / share and f / share under U.
    """
    share = max(share, _LEAST_SHARE)
    f = motor.friction
    friction = Friction(
        f.plus_V / share,
        f.minus_V / share,
        f.static_plus_V / share,
        f.static_minus_V / share,
        f.stribeck_rad_s,
        f.viscous_V_s_rad / share,
    )
    return Motor(motor.tau_s / share, motor.K_rad_s_V, friction, motor.bias_V / share)


class BenchModel:
    """The bench in motion: set the drive, let time pass, read the sensors."""

    def __init__(self, parameters: BenchParameters, seed: int) -> None:
        self.parameters = parameters
        self.state = State(y=parameters.start_rad)
        real = parameters.real
        self._real = None if real is None else MovingMotor(real, parameters.frame, parameters.start_rad)
        self.pin_counts = 0.0  # drive at the pin, counts of full duty; not whole behind a finer converter
        self.armed_for_s = -1.0  # time since the first arming; negative before it
        self._moved_for_s = 0.0  # time since the start
        self._coming: deque[tuple[float, float]] = deque()  # pin's changes on their way: when they reach the motor
        self._sent_counts = self._arrived_counts = 0.0
        self._noise = random.Random(seed)
        self._stuck_counts: int | None = None

    def arm(self) -> None:
        """Start the clock of ``fault_after_s``, at the first arming only."""
        self.armed_for_s = max(self.armed_for_s, 0.0)

    @property
    def faulty(self) -> bool:
        """Whether wiring faults are in force now."""
        return self.armed_for_s >= self.parameters.fault_after_s

    @property
    def acting_counts(self) -> float:
        """The drive that has come from the pin to the bridge, counts of full duty."""
        return self._arrived_counts if self.parameters.drive_delay_s > 0.0 else self.pin_counts

    @property
    def bridge_V(self) -> float:
        """Output of the bridge for the drive that has come to it, V; positive towards rising positions."""
        p, counts = self.parameters, self.acting_counts
        dead = p.dead_band_plus if counts > 0.0 else p.dead_band_minus
        passed = (abs(counts) / p.drive_counts - dead) / (1.0 - dead)
        if counts == 0.0 or passed <= 0.0:
            return 0.0
        volts = passed * (p.supply_V - p.bridge_drop_V)
        return volts if (counts > 0.0) != p.reversed else -volts

    @property
    def motor_V(self) -> float:
        """Voltage at the motor for the drive that has come to the bridge, with the wiring faults."""
        volts = self.bridge_V
        wiring = self.parameters.drive if self.faulty else "ok"
        if wiring == "reversed":
            return -volts
        if wiring == "dead":
            return 0.0
        if wiring == "stuck_on":
            return 0.25 * self.parameters.supply_V
        return volts

    def advance(self, dt_s: float) -> None:
        """Let ``dt_s`` pass with the drive at the pin unchanged."""
        begins_in = self.parameters.fault_after_s - self.armed_for_s
        if self.armed_for_s >= 0.0 and 0.0 < begins_in < dt_s:
            self._pass(begins_in)
            dt_s -= begins_in
        self._pass(dt_s)

    def _pass(self, dt_s: float) -> None:
        for span_s in self._between_drives(dt_s):
            self._move(span_s)

    def _between_drives(self, dt_s: float) -> Iterator[float]:
        """The parts of ``dt_s``, s, in each of which one drive acts; the next drive acts after each of them."""
        if self.parameters.drive_delay_s <= 0.0:
            yield dt_s
            return
        if self.pin_counts != self._sent_counts:
            self._sent_counts = self.pin_counts
            self._coming.append((self._moved_for_s + self.parameters.drive_delay_s, self.pin_counts))
        end_s = self._moved_for_s + dt_s
        while self._coming and self._coming[0][0] <= end_s:
            due_s, counts = self._coming.popleft()
            yield max(due_s - self._moved_for_s, 0.0)
            self._moved_for_s, self._arrived_counts = max(due_s, self._moved_for_s), counts
        yield end_s - self._moved_for_s
        self._moved_for_s = end_s

    def _move(self, dt_s: float) -> None:
        p = self.parameters
        if p.coasting:
            share = max(abs(self.motor_V) / (p.supply_V - p.bridge_drop_V), _LEAST_SHARE)
            state = coasting(p.motor, share).advance(self.state, self.motor_V / share, dt_s)
        elif self._real is None:
            state = self.parameters.motor.advance(self.state, self.motor_V, dt_s)
        else:
            self._real.put(self.state.v, self.state.y)
            self._real.advance(self.motor_V, max(self.armed_for_s, 0.0), dt_s)
            state = State(self._real.state.v, self._real.state.y, self.state.z)
        low, high = p.stop_rad
        if not low < state.y < high:
            state = State(0.0, min(max(state.y, low), high), state.z)
            if self._real is not None:
                self._real.stop_at(state.y)
        self.state = state
        if self.armed_for_s >= 0.0:
            self.armed_for_s += dt_s

    @property
    def shaft_rad(self) -> float:
        """Where the measured shaft really is: behind the backlash, rad."""
        if self._real is None:
            return self.state.y
        self._real.put(self.state.v, self.state.y)
        return self._real.state.x

    @property
    def sensed_rad(self) -> float:
        """Position as an ideal sensor reads it: behind the backlash, and with its linearity, rad."""
        if self._real is None:
            return self.state.y
        self._real.put(self.state.v, self.state.y)
        return self._real.reading_rad

    def read_counts(self) -> int:
        """Reading of the position's ADC, 0 to counts_max; of an encoder, any whole number."""
        p = self.parameters
        wiring = p.sensor if self.faulty else "ok"
        if p.encoder:
            return self._encoder_counts(wiring)
        if wiring == "broken_low":
            return 0
        if wiring == "broken_high":
            return p.counts_max
        if wiring == "stuck" and self._stuck_counts is not None:
            return self._stuck_counts
        noise_rad = p.noise_rad + (NOISY_COUNTS * abs(p.rad_per_count) if wiring == "noisy" else 0.0)
        y = self.sensed_rad + p.offset_rad + self._noise.gauss(0.0, 1.0) * noise_rad
        offset_counts = y / p.rad_per_count
        if wiring == "reversed":
            offset_counts = -offset_counts
        counts = min(max(math.floor(p.centre_counts + offset_counts + 0.5), 0), p.counts_max)
        if wiring == "jumped":  # across its dead zone: a quarter of the range farther, modulo the range
            counts = (counts + (p.counts_max + 1) // 4) % (p.counts_max + 1)
        self._stuck_counts = counts if wiring == "stuck" else None
        return counts

    def _encoder_counts(self, wiring: SensorWiring) -> int:
        offset_counts = (self.sensed_rad + self.parameters.offset_rad) / self.parameters.rad_per_count
        counts = math.floor((-offset_counts if wiring == "reversed" else offset_counts) + 0.5)
        if wiring not in ("stuck", "still", "still_a"):
            self._stuck_counts = None
            return counts + 2 if wiring == "jumped" else counts
        if self._stuck_counts is None:
            self._stuck_counts = counts
        if wiring == "stuck":
            return self._stuck_counts
        return self._stuck_counts + ((counts - self._stuck_counts) // 2) % 2  # to and fro over one edge

    def read_tachometer_rad_s(self) -> float:
        """Velocity of the measured shaft, quantised, rad/s; nan without a velocity channel."""
        p = self.parameters
        if p.tachometer_rad_s_per_count is None:
            return math.nan
        counts = round(self.state.v * p.gear_ratio / p.tachometer_rad_s_per_count)
        return counts * p.tachometer_rad_s_per_count / p.gear_ratio
