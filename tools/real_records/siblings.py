"""Records of one motor beside each other: do their numbers agree, and does one record's motor predict the next one?

Numbers count where they are usable: graded exact, good or rough. Two of them agree where they differ by no more than
the root sum of squares of their u95. A motor predicts another record in blocks of 2 s, or of three time constants, from
their first 0.1 s on; what is left is measured against 'it stays as it was': `rig.identification.departures.blocks`.
Beside it stand a linear output-error model and an ARX model of second order, fitted to the same first record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rig.identification.departures.blocks import Blocks, linear
from rig.identification.departures.fit import CORE, DELAY, Problem, limits_of
from rig.identification.departures.pieces import Cut
from rig.identification.identification import Identification
from rig.model.real_motor import is_plain
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.results import Answer

Array = NDArray[np.float64]

LAGS = 2  # of the ARX model
OUT = 1e3  # relative error of a prediction that ran away


@dataclass(frozen=True)
class Next:
    """Errors of one record's models in the blocks of another: rig's motor, the linear model's, the ARX model's."""

    first: str
    second: str
    rig: float
    linear: float
    arx: float


def pairs_that_agree(answers: Mapping[str, Answer]) -> tuple[int, int]:
    """Of all usable numbers of two records: how many agree, and how many there are. ``answers``: by record."""
    agree = count = 0
    for one, other in combinations(answers, 2):
        for name in ("tau_s", "K_rad_s_V", "fc_V"):
            first, second = ((answers[record].grade or {}).get(name) for record in (one, other))
            if first is None or second is None or first.value is None or second.value is None:
                continue
            count += 1
            agree += abs(first.value - second.value) <= math.hypot(first.u95 or 0.0, second.u95 or 0.0)
    return agree, count


def next_record(first: Identification, second: Identification, names: tuple[str, str]) -> Next | None:
    """How well the models of the first record predict the second one; None where rig has no motor of it."""
    framed = first.real_motor
    if framed is None:
        return None
    motor, place = framed.motor, framed.frame
    tests = second.tests
    blocks = Blocks.of(Cut.whole(tests, max(test.longest_delay_s for test in tests)), motor.tau_s)
    frames = tuple(
        frame._replace(centre_rad=place.centre_rad, half_travel_rad=place.half_travel_rad)
        for frame in blocks.cut.frames
    )
    here = Blocks(replace(blocks.cut, frames=blocks.cut.frames if is_plain(motor) else frames), blocks.shown)
    own = here.error(motor, _problem(blocks.cut, tests))
    of_first = Cut.whole(first.tests, max(test.longest_delay_s for test in first.tests))
    straight = linear(Blocks.of(of_first, motor.tau_s), _problem(of_first, first.tests), motor).motor
    left = blocks.error(straight, _problem(blocks.cut, tests))
    numbers = _arx(first.tests)
    stays = math.sqrt(float(blocks.squares(blocks.stays_rad()).sum()))
    arx = math.sqrt(float(blocks.squares(_arx_off_rad(blocks, numbers)).sum())) / stays
    return Next(*names, *(min(error, OUT) for error in (own, left, arx)))


def _problem(cut: Cut, tests: Sequence[TimeSeries]) -> Problem:
    delay_s = min(test.earliest_delay_s for test in tests), max(test.longest_delay_s for test in tests)
    sigma = max(float(np.sqrt(np.mean([test.noise_rad() ** 2 for test in tests]))), 1e-9)
    free = (*CORE, DELAY)
    return Problem(cut, free, limits_of(free, cut, delay_s), sigma)


def _arx(tests: Sequence[TimeSeries]) -> Array:
    """Numbers of y_k = a_1 y_{k-1} + a_2 y_{k-2} + b_1 u_{k-1} + b_2 u_{k-2} + c, by least squares."""
    rows, then = [], []
    for test in tests:
        y, u = test.y_rad, test.u_V
        back = [one[LAGS - lag : one.size - lag] for one in (y, u) for lag in (1, 2)]
        rows.append(np.column_stack([*back, np.ones(y.size - LAGS)]))
        then.append(y[LAGS:])
    return np.asarray(np.linalg.lstsq(np.concatenate(rows), np.concatenate(then), rcond=None)[0])


def _arx_off_rad(blocks: Blocks, numbers: Array) -> Array:
    """(n,) predicted less recorded, rad, of each row of the blocks; 0 where a row shows the start of its block."""
    cut = blocks.cut
    u_V = np.concatenate([window.series.u_V[window.first : window.stop] for window in cut.windows])
    off = np.zeros(cut.t_s.size)
    for begin, length in zip(cut.begins.tolist(), cut.lengths, strict=True):
        y = cut.y_rad[begin : begin + length].copy()
        for k in range(LAGS, length):
            if not blocks.shown[begin + k]:
                past = (y[k - 1], y[k - 2], u_V[begin + k - 1], u_V[begin + k - 2], 1.0)
                y[k] = float(np.clip(numbers @ past, -1e6, 1e6))
        off[begin : begin + length] = y - cut.y_rad[begin : begin + length]
    return np.where(blocks.shown, 0.0, off)
