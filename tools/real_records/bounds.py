"""What a record can say at most of tau, K and friction of a motor that is known, with a load that is not.

The Cramer-Rao bound of a record at published numbers. The force over position, the bias and the delay are free beside
tau, K and friction; so is the start. The noise is the sensor's alone, the best that could be; or what is left of the
record with these numbers, coloured as it is: the best for somebody whose model leaves that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from real_records.known import NUMBERS, PUBLISHED
from real_records.scores import Seen, by_published
from rig.identification.departures.blocks import Blocks
from rig.identification.departures.fit import CORE, DELAY, POSITIVE, Fit, Normal, Problem, limits_of, solve, unit
from rig.identification.departures.fit import start as begin
from rig.identification.departures.pieces import Cut
from rig.identification.identification import Identification
from rig.model.real_motor import RealMotor

FORCE = ("force_sin_V", "force_cos_V")
T95 = 1.96
KNOWN = 0.25  # half width, relative: above it a number is not known


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


def bounded(records: Sequence[Seen]) -> list[tuple[Seen, dict[str, tuple[float, float]]]]:
    """The records of motors whose three numbers are published, each with its ``bounds`` there."""
    found = []
    for seen in records:
        published = {name: value for name, (value, _) in PUBLISHED.get(seen.motor, {}).items()}
        if seen.found is not None and all(name in published for name in NUMBERS):
            found.append((seen, bounds(seen.found, published)))
    return found


def tellable(records: Sequence[Seen]) -> list[str]:
    """A sentence for each such motor: how many of its numbers its records can tell at all, and what rig gives."""
    by_motor: dict[str, list[tuple[str, dict[str, tuple[float, float]]]]] = {}
    for seen, pairs in bounded(records):
        by_motor.setdefault(seen.motor, []).append((seen.name, pairs))
    given = [one for one in by_published(records) if one.is_given]
    lines = []
    for motor, each in by_motor.items():
        told = {name: sum(pairs[name][1] <= KNOWN for _, pairs in each) for name in NUMBERS}
        split = ", ".join(f"{word} of {count}" for word, count in zip(("tau", "K", "f_c"), told.values(), strict=True))
        own = [f"{one.cells()[1]} of {one.record} ({one.cells()[6]})" for one in given if one.motor == motor]
        lines.append(
            f"{motor}: {sum(told.values())} of {len(NUMBERS) * len(each)} numbers can be known to "
            f"{100.0 * KNOWN:.0f} % ({split} of its {len(each)} records). rig gives {len(own)}"
            f"{': ' if own else ''}{', '.join(own)}."
        )
    return lines


def _half(fit: Fit, name: str, variance: float) -> float:
    """Half width at 95 % of a number, in its unit, where white rows have this variance."""
    normal = Normal.of(fit.rows, fit.problem.cut)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal.matrix), 1e-300))
    inverse = np.linalg.pinv(normal.matrix * np.outer(scale, scale), rcond=1e-13, hermitian=True)
    k = fit.problem.free.index(name)
    size = getattr(fit.motor, name) if name in POSITIVE else 1.0
    return T95 * size * float(scale[k] * math.sqrt(max(inverse[k, k], 0.0) * variance))
