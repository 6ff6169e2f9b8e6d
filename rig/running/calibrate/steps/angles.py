"""The step `angles`: the centre, and a potentiometer's readings at known angles."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

from rig.running.calibrate import wiring
from rig.running.calibrate.dialogue import Ask, Read, Say
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.refusal import NotMovedError, Refusal
from rig.running.calibrate.steps.questions import Steps, angle_error, angle_rad, refused, standing
from rig.running.calibrate.sums.angles import Angle, Belief, SensorFit, objection, sensor_fit


def angles_step(draft: Draft) -> Steps[Draft]:
    """Sets sensor.calibration, .linearity_percent and .calibration_error_rad."""
    e = draft.experiment
    low, high = (math.degrees(limit) for limit in e.limits.hard_rad)
    yield Say(
        "The motor's supply is off. Turn the shaft by hand to angles that you know, say by a printed protractor.\n"
        "Five angles show how straight the sensor is; three are the least. The outer ones should lie beyond the hard\n"
        f"limits, {low:.0f}° and {high:.0f}° so far. Positive is the side that you call so."
    )
    error_rad = yield from angle_error(e.sensor.calibration_error_rad)
    belief = Belief(e.sensor.curve.lsb_rad, e.sensor.counts_max or 0, error_rad, 0.0)
    angles: list[Angle] = []
    doubted_rad = math.nan
    while True:
        try:
            if not angles:
                yield Ask("turn the shaft to the middle of its travel, where 0 is to be", empty="it is there")
                answer, rad = "0", 0.0
            else:
                answer = yield Ask(
                    f"angle {len(angles) + 1}: turn the shaft there, and type the angle in degrees",
                    "angle",
                    empty="no more angles",
                    commands=_commands(angles),
                )
                if answer.strip() == "":
                    fit = sensor_fit(angles, belief)
                    break
                if answer.strip() == "again":
                    angles = []
                    continue
                if dropped := re.fullmatch(r"\s*drop\s+(\d+)\s*", answer):
                    yield Say(_dropped(angles, int(dropped[1])))
                    continue
                rad = angle_rad(answer)
            draft, reading = yield from standing(draft, Read(e, rad))
            belief = replace(belief, noise_counts=max(belief.noise_counts, reading.noise_counts))
            new = Angle(reading.y_counts, rad)
            doubt = _objection(draft, angles, new, belief)
            if doubt is not None and rad != doubted_rad:
                doubted_rad = rad
                raise doubt
            angles.append(new)
            yield Say(f"angle {len(angles)}: {math.degrees(rad):+.4g}° at {new.counts:g} counts", "found")
        except Refusal as refusal:
            yield refused(refusal)
    yield Say(_table(sorted(angles), fit) + "\n" + _fit_words(fit, belief), "found")
    draft = draft.with_changes(
        {
            ("sensor", "calibration"): [{"counts": counts, "rad": rad} for counts, rad in fit.points],
            ("sensor", "calibration_error_rad"): round(error_rad, 4),
        }
    )
    if fit.linearity_percent is not None:
        percent = math.ceil(100.0 * fit.linearity_percent) / 100.0
        draft = draft.with_changes({("sensor", "linearity_percent"): percent})
    shown = sorted(rad for _, rad in fit.points)
    low, high = e.limits.hard_rad
    if not (shown[0] <= low and high <= shown[-1]):
        yield Say(
            f"the angles reach from {shown[0]:.3g} to {shown[-1]:.3g} rad, not as far as limits.hard_rad [{low:g}, "
            f"{high:g}]: do the step `travel`, or this one again with angles farther out"
        )
    return draft


def _commands(angles: Sequence[Angle]) -> tuple[tuple[str, str], ...]:
    """What else may be answered: an angle dropped, or all of them."""
    drops = ((f"drop {k}", f"drop {math.degrees(a.rad):+.4g}°") for k, a in enumerate(angles[1:], 2))
    return (*drops, ("again", "begin anew with the centre"))


def _dropped(angles: list[Angle], number: int) -> str:
    """Take an angle out of the list; the words for it. The first one, the centre, stays: `again` begins anew."""
    if not 2 <= number <= len(angles):
        raise Refusal(
            f"there is no angle {number} to drop", f"2 to {len(angles)}; the centre goes with all others: `again`"
        )
    gone = angles.pop(number - 1)
    left = ", ".join(f"{k}: {math.degrees(a.rad):+.4g}°" for k, a in enumerate(angles, 1))
    return f"{math.degrees(gone.rad):+.4g}° is dropped; left are {left}"


def _objection(draft: Draft, before: Sequence[Angle], new: Angle, belief: Belief) -> Refusal | None:
    """As ``objection``; a reading that has not moved comes with the sensor's wires."""
    try:
        return objection(before, new, belief)
    except NotMovedError as refusal:
        raise Refusal(refusal.cause, refusal.cure, wiring.sensor(draft.board)) from refusal


def _table(angles: Sequence[Angle], fit: SensorFit) -> str:
    lines = ["     angle   counts   off the line"]
    for angle, off_rad in zip(angles, fit.off_rad, strict=True):
        lines.append(f"{math.degrees(angle.rad):+9.2f}° {angle.counts:8.1f} {math.degrees(off_rad):+12.2f}°")
    return "\n".join(lines)


def _fit_words(fit: SensorFit, belief: Belief) -> str:
    full_rad = abs(fit.rad_per_count) * belief.counts_max
    words = [
        f"one count is {math.degrees(fit.rad_per_count):+.4f}°; the farthest angle is "
        f"{math.degrees(fit.departure_rad):.2f}° off the line, {100.0 * fit.departure_rad / full_rad:.2f} % of the "
        "full range"
    ]
    if math.isfinite(fit.bend_rad):
        words.append(f"a parabola through the angles bends by {math.degrees(fit.bend_rad):.2f}°")
    words.append(
        "two points of the line are the calibration"
        if fit.is_straight
        else "the line does not fit: the calibration is the table of all angles"
    )
    if fit.linearity_percent is None:
        words.append("fewer than five angles do not show linearity_percent: it stays as it is")
    return "; ".join(words)
