"""A motor with departures from the plain model, simulated in small fixed steps. It shares no code with ``rig.model``.

    tau dv/dt = K (w + bias - G(y) - F) - v - K (beta |v| + c v|v|),   y' = v,   reading = S(play(y)) + noise

This is a peer for the model and the estimators of rig: another integrator, another way to meet a reversal, another
author's reading of the same table (docs/theory.md 12). Each step of 50 us freezes the forces at its middle and lets the
velocity tend exponentially to its end value. Halving the step moves a position by some 1e-5 rad in ten seconds. The
loops are in C, in ``departing_motor.c``, which is compiled where it has changed.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.model.library_build import compiled

Array = NDArray[np.float64]

STEP_S = 5e-5
SOURCE = Path(__file__).with_suffix(".c")


def _loaded() -> ctypes.CDLL:
    loaded = ctypes.CDLL(str(compiled([SOURCE], SOURCE.parents[2] / "build" / "campaign_real")))
    numbers, span = ctypes.c_void_p, ctypes.c_double
    loaded.departing_advance.argtypes = [numbers] * 4 + [span, numbers]
    loaded.departing_advance.restype = None
    loaded.departing_relay_test.argtypes = [numbers] * 6 + [ctypes.c_int64, numbers]
    loaded.departing_relay_test.restype = None
    return loaded


_LIBRARY = _loaded()


def row_of(*values: float) -> ctypes.Array[ctypes.c_double]:
    """Numbers as C reads them."""
    return (ctypes.c_double * len(values))(*values)


@dataclass(frozen=True)
class Departures:
    """Sizes of what the plain model leaves out; all zero by default.

    dead_band_V         drive that the bridge loses around zero, V
    gain_by_sign        half the relative difference of the gain of positive and negative drives, 1
    sag_per_V           relative loss of drive per volt of drive, 1/V
    lag_s               electrical time constant, s
    viscous_V_s_rad     half the difference of the viscous friction of both directions, V s/rad
    static_V            static friction above the moving one, at rest only, V
    stribeck_V, stribeck_rad_s    excess of friction at low speed, V, and the speed over which it falls, rad/s
    drag_V_s2_rad2      quadratic drag, V s^2/rad^2
    bristle_V_rad       stiffness of the bristles (LuGre), V/rad; 0: Coulomb
    force_V, force_phase_rad      force over position, once a turn
    friction_share, friction_phase_rad   friction over position, relative to fc, once a turn
    cogging_V, cogging_per_rad, cogging_phase_rad    force of the poles, V, and its order, 1/rad
    backlash_rad        play between the motor and the sensor, whole width, rad
    linearity_rad, linearity_per_rad, linearity_phase_rad   error of the sensor over position
    drift               relative change of the friction over the record, 1
    random_V            standard deviation of a random force of 0.1 s memory, V
    """

    dead_band_V: float = 0.0
    gain_by_sign: float = 0.0
    sag_per_V: float = 0.0
    lag_s: float = 0.0
    viscous_V_s_rad: float = 0.0
    static_V: float = 0.0
    stribeck_V: float = 0.0
    stribeck_rad_s: float = 1.0
    drag_V_s2_rad2: float = 0.0
    bristle_V_rad: float = 0.0
    force_V: float = 0.0
    force_phase_rad: float = 0.0
    friction_share: float = 0.0
    friction_phase_rad: float = 0.0
    cogging_V: float = 0.0
    cogging_per_rad: float = 12.0
    cogging_phase_rad: float = 0.0
    backlash_rad: float = 0.0
    linearity_rad: float = 0.0
    linearity_per_rad: float = 1.0
    linearity_phase_rad: float = 0.0
    drift: float = 0.0
    random_V: float = 0.0

    def numbers(self) -> tuple[float, ...]:
        """All of them, in this order."""
        return tuple(float(getattr(self, one.name)) for one in fields(self))


@dataclass(frozen=True)
class PlainMotor:
    """The plain motor under the departures: tau, s; K, (rad/s)/V; friction, V; bias, V."""

    tau_s: float
    K_rad_s_V: float
    fc_V: float
    bias_V: float = 0.0


@dataclass(frozen=True)
class Bench:
    """How the motor is driven and read.

    period_s, delay_s   of the samples, and from a sample to its drive, s; delay_s is below period_s
    noise_rad, lsb_rad  of the sensor, rad
    offset_rad          of the sensor, rad
    """

    period_s: float = 0.010
    delay_s: float = 0.005
    noise_rad: float = 0.003
    lsb_rad: float = 4.2 / 1024
    offset_rad: float = 0.0


@dataclass(frozen=True)
class Record:
    """A simulated relay test, n rows: times, s; positions as read, rad; drives, V; true positions, rad."""

    t_s: Array
    y_rad: Array
    u_V: Array
    true_y_rad: Array
    true_v_rad_s: Array
    z_rad_s: Array = field(repr=False)


def relay_test(
    motor: PlainMotor,
    departures: Departures,
    bench: Bench,
    gains_V: tuple[float, float],
    rows: int,
    begin_and_whole_s: tuple[float, float],
    seed: np.random.SeedSequence,
    step_s: float = STEP_S,
) -> Record:
    """A relay test from rest at 0.

    gains_V             h1 and h2, V
    begin_and_whole_s   when this test begins, and how long the whole record is, s: friction drifts over the whole
    seed                of noise and random force
    """
    rng = np.random.default_rng(seed)
    noise: Array = bench.offset_rad + bench.noise_rad * rng.standard_normal(rows)
    force = np.zeros(rows)
    if departures.random_V > 0.0:
        keep = np.exp(-bench.period_s / 0.1)
        force[0] = rng.standard_normal()
        for k in range(1, rows):
            force[k] = keep * force[k - 1] + np.sqrt(1.0 - keep * keep) * rng.standard_normal()
    out, pushed_V = np.empty((rows, 5)), departures.random_V * force
    _LIBRARY.departing_relay_test(
        row_of(motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V),
        row_of(*departures.numbers()),
        row_of(bench.period_s, bench.delay_s, bench.lsb_rad, *begin_and_whole_s, step_s),
        row_of(*gains_V),
        noise.ctypes.data,
        pushed_V.ctypes.data,
        rows,
        out.ctypes.data,
    )
    columns = [np.ascontiguousarray(column, dtype=np.float64) for column in out.T]
    t_s = np.asarray(bench.period_s * np.arange(rows), dtype=np.float64)
    return Record(t_s, columns[0], columns[1], columns[2], columns[3], columns[4])


def reading(y_rad: Array, departures: Departures) -> Array:
    """What the sensor shows at the positions ``y_rad``, without noise, steps, play and offset, rad."""
    d = departures
    return y_rad + d.linearity_rad * np.sin(d.linearity_per_rad * y_rad + d.linearity_phase_rad)


class MovingShaft:
    """The same motor, one span of constant drive after the other: for a law of rig's own, in its closed loop.

    begin_and_whole_s   when the run's time 0 is, and how long the friction's drift takes, s
    """

    def __init__(
        self,
        motor: PlainMotor,
        departures: Departures,
        begin_and_whole_s: tuple[float, float],
        step_s: float = STEP_S,
    ) -> None:
        self._motor = row_of(motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V)
        self._departures = departures
        self._numbers = row_of(*departures.numbers())
        self._begin_s, self._whole_s = begin_and_whole_s
        self._step_s = step_s
        self._state = row_of(*[0.0] * 5)

    def advance(self, u_V: float, force_V: float, t_s: float, dt_s: float) -> None:
        """Let ``dt_s`` pass from ``t_s``, s, on, under the drive ``u_V`` and the random force ``force_V``, V."""
        timing, drive = row_of(self._begin_s + t_s, self._whole_s, self._step_s), row_of(u_V, force_V)
        _LIBRARY.departing_advance(self._motor, self._numbers, timing, drive, dt_s, self._state)

    @property
    def reading_rad(self) -> float:
        """What the sensor shows, without noise, steps and offset, rad."""
        return float(reading(np.array([self._state[3]]), self._departures)[0])

    @property
    def y_rad(self) -> float:
        """The true position, rad."""
        return float(self._state[1])
