"""The step `turn`: zero, counts per turn and sign of an encoder."""

from __future__ import annotations

import math
from typing import Any

from rig.running.calibrate import wiring
from rig.running.calibrate.dialogue import Ask, Read, Reading, Say, SetZero
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.refusal import Refusal
from rig.running.calibrate.steps.questions import MOVED_COUNTS, Steps, angle_error, angle_rad, choice, refused, standing
from rig.running.calibrate.sums.turn import turn


def turn_step(draft: Draft) -> Steps[Draft]:
    """Sets sensor.encoder.sign and .counts_per_turn, and the zero of the device."""
    e = draft.experiment
    encoder = e.sensor.encoder
    assert encoder is not None
    yield Say("The motor's supply is off.")
    error_rad = yield from angle_error(math.radians(2.0))
    while True:
        try:
            mark = "a mark" if e.limits.is_endless else "its zero, the middle of its travel"
            yield Ask(f"turn the shaft to {mark}", empty="it is there")
            if not e.limits.is_endless:
                yield SetZero(e)
            draft, before = yield from standing(draft, Read(e, 0.0))
            answer = yield Ask(
                "turn it towards rising positions, by a whole turn or as far as it goes, and type by how many degrees",
                "angle",
            )
            rad = angle_rad(answer)
            draft, after = yield from standing(draft, Read(e, rad))
            moved = _moved_counts(before, after)
            found = turn(moved, rad, error_rad, (encoder.counts_per_turn, encoder.gear))
            break
        except Refusal as refusal:
            yield refused(refusal)
    yield Say(
        f"{moved:+.0f} counts for {math.degrees(rad):g}°: {found.measured_per_turn:.0f} ±{found.error_per_turn:.0f} a "
        f"turn; the data sheet's {found.counts_per_turn} x gear {encoder.gear:g} is "
        f"{found.counts_per_turn * encoder.gear:g}",
        "found",
    )
    changes: dict[Any, Any] = {}
    if found.counts_per_turn != encoder.counts_per_turn:
        yield Say(
            f"counts_per_turn {encoder.counts_per_turn} is off by a factor of "
            f"{found.counts_per_turn / encoder.counts_per_turn:g}: it counts all four edges of a line"
        )
        changes["sensor", "encoder", "counts_per_turn"] = found.counts_per_turn
    if found.sign != encoder.sign:
        answer = yield from choice(
            Say(
                "moved the wrong way: the position falls where it should rise",
                "refused",
                wiring.swapped_encoder(draft.board),
            ),
            "swap the wires, or let the config turn the sign?",
            (("sign", "set sensor.encoder.sign, and leave the wires"), ("swap", "I swap the wires; the sign stays")),
        )
        if answer == "sign":
            changes["sensor", "encoder", "sign"] = found.sign
        else:
            yield Say("swap them now, and do this step again after the next start: rig has not seen it work")
    return draft.with_changes(changes)


def _moved_counts(before: Reading, after: Reading) -> float:
    moved = after.y_counts - before.y_counts
    if abs(moved) < MOVED_COUNTS:
        raise Refusal(
            f"the encoder has not moved: {moved:+.0f} counts",
            "turn the shaft; if you did, look at these wires",
            wiring.encoder(after.board),
        )
    return moved
