"""One experiment of a campaign: simulate it, identify it as a plain motor, compare with the truth and the bound.

If an experiment raises an exception, its row says so, and the other experiments go on.
"""

from __future__ import annotations

import math
import time
import traceback
from pathlib import Path

import numpy as np

from rig.campaign.random_motors import CampaignError, Draw, draw, simulate
from rig.config.campaign import Campaign
from rig.identification import IdentifyError, identify, sampled_data
from rig.identification.cramer_rao import PositionNoise, cramer_rao
from rig.identification.estimate import PARAMETERS, Estimate
from rig.identification.output_error import refit
from rig.model.sampled_relay import SimulatedRelayTest
from rig.model.sensitivity import Theta
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.recording import Recording, from_columns
from rig.run_folder.recording.series import LEAST_DELAY_S, TimeSeries, steps_of
from rig.run_folder.results import RunMeta

Row = dict[str, int | float | str]  # COLUMNS says of which kind each is
FAILED = "failed"  # verdict of an experiment that raised an exception

TRUTHS = ("h1_V", "h2_V", "period_s", "offset_rad", "start_rad", "clock_ratio")
# Column -> int, float or str, in the order of the result file. Without an estimate its columns are nan.
COLUMNS: dict[str, type] = {
    "number": int,
    **{f"true_{name}": float for name in (*PARAMETERS, *TRUTHS)},
    **dict.fromkeys(PARAMETERS, float),
    **{f"se_{name}": float for name in PARAMETERS},  # standard error by the estimator
    **{f"low_{name}": float for name in PARAMETERS},  # nominal 95 % interval
    **{f"high_{name}": float for name in PARAMETERS},
    **{f"bound_{name}": float for name in PARAMETERS},  # Cramer-Rao; nan without noise or for a known delay
    "samples": int,
    "cycles": float,  # true number of recorded cycles
    "repeated": float,
    "iterations": int,
    "rms_rad": float,
    "second_rms_rad": float,  # residual of the second test, predicted by the estimate; nan without that test
    "second_own_rms_rad": float,  # residual of the second test, predicted by the true motor
    "verdict": str,
    "reasons": str,
    "seconds": float,
}
_EMPTY: dict[type, int | float | str] = {int: 0, float: math.nan, str: ""}
_BLANK: Row = {name: _EMPTY[kind] for name, kind in COLUMNS.items()}


def row_of(campaign: Campaign, number: int) -> Row:
    """The row of experiment ``number``, with ``COLUMNS``. If an exception ends the experiment, its verdict is "failed".

    Raises CampaignError if the ranges give no experiment. Then no other number gives one.
    """
    began = time.perf_counter()
    try:
        return run_trial(campaign, number)
    except CampaignError:
        raise
    except Exception as error:  # noqa: BLE001 - no error of one experiment may end the thousands of others
        seconds = time.perf_counter() - began
        return _BLANK | {"number": number, "verdict": FAILED, "reasons": _in_words(error), "seconds": seconds}


