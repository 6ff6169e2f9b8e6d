"""The schema of an experiment: every key, its unit (in its name), its range and its default.

Strict: an unknown key is an error, numbers are finite, objects are frozen.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Interval = tuple[float, float]
Method = Literal["sampled-data", "triple-relay", "describing-function"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Daq(_Section):
    """The link to the bench."""

    driver: Literal["simulated", "serial"] = Field(description="which driver: a simulation in virtual time, or a serial device")
    port: str | None = Field(
        None, description="serial port such as /dev/ttyACM0, or `emulated`: start the device of section `emulated`"
    )
    baud: Annotated[int, Field(ge=9600, le=4_000_000)] = 115200
    timeout_s: Positive = Field(0.03, description="longest wait for one reply")
    open_timeout_s: Positive = Field(5.0, description="longest wait for the device to introduce itself")
    watchdog_s: Annotated[float, Field(gt=0, le=1.0)] = Field(0.1, description="host silence before the device sets 0 V")
    accept_no_watchdog: bool = Field(False, description="drive a device that has no watchdog")


class CalibrationPoint(_Section):
    """One pair of raw counts and position."""

    counts: Annotated[int, Field(ge=0, le=65535)]
    rad: float


class Sensor(_Section):
    """The potentiometer: counts to rad."""

    counts_max: Annotated[int, Field(ge=15, le=65535)] = Field(1023, description="largest reading of the ADC")
    calibration: Annotated[tuple[CalibrationPoint, ...], Field(min_length=2)] = Field(
        description="two points or a table, rising or falling; interpolated linearly"
    )
    rail_counts: tuple[int, int] = Field((5, 1018), description="readings at or beyond these are a broken wire")


class DeadBand(_Section):
    """Duty below which the bridge passes nothing, by direction."""

    plus: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    minus: Annotated[float, Field(ge=0, lt=0.5)] = 0.0


class Drive(_Section):
    """The H-bridge: V to duty."""

    supply_V: Positive = Field(description="motor supply; K and f_c scale with it")
    bridge_drop_V: NonNegative = Field(0.0, description="lost in the bridge while driving (an L298: about 2 V)")
    dead_band_duty: DeadBand = DeadBand()
    max_V: Positive = Field(description="largest drive that anything may command")
    reversed: bool = Field(False, description="positive duty turns the shaft to falling positions")


class Tachometer(_Section):
    """A velocity channel on the motor's side of the gear."""

    rad_s_per_count: float = Field(description="motor velocity for one count, sign included")
    zero_counts: float = 0.0
    gear_ratio: Positive = Field(1.0, description="motor velocity over shaft velocity")


class TravelLimits(_Section):
    """Where the shaft may be."""

    soft_rad: Interval = Field(description="[low, high]: beyond, only inward drive passes")
    hard_rad: Interval = Field(description="[low, high]: beyond, 0 V and a latched fault")
    max_speed_rad_s: Positive = Field(description="largest speed of the shaft to expect")
    coast_tau_s: Positive = Field(description="longest velocity time constant to expect, for the stopping distance")


class Breakaway(_Section):
    """The check before any relay: a slow ramp each way until the shaft moves."""

    ramp_V_s: Positive = 0.4
    max_V: Positive = 2.0
    motion_rad: Positive = Field(0.02, description="displacement that counts as motion")
    rest_s: Positive = Field(0.4, description="rest before and between the ramps, and for measuring the noise")


class Gains(_Section):
    """Gains of the dual-channel relay."""

    h1_V: Positive
    h2_V: Positive


class RelayTarget(_Section):
    """The limit cycle that the gain search aims for."""

    amplitude_rad: Positive
    period_s: Positive
    tolerance: Annotated[float, Field(gt=0.01, le=0.5)] = Field(0.15, description="relative error of both that is good enough")


class GainSearch(_Section):
    """How the gains are found (theory section 5)."""

    h1_start_V: Positive = 0.3
    h2_start_V: Positive = 0.1
    h2_step_V: Positive = 0.15
    step_s: Positive = Field(0.6, description="time given to each h2 before it is raised")
    h_max_V: Positive = Field(3.0, description="largest h1 and largest h2")
    timeout_s: Positive = 40.0


