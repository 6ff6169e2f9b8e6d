"""The schema of an experiment: every key, its unit (in its name), its range and its default.

Strict: an unknown key is an error, numbers are finite, objects are frozen. The schema checks each key by itself;
``rig.running.preflight.rules`` checks keys together (room to stop, link budget, ...).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar, get_args

from pydantic import (
    AfterValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    create_model,
    field_validator,
    model_serializer,
    model_validator,
)

from rig.backends.modbus.section import ModbusKeys
from rig.backends.serial.section import SerialKeys
from rig.backends.servo.section import ServoKeys
from rig.core.calibration import (
    ALL_COUNTS,
    CALIBRATION_ERROR_RAD,
    LINEARITY_PERCENT,
    NO_TRAVEL_LIMITS,
    SUPPLY_ERROR_PERCENT,
    Calibration,
    DriveMap,
    Scaling,
    TachometerScale,
)
from rig.core.estimators import ESTIMATORS
from rig.core.motor_numbers import NUMBERS, PARTS, Number, of_every_bench
from rig.core.section import Interval, NonNegative, Positive, not_zero
from rig.core.section import Section as _Section
from rig.core.signals import Limits

if TYPE_CHECKING:
    Method = str
else:
    Method = Literal[tuple(entry.name for entry in ESTIMATORS if entry.finds_motor)]
"""An estimator whose model can track."""
Bridge = Literal["pwm-dir", "in1-in2"]
BRIDGES: tuple[Bridge, ...] = get_args(Bridge)


class Link(_Section):
    """Which device, and where it is."""

    driver: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=40)] = Field(
        description="which driver: `simulated`, in virtual time; `serial`, a device with rig's firmware on a serial "
        "port; `modbus`, a Modbus device; `servo`, a smart servo; or the name of a plug-in that is installed",
        examples=["simulated", "serial", "modbus", "servo"],
    )
    port: str | None = Field(
        None,
        description="serial port such as /dev/ttyACM0; or the device of section `emulated`, in virtual time: "
        "`emulated`, or firmware on its emulated chip, `emulated-chip` (the Uno's) or `emulated-pico`. For modbus: "
        "/dev/ttyUSB0 (RTU) or tcp://host:502; `emulated` (RTU) or `emulated-tcp`. With `-realtime` behind it, each of "
        "these words is the same device in a process of its own, in real time",
    )
    usb_serial: Annotated[str, Field(pattern=r"^[!-~]([ -~]*[!-~])?$", max_length=126)] | None = Field(
        None,
        description="of a serial port on USB: the serial number of the board, or of its adapter, that this bench has; "
        "another one is refused. `rig init` and `rig calibrate` put it in. Default: any board at this port is taken",
    )
    baud: Annotated[int, Field(ge=9600, le=4_000_000)] = Field(
        115200, description="bits per second of the serial link, as the firmware was built"
    )


class LinkTimes(_Section):
    """How long host and device wait for each other."""

    timeout_s: Positive = Field(0.03, description="after it a reply is late: it is asked for again, or waited for")
    open_timeout_s: Positive = Field(5.0, description="longest wait for the device to introduce itself")
    watchdog_s: Annotated[float, Field(gt=0, le=1.0)] = Field(
        0.1, description="host silence before the device sets 0 V: `rig check` tells the longest that there is room for"
    )
    accept_no_watchdog: bool = Field(False, description="drive a device that has no watchdog")


class Daq(ServoKeys, ModbusKeys, LinkTimes, SerialKeys, Link):
    """The link to the bench."""

    # Its parts are read from right to left: a dumped config and the JSON Schema keep that order of keys.
    options: dict[str, Any] | None = Field(
        None, description="of a plug-in driver: whatever it asks for, see its own documentation"
    )


class LoopSection(_Section):
    """How the loop keeps its time. A run reports what the machine refuses."""

    spin_us: Annotated[float, Field(ge=0, le=1000)] = Field(
        200.0, description="last part of each wait that reads the clock instead of sleeping; 0: none"
    )
    priority: Annotated[int, Field(ge=0, le=99)] = Field(60, description="of SCHED_FIFO; 0: the ordinary scheduler")
    cpu: Annotated[int, Field(ge=0)] | None = Field(None, description="core to stay on; default: any")
    lock_memory: bool = Field(True, description="keep every page of the process in memory")
    pace: Annotated[float, Field(ge=1e-3, allow_inf_nan=False)] | None = Field(
        None,
        description="of a device in virtual time, for people who watch: seconds of its time in a second, 1 for that of "
        "a clock; default: as fast as the machine. `--pace` sets it",
    )
    raise_workers: bool = Field(
        False,
        description="for a busy machine, as root: let the kernel's workers that carry serial data go before all else",
    )
    law_cpu_s: Annotated[float, Field(gt=0, le=0.5)] | None = Field(
        None,
        description="CPU time that one step of a law of your own may take; not in virtual time; default: half a "
        "period, 2 ms at least",
    )


class CalibrationPoint(_Section):
    """One pair of raw counts and position."""

    counts: Annotated[int, Field(ge=0, le=65535)] = Field(description="raw reading of the ADC")
    rad: float = Field(description="position of the measured shaft there, rad; 0 is the centre of travel")


class HomeSwitch(_Section):
    """The end switch that `rig home` drives the shaft to."""

    end: Literal["low", "high"] = Field(description="where it is: at the low or at the high end of the positions")
    at_rad: float = Field(description="position at which it opens")
    u_V: Positive = Field(description="drive towards it: a little above the breakaway level")


class Encoder(_Section):
    """A quadrature encoder."""

    counts_per_turn: Annotated[int, Field(ge=4, le=10_000_000)] = Field(
        description="counts for one turn of the encoder's own shaft, all four edges of a period counted: four times "
        "the lines or pulses (PPR) of its data sheet"
    )
    gear: Positive = Field(1.0, description="turns of the encoder for one turn of the measured shaft")
    sign: Literal[1, -1] = Field(1, description="-1: the counts fall where the position rises (or swap A and B)")
    home: HomeSwitch | None = Field(
        None,
        description="end switch for `rig home`; default: by hand. Without travel limits zero is where a run starts",
    )

    @property
    def rad_per_count(self) -> float:
        """Of the measured shaft, with its sign."""
        return self.sign * 2.0 * math.pi / (self.counts_per_turn * self.gear)


_SERVO_COUNTS = 4096  # for a turn of its horn


class ServoSensor(_Section):
    """The sensor of a smart servo, 4096 counts a turn: an encoder that knows where it is."""

    sign: Literal[1, -1] = Field(1, description="-1: the counts fall where the position rises")
    zero_counts: Annotated[int, Field(ge=0, lt=_SERVO_COUNTS)] = Field(
        2048, description="position register at 0 rad, the centre of travel"
    )


_LARGEST_COUNTS = 1023
_RAILS = (5, 1018)


class Sensor(_Section):
    """The position sensor: a potentiometer, which `calibration` describes, an encoder, or a servo's own."""

    servo: ServoSensor | None = Field(None, description="a smart servo's own; it makes the section `encoder`")
    encoder: Encoder | None = Field(None, description="a quadrature encoder, instead of a potentiometer")
    counts_max: Annotated[int, Field(ge=15, le=65535)] | None = Field(
        None, description=f"largest reading of the ADC; default: {_LARGEST_COUNTS}"
    )
    calibration: Annotated[tuple[CalibrationPoint, ...], Field(min_length=2)] | None = Field(
        None, description="of a potentiometer: two points or a table, rising or falling; interpolated linearly"
    )
    rail_counts: tuple[int, int] | None = Field(
        None,
        description="[low, high]: readings of a potentiometer at or beyond these are a broken wire; default: "
        f"{list(_RAILS)}",
    )
    linearity_percent: Annotated[float, Field(ge=0, le=20)] = Field(
        LINEARITY_PERCENT,
        description="largest departure from a straight line by the data sheet, in % of the full range 0 to counts_max; "
        "the uncertainty u95 allows for it as far as the tests do not show it",
    )
    calibration_error_rad: Annotated[float, Field(ge=0, le=0.5)] = Field(
        CALIBRATION_ERROR_RAD,
        description="largest error of each angle of `calibration`: K scales with the radian, which no test shows; "
        "for u95_absolute",
    )

    @field_validator("calibration")
    @classmethod
    def _one_to_one(
        cls, points: tuple[CalibrationPoint, ...] | None, info: ValidationInfo
    ) -> tuple[CalibrationPoint, ...] | None:
        if points is None:
            return None
        counts_max = info.data.get("counts_max", math.inf) or _LARGEST_COUNTS
        table = sorted(points, key=lambda point: point.counts)
        if table[-1].counts > counts_max:
            raise ValueError(f"{table[-1].counts} counts is more than sensor.counts_max {counts_max}")
        rising = table[-1].rad > table[0].rad
        for a, b in pairwise(table):
            if a.counts == b.counts:
                raise ValueError(f"{a.counts} counts is given twice")
            if a.rad == b.rad or (b.rad > a.rad) != rising:
                raise ValueError(
                    "positions must only rise or only fall with counts, but not so between "
                    f"{a.counts} counts ({a.rad:g} rad) and {b.counts} counts ({b.rad:g} rad)"
                )
        return points

    @property
    def straight(self) -> tuple[float, float]:
        """Rad for each count, and the reading at 0 rad, of the straight line through the calibration's end points."""
        if self.encoder is not None:
            return self.encoder.rad_per_count, 0.0
        points = self.points
        (low, low_rad), (high, high_rad) = points[0], points[-1]
        return (high_rad - low_rad) / (high - low), low - low_rad * (high - low) / (high_rad - low_rad)

    @property
    def curve(self) -> Calibration:
        """Counts to rad."""
        return Calibration(self.points)

    @property
    def points(self) -> tuple[tuple[int, float], ...]:
        """Counts and rad of the calibration, counts rising; of an encoder: of its zero and one turn."""
        if self.encoder is not None:
            turn = round(self.encoder.counts_per_turn)
            return (0, 0.0), (turn, turn * self.encoder.rad_per_count)
        return tuple(sorted((point.counts, point.rad) for point in self.calibration or ()))

    @property
    def full_range_rad(self) -> float:
        """What the readings 0 to counts_max span, rad; of an encoder one turn of the measured shaft."""
        return 2.0 * math.pi if self.encoder is not None else self.curve.lsb_rad * (self.counts_max or 0)

    @property
    def range_rad(self) -> tuple[float, float]:
        """Positions within the calibration's points and between the rails, rad; (inf, -inf) where there are none.

        An encoder shows all positions: (-inf, inf).
        """
        if self.encoder is not None:
            return -math.inf, math.inf
        low, high = max(self.points[0][0], self.rails[0] + 1), min(self.points[-1][0], self.rails[1] - 1)
        if low > high:
            return math.inf, -math.inf
        a_rad, b_rad = self.curve.to_rad(low), self.curve.to_rad(high)
        return min(a_rad, b_rad), max(a_rad, b_rad)

    @property
    def rails(self) -> tuple[int, int]:
        """Readings at or beyond these are a broken sensor; an encoder has none."""
        return ALL_COUNTS if self.rail_counts is None else self.rail_counts

    @model_validator(mode="after")
    def _one_sensor(self) -> Self:
        if self.servo is not None:
            as_encoder = Encoder(counts_per_turn=_SERVO_COUNTS, sign=self.servo.sign)
            if self.encoder not in (None, as_encoder):  # a run's own config has both
                raise ValueError("a servo has its own encoder: give `servo` alone")
            object.__setattr__(self, "encoder", as_encoder)
        if self.encoder is None:
            if self.calibration is None:
                raise ValueError("needs `calibration`, of a potentiometer, `encoder`, or `servo`")
            for name, value in (("counts_max", _LARGEST_COUNTS), ("rail_counts", _RAILS)):
                if getattr(self, name) is None:
                    object.__setattr__(self, name, value)  # frozen: this is the one place that completes it
            return self
        given = [name for name in ("counts_max", "calibration", "rail_counts") if getattr(self, name) is not None]
        if given:
            raise ValueError(f"an encoder has no {' and no '.join(given)}: give `encoder` alone")
        for name in ("linearity_percent", "calibration_error_rad"):
            if name not in self.model_fields_set:
                object.__setattr__(self, name, 0.0)  # it divides its turn evenly
        return self

    @field_validator("rail_counts")
    @classmethod
    def _within_adc(cls, rails: tuple[int, int] | None, info: ValidationInfo) -> tuple[int, int] | None:
        if rails is None:
            return None
        low, high = rails
        counts_max = info.data.get("counts_max", 65535) or _LARGEST_COUNTS
        if not 0 <= low < high <= counts_max:
            raise ValueError(f"must be [low, high] with 0 <= low < high <= {counts_max}, not [{low}, {high}]")
        return rails