def _in_words(error: Exception) -> str:
    """The exception and where it was raised, e.g. ``ZeroDivisionError: division by zero (motor.py:120)``."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    return " ".join(f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})".split())


def run_trial(campaign: Campaign, number: int) -> Row:
    """The row of experiment ``number``, with ``COLUMNS``. Raises CampaignError if the ranges give no experiment."""
    began = time.perf_counter()
    one = draw(campaign, number)
    test, rows = simulate(campaign, one)
    row: Row = _BLANK | {"number": number}
    row |= {f"true_{name}": float(getattr(one, name)) for name in (*PARAMETERS, *TRUTHS)}
    bound = _bound(campaign, one, test, rows)
    row |= {f"bound_{name}": bound[name] for name in PARAMETERS}
    row |= {"samples": rows.stop - rows.start, "cycles": _cycles(test, rows)}
    try:
        recording = _recording(campaign, one, test, rows)
        estimate = identify([recording], (sampled_data.METHOD,), choose_law=False).estimates[sampled_data.METHOD]
    except (IdentifyError, RecordingError) as error:
        row |= {"verdict": "refused", "reasons": error.cause}
    else:
        row |= _columns(estimate)
        row |= _second(campaign, one, estimate)
    row["seconds"] = time.perf_counter() - began
    return row


def _recording(campaign: Campaign, one: Draw, test: SimulatedRelayTest, rows: slice) -> Recording:
    """The recorded rows as columns of a plain CSV. A clock with its own rate adds late_us and period_s."""
    sampling = campaign.sampling
    own_clock = sampling.clock_ratio != (1.0, 1.0)
    count = rows.stop - rows.start
    t_0 = test.t_s[rows.start]
    return from_columns(
        Path(f"experiment-{one.number}"),
        one.clock_ratio * (test.t_s[rows] - t_0),
        test.u_V[rows],
        test.y_rad[rows],
        one.clock_ratio * (test.t_u_s[rows] - t_0) if sampling.times_known else None,
        np.zeros(count) if own_clock else None,
        RunMeta(period_s=sampling.period_s) if own_clock else None,
    )


def _bound(campaign: Campaign, one: Draw, test: SimulatedRelayTest, rows: slice) -> dict[str, float]:
    """Cramer-Rao bound from the samples that the estimator can use: those with a known drive."""
    sampling, sensor = campaign.sampling, campaign.sensor
    if sensor.noise_rad == 0.0 and sensor.lsb_rad == 0.0:
        return dict.fromkeys(PARAMETERS, math.nan)
    known = sampling.times_known
    edges = test.t_u_s[rows] if known else test.t_s[rows]
    longest_s = 0.0 if known else max(2.0 * sampling.period_s, LEAST_DELAY_S)
    first = rows.start + int(np.searchsorted(test.t_s[rows], edges[0] + longest_s))
    theta = Theta(
        one.tau_s,
        one.K_rad_s_V,
        one.fc_V,
        one.asym_V,
        0.0 if known else one.delay_s,
        float(test.true_v_rad_s[first]),
        float(test.true_y_rad[first]) + one.offset_rad,
    )
    correlated = sensor.correlated
    noise = PositionNoise(
        sensor.noise_rad,
        sensor.lsb_rad,
        0.0 if correlated is None else correlated.std_rad,
        0.0 if correlated is None else correlated.coefficient,
    )
    steps = steps_of(edges, test.u_V[rows])
    bound = cramer_rao(theta, steps, test.t_s[first : rows.stop], noise, delay_known=known)
    found = dict(zip(PARAMETERS, bound[: len(PARAMETERS)].tolist(), strict=True))
    return found | ({"delay_s": math.nan} if known else {})


def _cycles(test: SimulatedRelayTest, rows: slice) -> float:
    """Number of falls of the integral through zero within the rows, less one."""
    z = test.z_rad_s[rows]
    return max(0.0, float(np.count_nonzero((z[1:] < 0.0) & (z[:-1] >= 0.0))) - 1.0)


def _columns(estimate: Estimate) -> Row:
    row: Row = {name: float(getattr(estimate, name)) for name in PARAMETERS}
    errors = np.sqrt(np.diag(estimate.covariance))
    for name, error in zip(PARAMETERS, errors.tolist(), strict=True):
        low, high = estimate.ci95.get(name, (math.nan, math.nan))
        row |= {f"se_{name}": error, f"low_{name}": low, f"high_{name}": high}
    return row | {
        "repeated": estimate.repeated,
        "iterations": estimate.iterations,
        "rms_rad": float(estimate.rms_rad),
        "verdict": estimate.verdict,
        "reasons": " | ".join(estimate.reasons),
    }


def _second(campaign: Campaign, one: Draw, estimate: Estimate) -> Row:
    """Residuals of the second test, predicted by the estimate and by the true motor."""
    if campaign.relay.second is None:
        return {}
    test, rows = simulate(campaign, one, second=True)
    known = campaign.sampling.times_known
    series = TimeSeries(test.t_s[rows], test.y_rad[rows], test.t_u_s[rows] if known else None, test.u_V[rows])
    true = Theta(one.tau_s, one.K_rad_s_V, one.fc_V, one.asym_V, 0.0 if known else one.delay_s)
    found = Theta(
        estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, 0.0 if known else estimate.delay_s
    )
    return {"second_rms_rad": _residual_rad(series, found), "second_own_rms_rad": _residual_rad(series, true)}


def _residual_rad(series: TimeSeries, theta: Theta) -> float:
    """RMS residual of a series, rad, with only its initial state fitted."""
    return refit([series], theta).rms_rad
