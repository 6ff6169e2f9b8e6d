"""A tuned loop, its prediction and a bench's trial, as `rig tune --json` and a run's result.json have them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.design.tune.margins import Margins
from rig.design.tune.prediction import MEASURES, Prediction, shown_of, speed_of
from rig.design.tune.trial import Record, smoothed
from rig.design.tune.tuning import Tuned, as_pid
from rig.run_folder.results import JsonObject
from rig.run_folder.results.tuned import (
    TunedCurve,
    TunedFeedForward,
    TunedMargins,
    TunedMeasure,
    TunedResponse,
    TunedResult,
)

INNER = (2.5, 50.0, 97.5)  # percentiles of a curve
BEFORE_S = 0.1  # of the step that a curve shows
DIGITS = 6  # significant ones of a curve


def result_of(tuned: Tuned, prediction: Prediction, bench: Record | None, run: str, law: JsonObject) -> TunedResult:
    """All of it.

    bench  the recorded trial; None: there was none, or it did not come to its end
    run    the folder that the motor comes from
    law    name and options of the law
    """
    linear, position = tuned.motor.linear, tuned.wish.loop == "position"
    shown = None if bench is None else shown_of(tuned, bench, prediction.trial)
    measures = {}
    for name, one in prediction.ranges.items():
        meaning, *units = MEASURES[name]
        measures[name] = TunedMeasure(
            meaning=meaning,
            unit=units[0 if position else 1],
            median=_number(one.median),
            interval95=(_number(one.low), _number(one.high)),
            bench=None if shown is None else _number(shown[name]),
            inside=None if shown is None else one.holds(shown[name]),
        )
    return TunedResult(
        run=run,
        loop=tuned.wish.loop,
        bandwidth_rad_s=tuned.bandwidth_1_s,
        largest_bandwidth_rad_s=tuned.largest_1_s,
        bounded_by=tuned.bound_by,
        step=tuned.wish.step,
        pid=as_pid(tuned.gains, linear.tau_s, linear.K_rad_s_V),
        feedforward=TunedFeedForward(
            kS_V=tuned.motor.framed.motor.fc_V + tuned.motor.framed.motor.dead_band_V,
            kV_V_s_rad=1.0 / linear.K_rad_s_V,
            kA_V_s2_rad=linear.tau_s / linear.K_rad_s_V,
        ),
        margins={"nominal": _margins(tuned.nominal), "worst": _margins(tuned.worst)},
        drive_noise_V=tuned.noise_V,
        draws=len(prediction.records),
        prediction=measures,
        curves=_curves(tuned, prediction, bench),
        responses=tuple(TunedResponse(real=_short(L.real), imaginary=_short(L.imag)) for L in tuned.responses()),
        law=law,
    )


def _curves(tuned: Tuned, prediction: Prediction, bench: Record | None) -> dict[str, TunedCurve]:
    """The step, the drive during it, and the error along the trajectory."""
    trial, first = prediction.trial, prediction.records[0]
    position = tuned.wish.loop == "position"

    def measured(one: Record) -> Array:
        return one.y_rad if position else smoothed("velocity", one.t_s, one.y_rad)

    def wanted(one: Record) -> Array:
        return one.yd_rad if position else speed_of(one, trial)

    def curve(of: Callable[[Record], Array], span_s: tuple[float, float], zero_s: float, unit: str) -> TunedCurve:
        rows = _rows(first, span_s)
        low, median, high = np.percentile([of(one)[rows] for one in prediction.records], INNER, axis=0)
        found = TunedCurve(
            unit=unit, t_s=_short(first.t_s[rows] - zero_s), low=_short(low), median=_short(median), high=_short(high)
        )
        if bench is None:
            return found
        here = _rows(bench, span_s)
        times = _short(bench.t_s[here] - bench.t_s[0] - zero_s)
        return found.model_copy(update={"bench_t_s": times, "bench": _short(of(bench)[here])})

    begin_s, end_s = trial.step_s
    # the drive of the last sample begins the way back
    step_s, unit = (begin_s - BEFORE_S, end_s - tuned.sensing.period_s), "rad" if position else "rad/s"
    reference = _short(wanted(first)[_rows(first, step_s)])
    found = {
        "step": curve(measured, step_s, begin_s, unit).model_copy(update={"reference": reference}),
        "drive": curve(lambda one: one.u_V, step_s, begin_s, "V"),
    }
    if trial.tracking_s is not None:
        found["tracking"] = curve(lambda one: wanted(one) - measured(one), trial.tracking_s, trial.tracking_s[0], unit)
    return found


def _rows(record: Record, span_s: tuple[float, float]) -> NDArray[np.int64]:
    elapsed = record.t_s - record.t_s[0]
    return np.flatnonzero((elapsed >= span_s[0] - 1e-9) & (elapsed <= span_s[1] + 1e-9))


def _short(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{one:.{DIGITS}g}") for one in values.tolist())


def _margins(margins: Margins) -> TunedMargins:
    return TunedMargins(phase_deg=margins.phase_deg, gain_dB=_number(margins.gain_dB), modulus=margins.modulus)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