class DeadBand(_Section):
    """Duty below which the bridge passes nothing, by direction."""

    plus: Annotated[float, Field(ge=0, lt=0.5)] = Field(0.0, description="of positive duty, as a fraction of 1")
    minus: Annotated[float, Field(ge=0, lt=0.5)] = Field(0.0, description="of negative duty, as a fraction of 1")


class Drive(_Section):
    """The H-bridge: V to duty."""

    supply_V: Positive = Field(description="motor supply; K and f_c scale with it")
    supply_error_percent: Annotated[float, Field(ge=0, le=50)] = Field(
        SUPPLY_ERROR_PERCENT,
        description="largest error of supply_V, in %: K and f_c scale with the volt, which no test shows; "
        "for u95_absolute",
    )
    bridge: Bridge | None = Field(
        None,
        description="inputs of the bridge, which the firmware must be for: with the wrong one 0 V can be full drive; "
        "needed with a real serial port",
    )
    bridge_drop_V: NonNegative = Field(0.0, description="lost in the bridge while driving (an L298: about 2 V)")
    dead_band_duty: DeadBand = Field(DeadBand(), description="duty below which the bridge passes nothing")
    max_V: Positive = Field(description="largest drive that anything may command")
    reversed: bool = Field(False, description="positive duty turns the shaft to falling positions")

    @property
    def map(self) -> DriveMap:
        """V to drive units."""
        dead = self.dead_band_duty
        return DriveMap(self.supply_V, self.bridge_drop_V, dead.plus, dead.minus, self.reversed)


