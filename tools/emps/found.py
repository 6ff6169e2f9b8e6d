"""What rig finds in the record: once in all of it, once in every other piece, with the pieces between held out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

import rig
from emps.prediction import Law, closed_loop, free_run, in_pieces, rms
from emps.record import FORCE_N_V, PIECE_S, PUBLISHED_MOTOR, Drive, Record
from rig.core.estimators import LEADING
from rig.identification import sampled_data
from rig.identification.departures.pieces import Cut
from rig.identification.estimate import Estimate
from rig.identification.motor_law import FoundLaw, MotorLaw, motor_law
from rig.model import real_step
from rig.model.real_motor import RealMotor
from rig.run_folder.recording.series import TimeSeries

Array = NDArray[np.float64]

FAILS = 0.05  # of the RMS of the motion: from there on a free run has failed
POINTS = 400  # of the travel, where a law over the position is looked at


@dataclass(frozen=True)
class Prediction:
    """How well a law predicts the record; all are RMS errors of the position, m, but for the last two.

    even, odd           pieces of 2 s, the first, third, ... and the second, fourth, ..., each from its own start
    free                the whole record from its start
    share               the same, relative to the RMS of the motion about its mean
    loop_force, loop_position   of the simulated closed loop: relative errors, %
    """

    even: float
    odd: float
    free: float
    share: float
    loop_force: float
    loop_position: float

    @property
    def fails(self) -> bool:
        """Whether the free run has failed."""
        return not self.share <= FAILS


def prediction(law: Law, record: Record) -> Prediction:
    """Of every kind."""
    error = in_pieces(law, record, record.starts)
    spans = record.spans
    even, odd = (np.concatenate([error[a:b] for a, b in spans[k::2]]) for k in (0, 1))
    y, u_V = record.series.y_rad, record.series.u_V
    free = rms(free_run(law, record))
    loop_y, loop_V = closed_loop(law, record)
    return Prediction(
        rms(even),
        rms(odd),
        free,
        free / float(np.std(y)),
        100.0 * rms(loop_V - u_V) / rms(u_V),
        100.0 * rms(loop_y - y) / rms(y),
    )


@dataclass(frozen=True, eq=False)
class Found:
    """What rig finds in some pieces of the record, or in all.

    record      the record
    law         the law of the motor, with the length and residual of the pieces that were fitted
    motor       its numbers, and what its parts refer to
    plain_rms   residual of the plain motor, one piece a test, m
    estimate    the estimate with the law, and its verdict
    """

    record: Record
    law: MotorLaw
    motor: Law
    plain_rms: float
    estimate: Estimate

    @property
    def drive(self) -> Drive:
        """In the units of its authors."""
        m = self.motor.motor
        half = abs(m.viscous_by_direction_V_s_rad) * FORCE_N_V
        return Drive(m.tau_s * FORCE_N_V / m.K_rad_s_V, FORCE_N_V / m.K_rad_s_V, half, m.fc_V * FORCE_N_V)

    @property
    def names(self) -> list[str]:
        """The laws that were found."""
        return [one.law.name for one in self.law.found]

    @cached_property
    def prediction(self) -> Prediction:
        """Of the whole record."""
        return prediction(self.motor, self.record)

    def sizes(self) -> list[tuple[str, str]]:
        """Each law that was found, and its size in the units of the authors."""
        return [(one.law.title, self._size(one)) for one in self.law.found]

    def _size(self, one: FoundLaw) -> str:
        """A law over the position by what it makes over the travel: its own numbers mean a turn of 2 pi m."""
        frame, m = self.motor.frame, self.motor.motor
        alone = RealMotor(m.tau_s, m.K_rad_s_V, m.fc_V)._replace(**one.numbers)
        places = (np.linspace(-1.0, 1.0, POINTS) * frame.half_travel_rad + frame.centre_rad).tolist()
        match one.law.name:
            case "viscous_by_direction":
                return f"{self.drive.viscous_half_N_s_m:.1f} N s/m"
            case "force_over_position" | "cogging":
                over = [real_step.force(alone, frame, y) for y in places]
            case "friction_over_position":
                over = [real_step.level(alone, frame, 1.0, y) for y in places]
            case "linearity":
                over = [real_step.reading(alone, frame, y) - y for y in places]
                return f"{1e3 * (max(over) - min(over)):.2f} mm between its extremes over the travel"
            case _:
                return f"{one.size:.3g} {one.law.unit}".removesuffix(" 1")
        return f"{FORCE_N_V * (max(over) - min(over)):.2f} N between its extremes over the travel"


def whole(record: Record) -> Found:
    """In all of the record, by `rig.identify`. Raises IdentifyError."""
    series = record.series
    found = rig.identify(series.t_s, series.u_V, series.y_rad)
    plain, law = found.estimates[LEADING], found.motor_law
    assert law is not None, "a drive like this one has a law"
    best = law.estimate or plain
    return Found(record, law, _law(best, law, [series]), plain.rms_rad, best)


def every_other(record: Record) -> Found:
    """In the first, third, fifth, ... piece of 2 s; what lies between is held out. Raises IdentifyError."""
    tests = record.pieces[::2]
    plain = sampled_data.fit(tests)
    law = motor_law(tests, plain, [PIECE_S] * len(tests))
    best = law.estimate or plain
    return Found(record, law, _law(best, law, tests), plain.rms_rad, best)


def published(record: Record) -> Law:
    """The law that the authors published."""
    return Law(PUBLISHED_MOTOR, Cut.whole([record.series], 0.0).frames[0])


def _law(best: Estimate, law: MotorLaw, tests: Sequence[TimeSeries]) -> Law:
    delay_s = best.delay_s if math.isfinite(best.delay_s) else 0.0
    motor = RealMotor(best.tau_s, best.K_rad_s_V, max(best.fc_V, 0.0), best.asym_V, delay_s)
    for one in law.found:
        motor = motor._replace(**one.numbers)
    return Law(motor, Cut.whole(tests, tests[0].longest_delay_s).frames[0])
