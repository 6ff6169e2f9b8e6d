"""The step `travel`: the mechanical stops, and the limits inside them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from rig.running.calibrate import wiring
from rig.running.calibrate.dialogue import Read, Refusal, Say, Talk
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.steps.questions import MOVED_COUNTS, must_stand
from rig.running.preflight.room_to_stop import limits_are_ordered, room_rad, stopping_rad

MARGIN_RAD = 0.2  # from a hard limit to the stop behind it
_LEAST_RAD = 0.3  # from the centre to a hard limit: less is too little to stop and to measure in

Interval = tuple[float, float]


@dataclass(frozen=True)
class Travel:
    """The limits, rad; and the end of each side: `stop` or `calibration`, whichever comes first."""

    soft_rad: Interval
    hard_rad: Interval
    ends: tuple[str, str]


def travel(stops_rad: Interval, shown_rad: Interval, before: tuple[Interval, Interval]) -> Travel:
    """Hard limits inside stops and calibration; soft limits in the same proportion to them as before.

    stops_rad  where the shaft meets its stops; infinite: there is none
    shown_rad  positions that the calibration covers
    before     soft and hard limits of the config so far, rad
    Raises Refusal: the stops in the wrong order, the centre outside, no room.
    """
    low_rad, high_rad = stops_rad
    if low_rad >= high_rad:
        raise Refusal(
            f"the low stop is at {_rad(low_rad)} and the high stop at {_rad(high_rad)}: the wrong way round",
            "the high stop is that to the positive side of your angles: begin with the other one",
        )
    if not low_rad < 0.0 < high_rad:
        raise Refusal(
            f"the centre, 0, is outside the travel: {_rad(low_rad)} to {_rad(high_rad)}",
            "0 must be near the middle between the stops: measure the angles again, from that middle",
        )
    inside = (low_rad + MARGIN_RAD, high_rad - MARGIN_RAD)
    hard_rad = _inward(max(inside[0], shown_rad[0]), min(inside[1], shown_rad[1]))
    ends = tuple(
        "stop" if abs(limit) < abs(shown) else "calibration" for limit, shown in zip(inside, shown_rad, strict=True)
    )
    if not (hard_rad[0] <= -_LEAST_RAD and hard_rad[1] >= _LEAST_RAD):
        raise Refusal(
            f"hard limits would be {_rad(hard_rad[0])} to {_rad(hard_rad[1])}, {MARGIN_RAD} rad inside the stops and "
            "within the calibrated angles: too little to stop and to measure in",
            f"at least {_LEAST_RAD} rad to each side: calibrate farther out, or put the centre in the middle",
        )
    soft, hard = before
    soft_rad = _inward(hard_rad[0] * soft[0] / hard[0], hard_rad[1] * soft[1] / hard[1])
    return Travel(soft_rad, hard_rad, (ends[0], ends[1]))


def _inward(low_rad: float, high_rad: float) -> Interval:
    """To the hundredth, inward."""
    return math.ceil(100.0 * low_rad - 1e-6) / 100.0, math.floor(100.0 * high_rad + 1e-6) / 100.0


def _rad(rad: float) -> str:
    return f"{rad:+.3f} rad ({math.degrees(rad):+.1f}°)"


def travel_step(talk: Talk, draft: Draft) -> Draft:
    """Sets limits.hard_rad and .soft_rad; limits.max_speed_rad_s where there is no room to stop from it."""
    e = draft.experiment
    answer = talk.choice(
        None, "does the shaft have mechanical stops?", (("yes", "it meets one on each side"), ("no", "it turns freely"))
    )
    while True:
        try:
            stops = (-math.inf, math.inf)
            if answer == "yes":
                draft, stops = _stops(talk, draft)
            points = e.sensor.points
            shown = (-math.inf, math.inf)
            if e.sensor.encoder is None:
                shown = (min(r for _, r in points), max(r for _, r in points))
            elif answer == "no":
                talk.say("without stops and without a calibrated range the limits stay as they are")
                return draft
            found = travel(stops, shown, (e.limits.soft_rad, e.limits.hard_rad))
            break
        except Refusal as refusal:
            talk.refuse(refusal)
            talk.ask("get ready to measure the travel again", empty="measure again")
    talk.say(_travel_words(found), "found")
    low, high = e.limits.hard_rad
    if found.hard_rad[0] <= low and high <= found.hard_rad[1]:
        wanted = talk.choice(
            None,
            f"limits.hard_rad [{low:g}, {high:g}] are inside: keep them, or widen them?",
            (("keep", ""), ("widen", "")),
        )
        if wanted == "keep":
            return draft
    draft = draft.with_changes(
        {("limits", "soft_rad"): list(found.soft_rad), ("limits", "hard_rad"): list(found.hard_rad)}
    )
    return _with_room_to_stop(talk, draft)


def _with_room_to_stop(talk: Talk, draft: Draft) -> Draft:
    """With a largest speed from which the shaft stops inside the limits, if somebody says yes to that."""
    e = draft.experiment
    d = e.device
    distance_rad, room = stopping_rad(d), room_rad(d)
    if not limits_are_ordered(d) or distance_rad <= room:
        return draft
    speed_rad_s = math.floor(100.0 * e.limits.max_speed_rad_s * room / distance_rad) / 100.0
    answer = talk.choice(
        Say(
            f"from limits.max_speed_rad_s, {e.limits.max_speed_rad_s:g}, the shaft would need {distance_rad:.2f} rad "
            f"to stop; there are {room:.2f} rad from the centre to the nearer hard limit",
            "refused",
        ),
        f"lower limits.max_speed_rad_s to {speed_rad_s:g}?",
        (("yes", "a faster shaft ends the run"), ("no", "`rig check` will refuse the config")),
    )
    return draft.with_changes({("limits", "max_speed_rad_s"): speed_rad_s}) if answer == "yes" else draft


def _stops(talk: Talk, draft: Draft) -> tuple[Draft, tuple[float, float]]:
    """Where the stops are, rad; infinite where the sensor ends first."""
    e = draft.experiment
    talk.ask("turn the shaft gently to its stop on the low, negative side", empty="it is there")
    low = talk.perform(Read(e, "low stop"))
    talk.ask("now to its stop on the high, positive side", empty="it is there")
    high = talk.perform(Read(e, "high stop"))
    if abs(high.y_counts - low.y_counts) < MOVED_COUNTS:
        drawings = wiring.sensor if e.sensor.encoder is None else wiring.encoder
        raise Refusal(
            f"the reading has not moved: {low.y_counts:g} counts at both stops",
            "turn the shaft from stop to stop; if you did, look at these wires",
            drawings(draft.board),
        )
    positions = []
    for end, reading in ((-math.inf, low), (math.inf, high)):
        must_stand(reading)
        at_rail = e.sensor.encoder is None and not e.sensor.rails[0] < reading.y_counts < e.sensor.rails[1]
        if at_rail:
            talk.say(
                f"at the {'low' if end < 0.0 else 'high'} stop the sensor reads {reading.y_counts:g} counts, its rail: "
                "it ends before the stop, so the calibrated angles are the travel there"
            )
        rad_per_count, zero = e.sensor.straight
        straight_rad = (reading.y_counts - zero) * rad_per_count  # an encoder counts from its zero
        there = e.sensor.curve.to_rad(reading.y_counts) if e.sensor.encoder is None else straight_rad
        positions.append(end if at_rail else there)
    return replace(draft, board=high.board), (positions[0], positions[1])


def _travel_words(found: Travel) -> str:
    low, high = found.hard_rad
    because = {"stop": "0.2 rad inside the stop", "calibration": "the end of the calibrated angles"}
    return (
        f"hard limits {low:g} rad ({because[found.ends[0]]}) to {high:g} rad ({because[found.ends[1]]}); soft limits, "
        f"in the same proportion to them as before, {found.soft_rad[0]:g} to {found.soft_rad[1]:g} rad"
    )