class Tachometer(_Section):
    """A velocity channel on the motor's side of the gear."""

    rad_s_per_count: float = Field(description="motor velocity for one count, sign included; not 0")
    zero_counts: float = Field(0.0, description="reading at rest")
    gear_ratio: Positive = Field(1.0, description="motor velocity over shaft velocity")

    @model_validator(mode="after")
    def _not_zero(self) -> Self:
        if self.rad_s_per_count == 0.0:
            raise ValueError("`rad_s_per_count` must not be 0")
        return self

    @property
    def scale(self) -> TachometerScale:
        """Counts to rad/s of the measured shaft."""
        return TachometerScale(self.rad_s_per_count, self.zero_counts, self.gear_ratio)


_BEFORE_THE_BOUND_RAD = math.pi  # half a turn


class TravelLimits(_Section):
    """Where the shaft may be, and how fast."""

    travel: Literal["none"] | None = Field(
        None,
        description="none: the shaft turns without end, and has an encoder; then no soft_rad and no hard_rad, and the "
        "device arms only after its e-stop has been tried",
    )
    turns: Annotated[float, Field(ge=2.0, le=100_000.0)] | None = Field(
        None,
        description="with `travel: none`: no farther than so many turns either way from where a command finds the "
        "shaft, for a cable that twists; beyond, 0 V and a latched fault, in the guard and in the device",
    )
    soft_rad: Interval = Field(NO_TRAVEL_LIMITS, description="[low, high]: beyond, only inward drive passes")
    hard_rad: Interval = Field(NO_TRAVEL_LIMITS, description="[low, high]: beyond, 0 V and a latched fault")
    max_speed_rad_s: Positive = Field(description="largest speed of the shaft to expect")
    coast_tau_s: Positive = Field(description="longest velocity time constant to expect, for the stopping distance")

    @property
    def is_endless(self) -> bool:
        """Whether there is no mechanical stop, and zero is where a command finds the shaft."""
        return self.travel == "none"

    @model_validator(mode="after")
    def _limits_or_none(self) -> Self:
        given = [name for name in ("soft_rad", "hard_rad") if getattr(self, name) != NO_TRAVEL_LIMITS]
        if self.is_endless and given:
            raise ValueError(f"`travel: none` leaves no {' and no '.join(given)}: give one or the other")
        if not self.is_endless and len(given) < 2:
            missing = [name for name in ("soft_rad", "hard_rad") if name not in given]
            raise ValueError(f"{' and '.join(missing)} missing; a shaft that turns without end has `travel: none`")
        return self

    @model_validator(mode="after")
    def _bound_in_turns(self) -> Self:
        """After ``_limits_or_none``, which looks at what is given: the bound becomes limits."""
        if self.turns is not None:
            if not self.is_endless:
                raise ValueError("`turns` bounds a shaft that turns without end: add `travel: none`")
            hard_rad = 2.0 * math.pi * self.turns
            soft_rad = hard_rad - _BEFORE_THE_BOUND_RAD
            object.__setattr__(
                self, "hard_rad", (-hard_rad, hard_rad)
            )  # frozen: this is the one place that completes it
            object.__setattr__(self, "soft_rad", (-soft_rad, soft_rad))
        return self

    @model_serializer(mode="wrap")
    def _without_infinity(self, to_data: SerializerFunctionWrapHandler) -> dict[str, object]:
        data: dict[str, object] = to_data(self)
        return {key: value for key, value in data.items() if not (self.is_endless and key in ("soft_rad", "hard_rad"))}


