"""The step `angles`: the centre, and a potentiometer's readings at known angles."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rig.running.calibrate import wiring
from rig.running.calibrate.dialogue import NotMovedError, Read, Refusal, Talk
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.steps.questions import angle_error, angle_rad, standing

FEWEST = 3
FEWEST_FOR_LINEARITY = 5  # angles that show how straight a potentiometer is
_NOT_MOVED_COUNTS = 3.0
_SHORTEST_RAD, _LONGEST_RAD = math.radians(20.0), math.radians(3700.0)  # that a potentiometer's readings can span
_LARGEST_BEND = 0.1  # departure from a straight line, of the full range: none is that bad
_LINEARITY = 0.03  # departure that is doubted, of the full range
_SLIPS = (10.0, 0.1, 100.0, 0.01, -1.0, math.degrees(1.0), math.radians(1.0))  # how people mistype an angle
_MUCH_BETTER = 3.0
_SLIP_SPAN = 1.15  # a scale that is so close to a slip's factor is taken for it


class Angle(NamedTuple):
    """A reading at a known angle."""

    counts: float
    rad: float


@dataclass(frozen=True)
class Belief:
    """What is known of the potentiometer before.

    rad_per_count   by the config so far, without its sign; rough
    counts_max      largest reading of the converter
    error_rad       by how much each known angle may be off
    noise_counts    standard deviation of a reading
    """

    rad_per_count: float
    counts_max: int
    error_rad: float
    noise_counts: float

    @property
    def allowed_rad(self) -> float:
        """By how much an angle may be off a straight line: its own error, and a count with its noise."""
        return self.error_rad + (1.0 + 2.0 * self.noise_counts) * self.rad_per_count


@dataclass(frozen=True)
class SensorFit:
    """The calibration.

    points         counts and rad for ``sensor.calibration``: two of the straight line, or all angles of a curved one
    rad_per_count  of the straight line
    off_rad        each angle's distance from that line, in the order of the counts
    bend_rad       how far a parabola through the angles is from its line, at most; nan: fewer than four angles
    linearity_percent  departure from the line, with the error of the angles, in % of the full range; None: unknown,
                   with fewer than ``FEWEST_FOR_LINEARITY`` angles
    """

    points: tuple[tuple[int, float], ...]
    rad_per_count: float
    off_rad: tuple[float, ...]
    bend_rad: float
    linearity_percent: float | None

    @property
    def departure_rad(self) -> float:
        """The largest distance from the line."""
        return max(map(abs, self.off_rad))

    @property
    def is_straight(self) -> bool:
        """Whether two points describe it."""
        return len(self.points) == 2


def objection(before: Sequence[Angle], new: Angle, belief: Belief) -> Refusal | None:
    """What speaks against a new angle beside those before; None: nothing. The shaft still stands there.

    Raises NotMovedError, and Refusal for another angle that cannot be, whatever the others are.
    """
    for old in before:
        moved, turned = abs(new.counts - old.counts), abs(new.rad - old.rad)
        if turned == 0.0:
            raise Refusal(f"{_degrees(new.rad)} is given already", "turn the shaft to another angle")
        if moved < _NOT_MOVED_COUNTS and turned <= 2.0 * belief.allowed_rad:
            raise Refusal(
                f"{_degrees(new.rad)} is too near to {_degrees(old.rad)}: {moved:.0f} counts apart",
                "turn the shaft farther",
            )
        if moved < _NOT_MOVED_COUNTS:
            raise NotMovedError(
                f"the reading has not moved: {new.counts:.0f} counts at {_degrees(new.rad)}, as at {_degrees(old.rad)}",
                "turn the shaft; if you did, look at the sensor's wires and its coupling",
            )
    angles = [*before, new]
    _must_be_one_to_one(angles)
    if len(angles) < 2:
        return None
    scale = _slope(angles) / belief.rad_per_count
    if len(angles) == 2:
        slip = next((f for f in _SLIPS if f > 0.0 and 1.0 / _SLIP_SPAN < scale * f < _SLIP_SPAN), None)
        if slip is not None:
            return Refusal(
                f"{_degrees(new.rad)} at {new.counts:.0f} counts makes a count {scale:.3g} times as large as in the "
                "config",
                f"did you mean {_degrees(new.rad * slip)}? type the right angle; or the same again to keep it",
            )
        _must_be_a_potentiometer(angles, belief)
        return None
    worst_rad, _ = _departure(angles)
    if found := _slip(angles, belief):
        which, factor = found
        return Refusal(
            f"the angles are not on a line: off by up to {_degrees(worst_rad)}",
            f"did you mean {_degrees(angles[which].rad * factor)} instead of {_degrees(angles[which].rad)} at "
            f"{angles[which].counts:.0f} counts? type the angle again; the same again keeps it; `drop N` drops angle N",
        )
    full_rad = abs(_slope(angles)) * belief.counts_max
    if worst_rad > _LINEARITY * full_rad + belief.allowed_rad:
        return Refusal(
            f"the angles are off a line by up to {_degrees(worst_rad)}, {100.0 * worst_rad / full_rad:.1f} % of the "
            "sensor's full range",
            "type the angle again; the same again keeps it; `drop N` drops angle N",
        )
    return None


def sensor_fit(angles: Sequence[Angle], belief: Belief) -> SensorFit:
    """The calibration. Raises Refusal: too few angles, not one to one, no potentiometer, far from any line."""
    if len(angles) < FEWEST:
        raise Refusal(
            f"{len(angles)} angles are too few: {FEWEST} show a mistake, {FEWEST_FOR_LINEARITY} how straight the "
            "sensor is",
            "turn the shaft to another angle",
        )
    _must_be_one_to_one(angles)
    _must_be_a_potentiometer(angles, belief)
    counts, rad = (np.array(column, dtype=float) for column in zip(*sorted(angles), strict=True))
    slope, zero_rad = (float(c) for c in np.polyfit(counts, rad, 1))
    worst_rad, worst = _departure(sorted(angles))
    full_rad = abs(slope) * belief.counts_max
    if worst_rad > _LARGEST_BEND * full_rad:
        raise Refusal(
            f"the angle {_degrees(rad[worst])} at {counts[worst]:.0f} counts is off the line through all by "
            f"{_degrees(worst_rad)}: no potentiometer is so curved",
            "measure it again: `drop N` drops angle N",
        )
    bend_rad = math.nan
    if len(angles) > FEWEST:
        bend_rad = float(np.max(np.abs(np.polyval(np.polyfit(counts, rad, 2), counts) - (slope * counts + zero_rad))))
    linearity = None
    if len(angles) >= FEWEST_FOR_LINEARITY:
        linearity = 100.0 * (worst_rad + belief.error_rad) / full_rad
    if worst_rad <= belief.allowed_rad or linearity is None:
        chosen = [(c, slope * c + zero_rad) for c in (float(counts[0]), float(counts[-1]))]
        points = [(round(c), r + slope * (round(c) - c)) for c, r in chosen]
    else:
        points = [(round(c), r + slope * (round(c) - c)) for c, r in zip(counts.tolist(), rad.tolist(), strict=True)]
    off_rad = tuple((rad - slope * counts - zero_rad).tolist())
    return SensorFit(tuple((c, round(r, 5)) for c, r in points), slope, off_rad, bend_rad, linearity)


def _must_be_one_to_one(angles: Sequence[Angle]) -> None:
    table = sorted(angles)
    if len(table) < 2:
        return
    rising = table[-1].rad > table[0].rad
    for a, b in pairwise(table):
        if a.rad == b.rad or (b.rad > a.rad) != rising:
            raise Refusal(
                f"angles must only rise or only fall with counts, but {_degrees(a.rad)} is at {a.counts:.0f} counts "
                f"and {_degrees(b.rad)} at {b.counts:.0f}",
                "type the angle with its sign: positive to the side that you call positive; `drop N` drops angle N",
            )


def _must_be_a_potentiometer(angles: Sequence[Angle], belief: Belief) -> None:
    full_rad = abs(_slope(angles)) * belief.counts_max
    if not _SHORTEST_RAD <= full_rad <= _LONGEST_RAD:
        raise Refusal(
            f"by these angles the readings 0 to {belief.counts_max} span {_degrees(full_rad)}; a potentiometer has "
            f"{_degrees(_SHORTEST_RAD)} to {_degrees(_LONGEST_RAD)}",
            "angles are in degrees; write `0.5 rad` for radians",
        )


def _slope(angles: Sequence[Angle]) -> float:
    """Of the least squares line, rad for a count, without its sign."""
    counts, rad = zip(*angles, strict=True)
    return abs(float(np.polyfit(counts, rad, 1)[0]))


def _departure(angles: Sequence[Angle]) -> tuple[float, int]:
    """Largest distance from the least squares line, rad, and which angle it is."""
    counts, rad = (np.array(column, dtype=float) for column in zip(*angles, strict=True))
    off = np.abs(np.polyval(np.polyfit(counts, rad, 1), counts) - rad)
    return float(off.max()), int(off.argmax())


def _slip(angles: Sequence[Angle], belief: Belief) -> tuple[int, float] | None:
    """Which angle is mistyped, and the factor that puts it on the line of the others; None: no such mistake."""
    worst_rad, _ = _departure(angles)
    if worst_rad <= 2.0 * belief.allowed_rad:
        return None
    found = []
    for which, one in enumerate(angles):
        for factor in _SLIPS:
            mended = [*angles[:which], Angle(one.counts, one.rad * factor), *angles[which + 1 :]]
            left_rad, _ = _departure(mended)
            if left_rad < worst_rad / _MUCH_BETTER:
                unlike = abs(math.log(_slope(mended) / belief.rad_per_count))
                found.append((left_rad / belief.allowed_rad > 1.0, round(unlike, 1), left_rad, which, factor))
    return (min(found)[3], min(found)[4]) if found else None


def _degrees(rad: float) -> str:
    return f"{math.degrees(rad):.4g}°"


def angles_step(talk: Talk, draft: Draft) -> Draft:
    """Sets sensor.calibration, .linearity_percent and .calibration_error_rad."""
    e = draft.experiment
    low, high = (math.degrees(limit) for limit in e.limits.hard_rad)
    talk.say(
        "The motor's supply is off. Turn the shaft by hand to angles that you know, say by a printed protractor.\n"
        "Five angles show how straight the sensor is; three are the least. The outer ones should lie beyond the hard\n"
        f"limits, {low:.0f}° and {high:.0f}° so far. Positive is the side that you call so."
    )
    error_rad = angle_error(talk, e.sensor.calibration_error_rad)
    belief = Belief(e.sensor.curve.lsb_rad, e.sensor.counts_max or 0, error_rad, 0.0)
    angles: list[Angle] = []
    doubted_rad = math.nan
    while True:
        try:
            if not angles:
                talk.ask("turn the shaft to the middle of its travel, where 0 is to be", empty="it is there")
                answer, rad = "0", 0.0
            else:
                answer = talk.ask(
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
                    talk.say(_dropped(angles, int(dropped[1])))
                    continue
                rad = angle_rad(answer)
            draft, reading = standing(talk, draft, Read(e, rad))
            belief = replace(belief, noise_counts=max(belief.noise_counts, reading.noise_counts))
            new = Angle(reading.y_counts, rad)
            doubt = _objection(draft, angles, new, belief)
            if doubt is not None and rad != doubted_rad:
                doubted_rad = rad
                raise doubt
            angles.append(new)
            talk.say(f"angle {len(angles)}: {math.degrees(rad):+.4g}° at {new.counts:g} counts", "found")
        except Refusal as refusal:
            talk.refuse(refusal)
    talk.say(_table(sorted(angles), fit) + "\n" + _fit_words(fit, belief), "found")
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
        talk.say(
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