class Relay(_Section):
    """The relay experiment: gains given, or searched for a target."""

    target: RelayTarget | None = None
    gains: Annotated[tuple[Gains, ...], Field(min_length=1, max_length=4)] | None = Field(
        None, description="one relay test for each pair; without it the gains are searched"
    )
    second_ratio: Annotated[float, Field(gt=0.3, lt=3.0)] = Field(
        0.75, description="searched gains: the second test's amplitude over the first's, period kept"
    )
    cycles: Annotated[int, Field(ge=3, le=200)] = Field(12, description="settled cycles recorded in each test")
    search: GainSearch = GainSearch()

    @model_validator(mode="after")
    def _target_or_gains(self) -> Self:
        if (self.target is None) == (self.gains is None):
            raise ValueError("give either `target` (gains are searched) or `gains`, not both and not neither")
        return self


class Sine(_Section):
    """One component of the tracking trajectory."""

    amplitude_rad: float
    omega_rad_s: Positive


class Tracking(_Section):
    """The check by feedback linearisation, (33)-(35)."""

    duration_s: Annotated[float, Field(gt=1)] = 6.0
    k1_1_s: Positive = Field(12.0, description="k1 of (34), 1/s")
    k2_1_s2: Positive = Field(36.0, description="k2 of (34), 1/s^2")
    friction_sign: Literal["reference", "estimate"] = Field(
        "reference", description="velocity whose sign the friction compensation takes; `estimate` is the paper's"
    )
    trajectory: Annotated[tuple[Sine, ...], Field(min_length=1)]
    methods: tuple[Method, ...] = ("sampled-data", "triple-relay", "describing-function")


class EmulatedMotor(_Section):
    """The true motor behind an emulated or simulated device."""

    tau_s: Positive
    K_rad_s_V: Positive
    fc_plus_V: NonNegative
    fc_minus_V: NonNegative
    fs_plus_V: NonNegative | None = Field(None, description="static friction; default: as the moving friction")
    fs_minus_V: NonNegative | None = None
    bias_V: float = 0.0
    start_rad: float = 0.0
    stop_rad: Interval = Field((-2.6, 2.6), description="mechanical stops, where the shaft is stopped dead")


class EmulatedPotentiometer(_Section):
    """The true potentiometer."""

    rad_per_count: float = Field(4.2 / 1024, description="negative: readings fall with position")
    centre_counts: float = Field(512.0, description="reading at position 0 (with offset_rad 0)")
    counts_max: Annotated[int, Field(ge=15, le=65535)] = 1023
    noise_rad: NonNegative = Field(0.0, description="standard deviation of white noise before quantisation")
    offset_rad: float = 0.0


class EmulatedWiring(_Section):
    """Faults that the emulated bench is built with."""

    drive: Literal["ok", "reversed", "dead", "stuck_on"] = "ok"
    sensor: Literal["ok", "reversed", "broken_low", "broken_high", "stuck"] = "ok"
    fault_after_s: NonNegative = Field(0.0, description="device time from arming until drive and sensor faults begin")


class Emulated(_Section):
    """The emulated bench: what is really behind `driver: simulated` or `port: emulated`."""

    motor: EmulatedMotor
    potentiometer: EmulatedPotentiometer = EmulatedPotentiometer()
    supply_V: Positive = 12.0
    drive_counts: Annotated[int, Field(ge=50, le=32767)] = Field(799, description="PWM counts at full duty")
    latency_s: NonNegative = Field(0.0012, description="simulated: mean time from sample to effect of the drive")
    latency_jitter_s: NonNegative = Field(0.0003, description="simulated: uniform half-width around the mean")
    clock_error_ppm: Annotated[float, Field(ge=-20000, le=20000)] = Field(
        0.0, description="device clock against the host's (a ceramic resonator: 5000)"
    )
    tachometer: bool = Field(False, description="has a velocity channel, scaled as in section tachometer")
    wiring: EmulatedWiring = EmulatedWiring()


class Experiment(_Section):
    """One experiment, whole."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=40)] = Field(
        description="lower case; becomes part of the run folder's name"
    )
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = Field(1, description="of emulated noise")
    period_s: Annotated[float, Field(ge=0.0005, le=0.1)] = Field(0.01, description="the loop's period")
    daq: Daq
    sensor: Sensor
    drive: Drive
    tachometer: Tachometer | None = None
    limits: TravelLimits
    breakaway: Breakaway = Breakaway()
    relay: Relay
    tracking: Tracking | None = Field(None, description="leave out to skip the tracking check")
    emulated: Emulated | None = None