class MotorSection(_Section):
    """What the motor's data sheet says; the rest is identified."""

    no_load_speed_rad_s: Positive = Field(
        description="speed of the measured shaft at drive.supply_V without load, behind its gear; it bounds what the "
        "shaft travels where the sensor does not show it: rather too high than too low"
    )
    stall_torque_N_m: Positive | None = Field(
        None, description="of the measured shaft at drive.supply_V, held; section `load` needs it: rather too low"
    )


class LoadSection(_Section):
    """A mass on an arm on the measured shaft: what gravity does to it when nothing holds it."""

    mass_kg: Positive = Field(description="of arm and mass together")
    arm_m: Positive = Field(description="from the shaft's axis to their centre of mass")
    axis: Literal["horizontal", "vertical"] = Field(
        "horizontal", description="of the shaft; vertical: gravity turns nothing"
    )
    hangs: bool = Field(False, description="the arm hangs straight down at 0 rad: it falls to there, from either side")


class BreakawaySection(_Section):
    """The check before any relay: strokes to and fro, slowly stronger, until both have moved the shaft."""

    ramp_V_s: Positive = Field(0.4, description="how fast the drive of each way rises, V/s")
    max_V: Positive = Field(2.0, description="drive at which the check gives up; two to three times static friction")
    motion_rad: Positive = Field(0.02, description="displacement that counts as motion")
    rest_s: Annotated[float, Field(ge=0.1)] = Field(
        0.4, description="rest before and after the strokes, and for measuring the noise"
    )


class RelayGainsSection(_Section):
    """Gains of the dual-channel relay."""

    h1_V: Positive = Field(description="gain on the sign of the position")
    h2_V: Positive = Field(description="gain on the sign of its integral; above f_c, else there is no cycle")


class Hysteretic(_Section):
    """One run of the single relay with hysteresis, from rest at zero (docs/theory.md 5.1)."""

    d_V: Annotated[float, not_zero("it has to move the shaft from rest")] = Field(
        description="drive; its sign is the direction it starts in; above the breakaway level"
    )
    eps_rad: Positive = Field(description="half width of the hysteresis: it switches beyond this position")


_WITHOUT_UNTIL = ("target", "gains", "cycles", "second_ratio")


class RelayTarget(_Section):
    """The limit cycle that the gain search aims for."""

    amplitude_rad: Positive = Field(description="largest distance from the centre of travel")
    period_s: Positive = Field(description="period of the cycle; at least 30 periods of the loop")
    tolerance: Annotated[float, Field(gt=0.01, le=0.5)] = Field(
        0.15, description="relative error of both that is good enough"
    )


