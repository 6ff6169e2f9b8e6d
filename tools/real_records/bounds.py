"""What a record can say at most of tau, K and friction of a motor that is known, with a load that is not.

The Cramer-Rao bound of a record at published numbers. The force over position, the bias and the delay are free beside
tau, K and friction; so is the start. The noise is the sensor's alone, the best that could be; or what is left of the
record with these numbers, coloured as it is: the best for somebody whose model leaves that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rig.identification.departures.blocks import Blocks
from rig.identification.departures.fit import CORE, DELAY, POSITIVE, Fit, Normal, Problem, limits_of, solve, unit
from rig.identification.departures.fit import start as begin
from rig.identification.departures.pieces import Cut
from rig.identification.identification import Identification
from rig.model.real_motor import RealMotor

FORCE = ("force_sin_V", "force_cos_V")
NUMBERS = ("tau_s", "K_rad_s_V", "fc_V")
T95 = 1.96


def bounds(found: Identification, known: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """By number: half widths at 95 %, relative to it: with the sensor's noise, and with the noise that is left.

    known   tau_s, K_rad_s_V and fc_V of the motor
    On blocks of three time constants or 2 s, each with a start of its own.
    """
    tests = found.tests
    whole = Cut.whole(tests, max(test.longest_delay_s for test in tests))
    cut = Blocks.of(whole, known["tau_s"]).cut
    delay_s = min(test.earliest_delay_s for test in tests), max(test.longest_delay_s for test in tests)
    free = (*CORE, DELAY, *FORCE)
    sigma = max(float(np.sqrt(np.mean([test.noise_rad() ** 2 for test in tests]))), 1e-6)
    sigma = max(sigma, max(test.resolution_rad() for test in tests) / math.sqrt(12.0))
    rest = ("bias_V", DELAY, *FORCE)
    motor = RealMotor(known["tau_s"], known["K_rad_s_V"], known["fc_V"], 0.0, 0.0)
    load = solve(begin(Problem(cut, rest, limits_of(rest, cut, delay_s), sigma), motor))
    problem = Problem(cut, free, limits_of(free, cut, delay_s), sigma)
    at = replace(load, problem=problem).with_own_noise
    sensor = replace(at, problem=problem)
    return {name: (_half(sensor, name, 1.0) / known[name], _half(at, name, unit(at)) / known[name]) for name in NUMBERS}


def _half(fit: Fit, name: str, variance: float) -> float:
    """Half width at 95 % of a number, in its unit, where white rows have this variance."""
    normal = Normal.of(fit.rows, fit.problem.cut)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal.matrix), 1e-300))
    inverse = np.linalg.pinv(normal.matrix * np.outer(scale, scale), rcond=1e-13, hermitian=True)
    k = fit.problem.free.index(name)
    size = getattr(fit.motor, name) if name in POSITIVE else 1.0
    return T95 * size * float(scale[k] * math.sqrt(max(inverse[k, k], 0.0) * variance))
