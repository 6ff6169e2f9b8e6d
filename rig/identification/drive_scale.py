"""What an answer is worth where a servo's own loop gave the drive: no manual says well what its P means. Pure.

Besides, nobody knows to a millisecond how old the position is that a duty comes from. If it is older by d than it is
taken to be, that does what a viscous friction of -gain x d would do: tau and K are off by the share K x gain x d, and
no record shows it. So do I and D gains that are not 0. So do goals that are written, or positions that are read, later
than the log says: the fitted delay shows that something is late, and not what. Goals that jump late give full duty the
wrong way meanwhile, which a fit takes for friction.

A filter in a column that was found leaves something unknown, too: `by_filter`. So do steps of a drive that is not what
the motor got: `by_steps`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from rig.identification.motor_law import graded
from rig.identification.verdict import ASKED, TITLES, in_percent
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.recording.servo_law import OwnLoop
from rig.run_folder.results import Answer, known

# of the share of tau and K, where something is shown to be late: with goals that jump, 8 to 15 ms late, f_c was off by
# up to 2.7 times it in simulations
OF_FRICTION: Final = 3.0
# Of the time constant of a filter: of 50 ms 1 to 2.5 ms were missing, behind velocities in steps of 10 rpm, or noise
OF_FILTER: Final = 0.05
# Of each number, where firmware limits the speed, by what the numbers of made logs were off
OF_LIMIT: Final = {"tau_s": 0.05, "K_rad_s_V": 0.05, "fc_V": 0.15}
# Of a step of the drive, that f_c may be off by, where drives are cut off: 0.6 at most in made logs. Residual over the
# way of a step from one drive to the next, at least, where the motor got finer ones: 0.016 in 30 made logs
OF_STEP, OF_WAY = 0.6, 0.01
# Of a drive in steps: so few levels may be a relay's; from lowest to highest; places of levels, in steps; share of
# changes by one step; levels of one that jumps, more; how the lengths of drives scatter, of their mean; digits of V
FEWEST_LEVELS, MOST_STEPS, WHOLE, GOES_ON, JUMPS_TO, UNEVEN, DIGITS = 5, 66.0, 0.05, 0.8, 12, 0.25, 9
LATE_S: Final = 1e-3  # by which the position may be older or newer than the middle of its step, at 95 %; assumption


def by_own_loop(answer: Answer, loop: OwnLoop) -> Answer:
    """The answer with what the loop leaves unknown in tau, K and f_c, and the reasons where that is much."""
    scale = loop.scale
    delay_s = known(answer.delay_s)
    late_s = max(LATE_S, abs(delay_s) - LATE_S) if math.isfinite(delay_s) else LATE_S
    unsure, late = scale.high / scale.middle - 1.0, abs(known(answer.K_rad_s_V)) * loop.gain_V_rad * late_s
    late = late if math.isfinite(late) else 0.0
    rubs = OF_FRICTION * late if late_s > LATE_S else 0.0
    reasons = []
    if unsure > 0.0:
        reasons.append(
            f"what a step of the servo's P means is known to a factor of {scale.high / scale.low:.3g} only "
            f"({scale.source}), so K and f_c are off by up to {in_percent(unsure)}, and laws in volts; tau hardly: "
            "`rig servo facts` measures it, --p-scale states it"
        )
    if late > ASKED and late_s > LATE_S:
        when = f"{1e3 * abs(delay_s):.2g} ms {'after' if delay_s > 0.0 else 'before'}"
        reasons.append(
            f"the shaft moves {when} the duty that goals and positions say: which of them is late nobody knows, and "
            f"that makes tau and K up to {in_percent(late)} wrong, f_c up to {in_percent(rubs)}; write each goal when "
            "its row's position is read, and record with a smaller P; or, if the positions are old, say so: "
            "--position-age"
        )
    elif late > ASKED:
        reasons.append(
            f"how old a position its own loop works with nobody has measured: 1 ms makes tau and K {in_percent(late)} "
            "wrong; record with a smaller P"
        )
    if not loop.is_P_alone:
        reasons.append(
            "an I or D of the servo's loop that is not 0 makes tau and K wrong, and nothing shows it: "
            "say what it had, --gain P,I,D"
        )
    return _widened(
        answer, {"tau_s": late, "K_rad_s_V": math.hypot(unsure, late), "fc_V": math.hypot(unsure, rubs)}, reasons
    )


def by_filter(answer: Answer, lag_s: float, left: float = 0.0, moves: tuple[float, float] = (0.0, 0.0)) -> Answer:
    """The answer with what a filter of this time constant in a column leaves unknown in tau, K and f_c.

    left    share of the time constant that may be missing, as the fit says; 1.0: it was not undone
    moves   what this share moves K by, of itself, and f_c, V: where a drive of one size alone reverses the shaft, what
            a filter takes from each reversal is much of f_c
    What is missing in the filter's time constant is too much in tau: a record shows their sum.
    """
    tau_s = abs(known(answer.value("tau_s")))
    share = max(OF_FILTER, left) * lag_s / tau_s if answer.u95 and tau_s > 0.0 else 0.0
    reasons = []
    if left == 1.0:
        reasons.append(
            f"position or drive seem to be smoothed, and so late by {1e3 * lag_s:.2g} ms, in a way that cannot be "
            "undone, which makes tau wrong, and may make K and f_c wrong: log both as they are"
        )
    elif share > ASKED:
        reasons.append(
            f"a filter of {1e3 * lag_s:.3g} ms in the log makes tau up to {in_percent(share)} wrong: log position and "
            "drive, or the velocity, as they are"
        )
    fc_V = abs(known(answer.value("fc_V")))
    of_fc = moves[1] / fc_V if answer.u95 and fc_V > 0.0 else 0.0
    return _widened(answer, {"tau_s": share, "K_rad_s_V": moves[0] if answer.u95 else 0.0, "fc_V": of_fc}, reasons)


def by_bends(answer: Answer, moves: tuple[float, float, float]) -> Answer:
    """The answer with what is not known of the bends between samples: of tau and K, of themselves, and of f_c, V."""
    fc_V = abs(known(answer.value("fc_V")))
    shares = {"tau_s": moves[0], "K_rad_s_V": moves[1], "fc_V": moves[2] / fc_V if fc_V > 0.0 else 0.0}
    worst = max(shares, key=lambda name: shares[name])
    reason = (
        f"{TITLES[worst]} is only known to {in_percent(shares[worst])} behind what was done to the velocity before it "
        "was logged: log the position"
    )
    return _widened(answer, shares, [reason] if shares[worst] > ASKED else []) if answer.u95 else answer


def by_steps(answer: Answer, step_V: float, largest_V: float) -> Answer:
    """The answer with what a drive rounded to steps leaves unknown: friction by half a step if it is cut off."""
    fc_V, share = abs(known(answer.value("fc_V"))), step_V / largest_V
    reason = (
        f"the drive is logged in steps of {step_V:.3g} V; did the motor get finer ones? Then K and f_c are wrong: log "
        "the drive as fine as it is"
    )
    shares = {"tau_s": share, "K_rad_s_V": share, "fc_V": OF_STEP * step_V / fc_V if fc_V > 0.0 else 0.0}
    return _widened(answer, shares if answer.u95 else {}, [reason])


def drive_step_V(test: TimeSeries) -> float:
    """The step of a drive that varies freely, and is logged as one of few levels that are evenly apart, V; 0.0 else.

    Drives that jump between levels, or go through them at one pace, are levels that the motor got: a relay, a stair.
    """
    begins = np.flatnonzero(np.diff(test.u_V, prepend=np.nan))
    drives_V, lasts = test.u_V[begins], np.diff(np.append(begins, len(test)))
    levels = np.unique(np.round(drives_V, DIGITS))
    if levels.size < FEWEST_LEVELS:
        return 0.0
    step_V = float(np.diff(levels).min())
    places = (levels - levels[0]) / step_V
    is_even = places[-1] < MOST_STEPS and np.abs(places - np.round(places)).max() < WHOLE
    goes_on = float(np.mean(np.abs(np.diff(drives_V)) < 1.5 * step_V)) > GOES_ON or levels.size > JUMPS_TO
    is_free = float(np.std(lasts)) > UNEVEN * float(np.mean(lasts))
    return step_V if is_even and goes_on and is_free else 0.0


def hidden_step_V(test: TimeSeries, K_rad_s_V: float, rms_rad: float) -> float:
    """The step of the drive behind which the motor may have got finer ones, V; 0.0 where it leaves less than that."""
    step_V, changes = drive_step_V(test), int(np.count_nonzero(np.diff(test.u_V)))
    way_rad = abs(K_rad_s_V) * step_V * float(np.ptp(test.t_s)) / max(1, changes)
    return 0.0 if rms_rad < OF_WAY * way_rad else step_V


def by_speed_limit(answer: Answer) -> Answer:
    """The answer with what a limit of the speed in the firmware leaves unknown: when it holds no row says exactly."""
    reason = (
        "firmware seems to limit the speed, so the drive is not what the motor got: record with smaller drives, or "
        "log the bridge's duty"
    )
    return _widened(answer, OF_LIMIT, [reason])


def _widened(answer: Answer, shares: Mapping[str, float], reasons: Sequence[str]) -> Answer:
    """The answer with numbers that may be off by these shares of themselves, too; doubtful if there are reasons."""
    u95, absolute, grade = dict(answer.u95 or {}), dict(answer.u95_absolute or {}), dict(answer.grade or {})
    for name, share in shares.items():
        value = known(answer.value(name))
        for halves in (u95, absolute):
            halves[name] = _wider(halves.get(name), share * abs(value)) if share > 0.0 else halves.get(name)
        if (share > 0.0 or value == 0.0) and name in grade and grade[name].value is not None:
            grade[name] = graded(value, u95[name], abs(value))
    verdict = "doubtful" if reasons and answer.verdict == "ok" else answer.verdict
    return answer.model_copy(
        update={
            "u95": u95,
            "u95_absolute": absolute,
            "grade": grade or None,
            "verdict": verdict,
            "reasons": (*reasons, *answer.reasons),
        }
    )


def _wider(half: float | None, more: float) -> float:
    return more if half is None else math.hypot(half, more)