class GainSearchSection(_Section):
    """How the gains are found (docs/theory.md 4.2)."""

    h1_start_V: Positive = Field(0.3, description="first h1")
    h2_start_V: Positive = Field(0.1, description="first h2")
    h2_step_V: Positive = Field(0.15, description="by how much h2 is raised until a cycle appears")
    step_s: Positive = Field(0.6, description="time given to each h2 before it is raised")
    h_max_V: Positive = Field(3.0, description="largest h1 and largest h2")
    timeout_s: Positive = Field(90.0, description="longest search, for each test")


class UntilSection(_Section):
    """The tests end when the answer is known, and at the latest by two bounds (docs/until.md)."""

    interval_percent: Annotated[float, Field(ge=0.1, le=20.0)] = Field(
        0.4,
        description="half width of the 95 % interval of each of tau, K and f_c, in % of its value; with the default a "
        "plain motor is mostly ok, which asks for more than an interval",
    )
    longest_s: Annotated[float, Field(ge=5.0, le=3600.0)] = Field(
        60.0, description="the tests end after this time at the latest, whatever is known; the breakaway check is apart"
    )
    most_cycles: Annotated[int, Field(ge=3, le=10_000)] = Field(60, description="or after so many swings to and fro")
    model_doubt_percent: Annotated[float, Field(gt=0.0, le=100.0)] = Field(
        30.0, description="`rig run --model`: the motor is that model within so much of tau, K and f_c, in % (at 95 %)"
    )


