"""The result of an estimator: parameters with their intervals, and a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np

from rig.core.arrays import Array
from rig.core.optional import needed
from rig.identification.chance import student_975
from rig.identification.mean_cycle import Cycle
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.run_folder.results import EstimateResult, ResidualResult

Verdict = Literal["ok", "doubtful", "refused"]
VERDICTS: tuple[Verdict, ...] = ("ok", "doubtful", "refused")

PARAMETERS = ("tau_s", "K_rad_s_V", "fc_V", "asym_V", "delay_s")
DELAY = PARAMETERS.index("delay_s")


@dataclass(frozen=True)
class Estimate:
    """One estimator's result, an entry of ``estimates`` in result.json (docs/results.md).

    method          its name: one of rig/core/estimators.py
    tau_s, K_rad_s_V    time constant, s, and gain, (rad/s)/V; nan from least squares, which gives friction alone
    fc_V, asym_V    friction and its asymmetry, V; asym_V is 0 if the method does not estimate it
    delay_s         of the drive, s; nan if the method does not estimate it
    fc_plus_V, fc_minus_V, bias_V    V; None if the recording cannot show them
    ci95            parameter -> (low, high)
    covariance      (5, 5), of ``PARAMETERS``; nan if unknown
    rms_rad         RMS residual of the recorded position, rad
    iterations      from the best start
    verdict, reasons    the reasons say what is wrong and what to record instead
    rows            first and last row used
    iterates        (n, 3): tau_s, K_rad_s_V, fc_V at each iteration, or after each sample of a recursion
    residual_rad, residual_t_s  the residual, rad, and its times, s
    repeated        share of the residual's power that repeats in each cycle, 0 to 1
    coloured        coloured noise beside the white noise: its memory, s, and its standard deviation over the white
                    one's; None without it
    cycles          the limit cycles behind the estimate; () for a method that needs none
    converged       whether its fit came to an end
    force_V         sine and cosine of the force over position that it was fitted beside; 0: of none
    spoiled         whether it was refused for what no better fit mends: wrong columns, a damaged record, no motor
    """

    method: str
    tau_s: float
    K_rad_s_V: float
    fc_V: float
    asym_V: float = 0.0
    delay_s: float = math.nan
    fc_plus_V: float | None = None
    fc_minus_V: float | None = None
    bias_V: float | None = None
    ci95: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    covariance: Array = field(default_factory=lambda: np.full((5, 5), np.nan))
    rms_rad: float = math.nan
    iterations: int = 0
    verdict: Verdict = "ok"
    reasons: tuple[str, ...] = ()
    rows: tuple[int, int] = (0, 0)
    iterates: Array = field(default_factory=lambda: np.empty((0, 3)))
    residual_rad: Array = field(default_factory=lambda: np.empty(0))
    residual_t_s: Array = field(default_factory=lambda: np.empty(0))
    repeated: float = 0.0
    coloured: tuple[float, float] | None = None
    cycles: tuple[Cycle, ...] = field(default=(), repr=False)
    remarks: tuple[str, ...] = ()
    converged: bool = True
    force_V: tuple[float, float] = (0.0, 0.0)
    spoiled: bool = False

    @property
    def correlation(self) -> Array:
        """(5, 5) correlation of ``PARAMETERS``; nan for a parameter that was not estimated."""
        spread = np.sqrt(np.diag(self.covariance))
        spread = np.where(np.isfinite(spread) & (spread > 0.0), spread, np.nan)
        return np.asarray(self.covariance / np.outer(spread, spread))

    @property
    def is_motor(self) -> bool:
        """Whether it has tau and K, not friction alone."""
        return math.isfinite(self.tau_s) and math.isfinite(self.K_rad_s_V)

    @property
    def widest(self) -> float:
        """Half width of the widest 95 % interval of tau, K and f_c, as a share of its parameter; inf if unknown."""
        shares = [
            (high - low) / 2.0 / max(abs(getattr(self, name)), 1e-12)
            for name, (low, high) in self.ci95.items()
            if name in PARAMETERS[:3]
        ]
        return max((share if math.isfinite(share) else math.inf for share in shares), default=math.inf)

    @property
    def fits_delay(self) -> bool:
        """Whether its delay was fitted: neither known nor left out."""
        return math.isfinite(self.delay_s) and float(self.covariance[DELAY, DELAY]) > 0.0

    def motor(self) -> Motor:
        """The identified motor: Coulomb friction fc_V, its asymmetry as a bias. Raises ValueError without tau and K."""
        if not self.is_motor:
            raise ValueError(f"{self.method} gives no motor: tau and K are unknown")
        return Motor(self.tau_s, self.K_rad_s_V, coulomb(self.fc_V), self.asym_V)

    def to_control(self) -> Any:
        """The linear part as a transfer function of python-control: K / (s (tau s + 1)) from u - f to y, V to rad.

        f is friction, which no transfer function holds: fc_V with the sign of the velocity, while the shaft turns. Take
        it off the drive, or compensate for it, before you use this. Nor does it hold asym_V and delay_s.
        Raises ValueError where this is no motor; ImportError where the package control is not installed.
        """
        motor = self.motor()
        control = needed("control", "to_control()")
        return control.tf([motor.K_rad_s_V], [motor.tau_s, 1.0, 0.0], inputs="u_V", outputs="y_rad", name=self.method)

    def judged(self, verdict: Verdict, *reasons: str, spoiled: bool = True) -> Self:
        """The estimate with a verdict at least as severe as ``verdict``, and further ``reasons``.

        spoiled   whether a refusal is for what no better fit mends; False: a motor that predicts is used all the same
        """
        worst = max(self.verdict, verdict, key=VERDICTS.index)
        new = tuple(reason for reason in reasons if reason not in self.reasons)
        spoils = self.spoiled or (spoiled and verdict == "refused")
        return replace(self, verdict=worst, reasons=self.reasons + new, spoiled=spoils)

    def as_result(self) -> EstimateResult:
        """As one entry of ``estimates`` in result.json; a number that is not finite becomes None."""
        memory_s, size = (None, None) if self.coloured is None else self.coloured
        return EstimateResult.of(
            self,
            covariance_of=PARAMETERS,
            covariance=self.covariance.tolist(),
            correlation=self.correlation.tolist(),
            residual=ResidualResult(repeated=self.repeated, wander_memory_s=memory_s, wander_over_white=size),
        )


def student_intervals(theta: Sequence[float], covariance: Array, freedom: float) -> dict[str, tuple[float, float]]:
    """95 % intervals of tau_s, K_rad_s_V and fc_V from their (3, 3) covariance and its degrees of freedom (>= 1)."""
    return intervals(theta, np.sqrt(np.diag(covariance)).tolist(), student_975(freedom))


def intervals(values: Sequence[float], errors: Sequence[float], quantile: float) -> dict[str, tuple[float, float]]:
    """``value -+ quantile * error`` of the first parameters, by name."""
    return {
        name: (value - quantile * error, value + quantile * error)
        for name, value, error in zip(PARAMETERS[: len(values)], values, errors, strict=True)
    }
