"""The loops of a design, in C: a planned test on a motor, what its rows tell, and how far the shaft goes in it."""

from __future__ import annotations

import ctypes
from ctypes import byref

import numpy as np

from rig.core.arrays import Array
from rig.model.library import LIBRARY, TestPlan, address, given, numbers, require_size
from rig.model.step import Numbers

Law = tuple[bool, Array, Array]  # True, (h1, h2), (); or False, drives of the strokes, their turning points
Timing = tuple[float, float]  # sampling period, and from a sample until its drive acts, s

PARAMETERS = 5  # log tau, log K, fc, asym, delay
STARTS = 2  # v0, y0: no test tells them, and none needs them
WIDTH = PARAMETERS + STARTS


def drive(
    motor: Numbers, law: Law, timing: Timing, start: Numbers, most_strokes: int, most_rows: int
) -> tuple[Array, Array, int]:
    """Drives, V, velocities and positions (n, 2) at each sample, and the rows of the longest stroke.

    They end where ``most_strokes`` have ended, if any are asked for, or after ``most_rows``.
    The laws are ``rig.control.relay.DualChannelRelay`` and ``rig.control.strokes.StrokeTest``, without noise. Until the
    first drive acts there is none.
    """
    is_relay, first, second = law[0], given(law[1]), given(law[2])
    require_size(first, 2 if is_relay else max(second.size, 1), "drives of a test")
    longest = ctypes.c_int64()
    plan = TestPlan(address(first), address(second), *timing, 0 if is_relay else first.size, most_strokes)
    u_V, states = np.empty(most_rows), np.empty((most_rows, 2))
    into = address(u_V), address(states)
    rows = LIBRARY.test_drive(numbers(*motor), byref(plan), numbers(*start), most_rows, *into, byref(longest))
    return u_V[:rows], states[:rows], longest.value


def spread(motor: Numbers, timing: Timing, u_V: Array, states: Array) -> Array:
    """(n, 7): the positions by log tau, log K, fc, asym, delay, v0, y0; rad over their units.

    ``states`` (n, 2), velocity, rad/s, and position, rad: the first one is the start.
    """
    drives_V, known_states = given(u_V), given(states)
    n = drives_V.size
    require_size(known_states, 2 * n, "states")
    plan, work, jacobian = TestPlan(None, None, *timing, 0, 0), np.empty(4 * n + 2), np.empty((n, WIDTH))
    if n:
        read = address(drives_V), address(known_states)
        LIBRARY.test_jacobian(numbers(*motor), byref(plan), n, *read, address(work), address(jacobian))
    return jacobian


def known(full: Array, seen: Array) -> Array:
    """(5, 5): the information ``seen`` and that of rows, ``full`` (7, 7), without what the starts take."""
    rows, before = given(full), given(seen)
    require_size(rows, WIDTH * WIDTH, "information of rows")
    require_size(before, PARAMETERS * PARAMETERS, "information")
    out = np.empty((PARAMETERS, PARAMETERS))
    LIBRARY.test_known(address(rows), address(before), address(out))
    return out


def variances(information: Array) -> Array | None:
    """(3,): variances of log tau, log K and fc; None where the information does not separate them."""
    given_information = given(information)
    require_size(given_information, PARAMETERS * PARAMETERS, "information")
    out = np.empty(3)
    return out if LIBRARY.test_variances(address(given_information), address(out)) else None


def rows_until(jacobian: Array, noise_rad2: float, seen: Array, wanted: Array, every: int) -> tuple[float, Array]:
    """Rows until the deviations of log tau, log K and fc are within ``wanted`` (3,), and all information then, (5, 5).

    ``jacobian`` is that of ``spread``, and ``noise_rad2`` the variance of a reading, rad^2. ``seen`` is the information
    before the first row. It looks after each ``every`` rows, and at the last; between two looks the logarithm of the
    deviation falls evenly. If the rows are too few: as many as it takes if information goes on as it came in until
    then.
    """
    rows, before, within = given(jacobian), given(seen), given(wanted)
    n = rows.shape[0]
    require_size(rows, n * WIDTH, "jacobian")
    require_size(before, PARAMETERS * PARAMETERS, "information")
    require_size(within, 3, "wanted")
    information = before.copy()
    read, into = (address(before), address(within)), address(information)
    needed: float = LIBRARY.test_rows(address(rows), n, noise_rad2, *read, max(every, 1), into)
    return needed, information


def bounds(states: Array, horizon_s: float) -> tuple[float, float, float, float, float]:
    """Lowest and highest position, rad, largest speed, rad/s, lowest and highest stop that a guard predicts, rad.

    ``states`` (n, 2): velocity, rad/s, and position, rad.
    """
    rows, found = given(states), numbers(*[0.0] * 5)
    require_size(rows, 2 * rows.shape[0], "states")
    LIBRARY.test_bounds(address(rows), rows.shape[0], horizon_s, found)
    low, high, speed, first, last = found
    return low, high, speed, first, last
