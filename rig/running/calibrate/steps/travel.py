"""The step `travel`: the mechanical stops, and the limits inside them."""

from __future__ import annotations

import math
from dataclasses import replace

from rig.running.calibrate import wiring
from rig.running.calibrate.dialogue import Ask, Read, Say
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.refusal import Refusal
from rig.running.calibrate.steps.questions import MOVED_COUNTS, Steps, choice, must_stand, refused
from rig.running.calibrate.sums.travel import Travel, travel
from rig.running.preflight.room_to_stop import limits_are_ordered, room_rad, stopping_terms


def travel_step(draft: Draft) -> Steps[Draft]:
    """Sets limits.hard_rad and .soft_rad; limits.max_speed_rad_s where there is no room to stop from it."""
    e = draft.experiment
    answer = yield from choice(
        None, "does the shaft have mechanical stops?", (("yes", "it meets one on each side"), ("no", "it turns freely"))
    )
    while True:
        try:
            stops = (-math.inf, math.inf)
            if answer == "yes":
                draft, stops = yield from _stops(draft)
            points = e.sensor.points
            shown = (-math.inf, math.inf)
            if e.sensor.encoder is None:
                shown = (min(r for _, r in points), max(r for _, r in points))
            elif answer == "no":
                yield Say("without stops and without a calibrated range the limits stay as they are")
                return draft
            found = travel(stops, shown, (e.limits.soft_rad, e.limits.hard_rad))
            break
        except Refusal as refusal:
            yield refused(refusal)
            yield Ask("get ready to measure the travel again", empty="measure again")
    yield Say(_travel_words(found), "found")
    low, high = e.limits.hard_rad
    if found.hard_rad[0] <= low and high <= found.hard_rad[1]:
        wanted = yield from choice(
            None,
            f"limits.hard_rad [{low:g}, {high:g}] are inside: keep them, or widen them?",
            (("keep", ""), ("widen", "")),
        )
        if wanted == "keep":
            return draft
    draft = draft.with_changes(
        {("limits", "soft_rad"): list(found.soft_rad), ("limits", "hard_rad"): list(found.hard_rad)}
    )
    return (yield from _with_room_to_stop(draft))


def _with_room_to_stop(draft: Draft) -> Steps[Draft]:
    """With a largest speed from which the shaft stops inside the limits, if somebody says yes to that."""
    e = draft.experiment
    d = e.device
    distance_rad, room = sum(rad for _, rad in stopping_terms(d)), room_rad(d)
    if not limits_are_ordered(d) or distance_rad <= room:
        return draft
    speed_rad_s = math.floor(100.0 * e.limits.max_speed_rad_s * room / distance_rad) / 100.0
    answer = yield from choice(
        Say(
            f"from limits.max_speed_rad_s, {e.limits.max_speed_rad_s:g}, the shaft would need {distance_rad:.2f} rad "
            f"to stop; there are {room:.2f} rad from the centre to the nearer hard limit",
            "refused",
        ),
        f"lower limits.max_speed_rad_s to {speed_rad_s:g}?",
        (("yes", "a faster shaft ends the run"), ("no", "`rig check` will refuse the config")),
    )
    return draft.with_changes({("limits", "max_speed_rad_s"): speed_rad_s}) if answer == "yes" else draft


def _stops(draft: Draft) -> Steps[tuple[Draft, tuple[float, float]]]:
    """Where the stops are, rad; infinite where the sensor ends first."""
    e = draft.experiment
    yield Ask("turn the shaft gently to its stop on the low, negative side", empty="it is there")
    low = yield Read(e, "low stop")
    yield Ask("now to its stop on the high, positive side", empty="it is there")
    high = yield Read(e, "high stop")
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
            yield Say(
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