class RelaySection(_Section):
    """The relay experiment: `until` the motor is known, for a target, or with given gains; or hysteretic runs."""

    until: UntilSection | None = Field(
        None, description="start without a target, and drive the tests that tell most until the answer is known"
    )
    target: RelayTarget | None = Field(None, description="search gains that give this limit cycle; or give `gains`")
    gains: Annotated[tuple[RelayGainsSection, ...], Field(min_length=1, max_length=4)] | None = Field(
        None, description="one relay test for each pair; without it the gains are searched"
    )
    where: Literal["host", "device"] = Field(
        "host",
        description="where the relay tests decide: in the host every period_s, or in the device every millisecond",
    )
    second_ratio: Annotated[float, Field(gt=0.3, lt=3.0)] = Field(
        0.75, description="searched gains: the second test's amplitude over the first's, period kept"
    )
    cycles: Annotated[int, Field(ge=3, le=200)] = Field(12, description="settled cycles recorded in each test")
    search: GainSearchSection = Field(
        GainSearchSection(), description="how the gains are searched, where there is a target"
    )
    hysteretic: Annotated[tuple[Hysteretic, ...], Field(min_length=2, max_length=8)] | None = Field(
        None, description="runs of a hysteretic relay for the least-squares method: two or more different d_V each way"
    )

    @field_validator("hysteretic")
    @classmethod
    def _drives_differ(cls, runs: tuple[Hysteretic, ...] | None) -> tuple[Hysteretic, ...] | None:
        for sign in (1.0, -1.0):
            drives = sorted(sign * run.d_V for run in runs or () if sign * run.d_V > 0.0)
            if len(drives) == 1:
                raise ValueError(f"one run alone with d_V of {sign * drives[0]:g} V: the method takes two of one sign")
            for a, b in pairwise(drives):
                if b - a < 0.05 * b:
                    raise ValueError(
                        f"d_V of {sign * a:g} and {sign * b:g} V do not differ enough: by 5 % at least, better by 20 %"
                    )
        return runs

    @model_validator(mode="after")
    def _what_to_run(self) -> Self:
        if self.until is not None:
            given = [f"`{key}`" for key in _WITHOUT_UNTIL if key in self.model_fields_set and getattr(self, key)]
            if given:
                raise ValueError(f"`until` chooses its tests by itself: remove {' and '.join(given)}")
            return self
        if self.target is not None and self.gains is not None:
            raise ValueError("give either `target` (gains are searched) or `gains`, not both")
        if self.target is None and self.gains is None and self.hysteretic is None:
            raise ValueError(
                "give `until` (the tests end when the answer is known), `target` (gains are searched), `gains`, or "
                "`hysteretic` (for least squares)"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_what_until_replaces(self, serialise: SerializerFunctionWrapHandler) -> dict[str, object]:
        """A dump loads back: it has no defaults of keys that ``until`` excludes."""
        written: dict[str, object] = serialise(self)
        if self.until is not None:
            for key in _WITHOUT_UNTIL:
                written.pop(key, None)
        return written

    @property
    def has_tests(self) -> bool:
        """Whether there are tests of the dual-channel relay, and not hysteretic runs alone."""
        return self.until is not None or self.target is not None or self.gains is not None


class SurveySection(_Section):
    """The survey: slow sweeps of the travel to and fro in a closed loop, for the friction map."""

    speeds_rad_s: Annotated[tuple[Positive, ...], Field(min_length=2, max_length=12)] | None = Field(
        None,
        description="speeds of the sweeps; default: five, from the slowest that the sensor resolves to the fastest "
        "that the travel allows",
    )
    longest_s: Annotated[float, Field(gt=0, le=3600)] = Field(120.0, description="all sweeps together, at most")


def _identified(stage: str) -> str:
    if not re.fullmatch(r"breakaway|search|survey|(relay|strokes)-[1-9][0-9]?", stage):
        raise ValueError(f"identification reads no stage {stage!r}: give breakaway, search, relay-1, relay-2, ...")
    return stage


IdentifiedStage = Annotated[str, AfterValidator(_identified)]


class IdentifySection(_Section):
    """How the motor is identified from what the run recorded."""

    thorough: bool = Field(
        False,
        description="where the relay tests do not tell two laws of the motor apart, or leave more than 2.5 % of "
        "uncertainty, `rig run` adds a survey and a relay test of a third amplitude",
    )
    without: tuple[IdentifiedStage, ...] = Field(
        (), description="stages that identification does not read: breakaway, search, relay-1, relay-2, ..."
    )


class Sine(_Section):
    """One component of the tracking trajectory."""

    amplitude_rad: float = Field(description="amplitude; negative: starts downwards")
    omega_rad_s: Positive = Field(description="angular frequency")


class TrackingSection(_Section):
    """The check by feedback linearisation, (33)-(35)."""

    duration_s: Annotated[float, Field(ge=2)] = Field(6.0, description="length of the check of each method")
    k1_1_s: Positive = Field(12.0, description="k1 of (34), 1/s")
    k2_1_s2: Positive = Field(36.0, description="k2 of (34), 1/s^2")
    friction_sign: Literal["reference", "estimate"] = Field(
        "reference", description="velocity whose sign the friction compensation takes; `estimate` is the paper's"
    )
    with_law: bool = Field(
        True, description="the leading estimator's model has the laws that the tests show; false: tau, K, f_c alone"
    )
    trajectory: Annotated[tuple[Sine, ...], Field(min_length=1)] = Field(
        description="the reference: a sum of sines about the centre of travel"
    )
    offset_rad: Annotated[float, Field(ge=-0.5, le=0.5)] = Field(
        0.0,
        description="the reference begins so far from the shaft: the report shows how the error dies away, measured "
        "and as (35) has it",
    )
    turn_rad_s: float = Field(
        0.0,
        description="without travel limits: the reference turns on at this speed, from where each check begins, with "
        "the sines on top",
    )
    methods: tuple[Method, ...] = Field(
        tuple(entry.name for entry in ESTIMATORS if entry.finds_motor),
        description="estimators whose models are compared, each on the same trajectory",
    )


class LawSection(_Section):
    """A law of a user's own, which a package offers as entry point of the group `rig.laws`."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=40)] = Field(
        description="by which the package offers it"
    )
    duration_s: Annotated[float, Field(gt=0, le=3600)] = Field(10.0, description="it ends then at the latest")
    options: dict[str, Any] = Field({}, description="whatever the law asks for, by name; see its own documentation")


def _key(number: Number) -> Any:
    """The key of a config for a number of the motor's table, which is 0 where it is left out."""
    bounds = {"gt" if number.above > -math.inf else "ge": number.of_benches, "lt": number.below}
    given: dict[str, Any] = {name: bound for name, bound in bounds.items() if math.isfinite(bound)}
    return float, Field(0.0, description=number.meaning, **given)


if TYPE_CHECKING:
    _PartsOfMotor = _Section
else:  # the friction that every emulated motor has is in its own section
    _keys = {name: _key(number) for name, number in NUMBERS.items() if not of_every_bench(name)}
    _PartsOfMotor = create_model("_PartsOfMotor", __base__=_Section, **_keys)


class EmulatedParts(_PartsOfMotor):
    """What a real motor has beyond tau, K and friction by direction (docs/theory.md 12.1); 0: it has not."""

    drift: Annotated[float, Field(ge=-1.0, le=1.0)] = Field(
        0.0, description="relative change of friction over drift_over_s, with the given friction in its middle"
    )
    drift_over_s: Positive = Field(60.0, description="time from arming that `drift` refers to")
    centre_rad: float = Field(0.0, description="middle of the travel that the parts over position refer to")
    half_travel_rad: Positive = Field(1.0, description="half the width of that travel")

    @model_validator(mode="after")
    def _shapes_are_there(self) -> Self:
        *sizes_V, per_rad = (getattr(self, name) for name in PARTS["cogging"])
        if any(sizes_V) and not per_rad:
            raise ValueError(
                "cogging_sin_V and cogging_cos_V do nothing without cogging_per_rad: give it, the cogs for each radian "
                "of the shaft, or leave all three out"
            )
        share, full_V = (getattr(self, name) for name in PARTS["free_between"])
        if share and not full_V:
            raise ValueError("free_between does nothing without full_drive_V: give it, the volts of full drive")
        return self


class EmulatedMotor(_Section):
    """The true motor behind an emulated or simulated device."""

    tau_s: Positive = Field(description="velocity time constant")
    K_rad_s_V: Positive = Field(description="velocity gain of the measured shaft")
    fc_plus_V: NonNegative = Field(description="moving friction towards positive positions")
    fc_minus_V: NonNegative = Field(description="moving friction towards negative positions")
    fs_plus_V: NonNegative | None = Field(None, description="static friction; default: as the moving friction")
    fs_minus_V: NonNegative | None = Field(None, description="static friction; default: as the moving friction")
    stribeck_rad_s: NonNegative = Field(
        0.0, description="speed over which static friction falls to moving friction; 0: it is there at rest only"
    )
    viscous_V_s_rad: NonNegative = Field(0.0, description="viscous friction; it shows as a smaller tau and K")
    bias_V: float = Field(0.0, description="constant added to the drive")
    start_rad: float = Field(0.0, description="position at the start")
    stop_rad: Interval = Field((-2.6, 2.6), description="mechanical stops, where the shaft is stopped dead")
    delay_s: Annotated[float, Field(gt=0.0, le=0.5)] | None = Field(
        None,
        description="simulated, modbus: from the device's output to the motor; no device reports it; default: none",
    )
    parts: EmulatedParts | None = Field(None, description="what else the motor has; without this section nothing")


class EmulatedPotentiometer(_Section):
    """The true potentiometer: straight; by default the line through the end points of sensor.calibration."""

    rad_per_count: Annotated[float | None, not_zero("the reading has to change with the position")] = Field(
        None, description="negative: readings fall with position; not 0; default: as sensor.calibration"
    )
    centre_counts: float | None = Field(
        None, description="reading at position 0 (with offset_rad 0); default: as sensor.calibration"
    )
    counts_max: Annotated[int, Field(ge=15, le=65535)] | None = Field(
        None, description="largest reading of the ADC; default: sensor.counts_max"
    )
    noise_rad: NonNegative = Field(0.0, description="standard deviation of white noise before quantisation")
    offset_rad: float = Field(0.0, description="true zero against the calibration's")


class EmulatedEncoder(_Section):
    """What an emulated bench with an encoder has besides; its scale is that of section `potentiometer`."""

    end_rad: Interval | None = Field(None, description="beyond these an end switch is open; default: there is none")
    estop_open_s: NonNegative = Field(0.0, description="for so long from power on a hand tries the e-stop")


class EmulatedWiring(_Section):
    """Faults that the emulated bench is built with."""

    drive: Literal["ok", "reversed", "dead", "stuck_on"] = Field("ok", description="fault of the drive")
    sensor: Literal["ok", "reversed", "broken_low", "broken_high", "stuck", "jumped", "noisy", "still", "still_a"] = (
        Field(
            "ok",
            description="fault of the position sensor; `still`, `still_a`: channel B, or A, of an encoder stands still",
        )
    )
    fault_after_s: NonNegative = Field(0.0, description="device time from arming until drive and sensor faults begin")


class Emulated(_Section):
    """The emulated bench: what is really behind `driver: simulated` or `port: emulated`.

    What the config believes of sensor, bridge and tachometer is true of it, but for what is said here. In an
    ``Experiment`` every default is filled in.
    """

    motor: EmulatedMotor = Field(description="the true motor, which the report compares estimates with")
    potentiometer: EmulatedPotentiometer = Field(EmulatedPotentiometer(), description="the true potentiometer")
    encoder: EmulatedEncoder | None = Field(
        None,
        description="the true encoder; default: where section sensor has one; there a hand tries the e-stop for 0.01 s "
        "if there are no travel limits",
    )
    supply_V: Positive | None = Field(None, description="true motor supply; default: drive.supply_V")
    bridge_drop_V: NonNegative | None = Field(
        None, description="truly lost in the bridge while driving; default: drive.bridge_drop_V"
    )
    dead_band_duty: DeadBand | None = Field(
        None, description="duty below which the bridge truly passes nothing; default: drive.dead_band_duty"
    )
    coasting: bool | None = Field(
        None,
        description="the bridge lets the motor run free while PWM is low (L298, PWM on its enable); default: false",
    )
    reversed: bool | None = Field(
        None, description="positive duty truly turns the shaft to falling positions; default: drive.reversed"
    )
    drive_counts: Annotated[int, Field(ge=50, le=32767)] = Field(799, description="PWM counts at full duty")
    latency_s: NonNegative = Field(0.0012, description="simulated: mean time from sample to effect of the drive")
    latency_jitter_s: NonNegative = Field(0.0003, description="simulated: uniform half-width around the mean")
    clock_error_ppm: Annotated[float, Field(ge=-20000, le=20000)] = Field(
        0.0, description="device clock against the host's (a ceramic resonator: 5000)"
    )
    tachometer: bool | None = Field(
        None,
        description="has a velocity channel, scaled as in section tachometer; default: where there is that section",
    )
    wiring: EmulatedWiring = Field(EmulatedWiring(), description="faults that the bench is built with")
    rehearsal: Literal[True] | None = Field(
        None,
        description="this bench stands for one that is not there yet: `rig rehearse` sets it, every result says so",
    )

    @model_validator(mode="after")
    def _coasts_without_parts(self) -> Self:
        if self.coasting and self.motor.parts is not None:
            raise ValueError(
                "a coasting bridge takes a motor without parts: leave out emulated.coasting or emulated.motor.parts"
            )
        return self


@dataclass(frozen=True, kw_only=True, slots=True)
class DeviceSetup:
    """What a device needs of an experiment; ``Experiment.device`` makes it. Backends and drivers see nothing else.

    period_s      the loop's period, s
    seed          of emulated noise
    spin_us, pace as in section ``loop``
    runs_relay    the relay tests decide in the device
    runs_strokes  so do the strokes between them
    gains         of the relay tests, where the config gives them
    The rest are the sections of that name, checked and complete.
    """

    period_s: float
    seed: int
    spin_us: float
    pace: float | None
    daq: Daq
    sensor: Sensor
    drive: Drive
    tachometer: Tachometer | None
    motor: MotorSection | None
    load: LoadSection | None
    limits: TravelLimits
    emulated: Emulated | None
    runs_relay: bool
    runs_strokes: bool
    gains: tuple[RelayGainsSection, ...]

    @property
    def arming(self) -> Limits:
        """What the device is armed with."""
        return Limits(self.limits.soft_rad, self.limits.hard_rad, self.drive.max_V, self.daq.watchdog_s)

    @property
    def scaling(self) -> Scaling:
        """What the device's raw numbers mean."""
        tachometer = None if self.tachometer is None else self.tachometer.scale
        s = self.sensor
        return Scaling(s.curve, self.drive.map, s.rails, s.counts_max, tachometer)


class Experiment(_Section):
    """One experiment, whole."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=40)] = Field(
        description="lower case; becomes part of the run folder's name"
    )
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = Field(1, description="of emulated noise")
    period_s: Annotated[float, Field(ge=0.0005, le=0.1)] = Field(0.01, description="the loop's period")
    loop: LoopSection = Field(LoopSection(), description="how the loop keeps its time")
    daq: Daq = Field(description="the link to the bench")
    sensor: Sensor = Field(description="the position sensor: counts to rad")
    drive: Drive = Field(description="the H-bridge: V to duty")
    tachometer: Tachometer | None = Field(None, description="velocity channel; leave out where there is none")
    motor: MotorSection | None = Field(
        None, description="what its data sheet says; a run needs it, only recordings of older versions lack it"
    )
    load: LoadSection | None = Field(None, description="a mass on an arm on a servo's horn; leave out where it is free")
    limits: TravelLimits = Field(description="where the shaft may be, and how fast")
    breakaway: BreakawaySection = Field(BreakawaySection(), description="the check before any relay")
    relay: RelaySection = Field(description="the relay experiment")
    survey: SurveySection = Field(
        SurveySection(), description="the sweeps of `rig survey`, and of a thorough `rig run`"
    )
    identify: IdentifySection = Field(
        IdentifySection(), description="how the motor is identified from the run, and what is recorded for it"
    )
    tracking: TrackingSection | None = Field(None, description="leave out to skip the tracking check")
    law: LawSection | None = Field(
        None, description="a law of your own: `rig run` runs the breakaway check and this law, and nothing else"
    )
    emulated: Emulated | None = Field(None, description="the bench behind `driver: simulated` or `port: emulated`")

    @property
    def device(self) -> DeviceSetup:
        """What the device needs of this."""
        relay = self.relay
        in_device = relay.where == "device"
        return DeviceSetup(
            period_s=self.period_s,
            seed=self.seed,
            spin_us=self.loop.spin_us,
            pace=self.loop.pace,
            daq=self.daq,
            sensor=self.sensor,
            drive=self.drive,
            tachometer=self.tachometer,
            motor=self.motor,
            load=self.load,
            limits=self.limits,
            emulated=self.emulated,
            runs_relay=in_device,
            runs_strokes=in_device and relay.until is not None,
            gains=relay.gains or (),
        )

    def at_pace(self, pace: float | None) -> Self:
        """With this in place of ``loop.pace``; None: as it is."""
        if pace is None:
            return self
        return self.model_copy(update={"loop": self.loop.model_copy(update={"pace": pace})})

    @model_validator(mode="after")
    def _emulated_as_believed(self) -> Self:
        """The emulated bench is the one that the other sections describe, but for what its own section says."""
        if self.emulated is not None:
            rad_per_count, centre_counts = self.sensor.straight
            potentiometer = _filled(
                self.emulated.potentiometer,
                rad_per_count=rad_per_count,
                centre_counts=centre_counts,
                counts_max=self.sensor.counts_max,
            )
            emulated = _filled(
                self.emulated.model_copy(update={"potentiometer": potentiometer}),
                supply_V=self.drive.supply_V,
                bridge_drop_V=self.drive.bridge_drop_V,
                dead_band_duty=self.drive.dead_band_duty,
                reversed=self.drive.reversed,
                tachometer=self.tachometer is not None,
            )
            if self.sensor.encoder is not None:
                counter = EmulatedEncoder(estop_open_s=_TRIES_ESTOP_S if self.limits.is_endless else 0.0)
                emulated = _filled(emulated, encoder=counter)
            if self.limits.is_endless and "stop_rad" not in emulated.motor.model_fields_set:
                motor = emulated.motor.model_copy(update={"stop_rad": _NO_STOPS})
                emulated = emulated.model_copy(update={"motor": motor})
            object.__setattr__(self, "emulated", emulated)  # frozen: this is the one place that completes it
        return self


_TRIES_ESTOP_S = 0.01  # over before the host has asked who it is
_NO_STOPS = (-1e9, 1e9)  # rad: finite, as every number of a config

_AnySection = TypeVar("_AnySection", bound=_Section)


def _filled(section: _AnySection, **believed: Any) -> _AnySection:
    """The section with a value for each of these keys that has none."""
    missing = {key: value for key, value in believed.items() if getattr(section, key) is None}
    return section.model_copy(update=missing)
