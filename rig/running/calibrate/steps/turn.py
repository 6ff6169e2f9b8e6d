"""The step `turn`: zero, counts per turn and sign of an encoder."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from rig.running.calibrate import wiring
from rig.running.calibrate.dialogue import Read, Reading, Refusal, Say, SetZero, Talk
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.steps.questions import MOVED_COUNTS, angle_error, angle_rad, standing

_LEAST_RAD = math.radians(30.0)
_FACTORS = (4.0, 2.0, 0.5, 0.25)  # lines taken for edges, one channel for two, and the other way round


@dataclass(frozen=True)
class TurnFound:
    """What a turn by hand shows: counts a turn of the encoder's shaft and sign for the config; what was measured."""

    counts_per_turn: int
    sign: int
    measured_per_turn: float  # of the measured shaft
    error_per_turn: float


def turn(moved_counts: float, turned_rad: float, error_rad: float, believed: tuple[int, float]) -> TurnFound:
    """Counts and sign from a turn by hand towards rising positions.

    moved_counts  by the encoder; turned_rad  by the eye, > 0; error_rad  of that angle
    believed      counts for a turn of the encoder, and its gear, of the config
    Raises Refusal: too small a turn, counts that fit neither this config nor one with lines for edges.
    """
    counts_per_turn, gear = believed
    if turned_rad < _LEAST_RAD:
        raise Refusal(
            f"a turn of {math.degrees(turned_rad):.4g}° is too small to count by",
            f"turn it towards rising positions by at least {math.degrees(_LEAST_RAD):.0f}°, better by a whole turn",
        )
    turns = turned_rad / (2.0 * math.pi)
    measured = abs(moved_counts) / turns
    error = measured * error_rad / turned_rad + 2.0 / turns
    sign = 1 if moved_counts > 0.0 else -1
    for factor in (1.0, *_FACTORS):
        counts = counts_per_turn * factor
        if counts == round(counts) and abs(counts * gear - measured) <= error:
            return TurnFound(round(counts), sign, measured, error)
    raise Refusal(
        f"the shaft made {measured:.0f} ±{error:.0f} counts a turn; the config says {counts_per_turn * gear:.0f} "
        f"(counts_per_turn {counts_per_turn} x gear {gear:g})",
        "type the angle again; if it was right, correct counts_per_turn (edges: four times the lines) or gear by their "
        "data sheets",
    )


def turn_step(talk: Talk, draft: Draft) -> Draft:
    """Sets sensor.encoder.sign and .counts_per_turn, and the zero of the device."""
    e = draft.experiment
    encoder = e.sensor.encoder
    assert encoder is not None
    talk.say("The motor's supply is off.")
    error_rad = angle_error(talk, math.radians(2.0))
    while True:
        try:
            mark = "a mark" if e.limits.is_endless else "its zero, the middle of its travel"
            talk.ask(f"turn the shaft to {mark}", empty="it is there")
            if not e.limits.is_endless:
                talk.perform(SetZero(e))
            draft, before = standing(talk, draft, Read(e, 0.0))
            answer = talk.ask(
                "turn it towards rising positions, by a whole turn or as far as it goes, and type by how many degrees",
                "angle",
            )
            rad = angle_rad(answer)
            draft, after = standing(talk, draft, Read(e, rad))
            moved = _moved_counts(before, after)
            found = turn(moved, rad, error_rad, (encoder.counts_per_turn, encoder.gear))
            break
        except Refusal as refusal:
            talk.refuse(refusal)
    talk.say(
        f"{moved:+.0f} counts for {math.degrees(rad):g}°: {found.measured_per_turn:.0f} ±{found.error_per_turn:.0f} a "
        f"turn; the data sheet's {found.counts_per_turn} x gear {encoder.gear:g} is "
        f"{found.counts_per_turn * encoder.gear:g}",
        "found",
    )
    changes: dict[Any, Any] = {}
    if found.counts_per_turn != encoder.counts_per_turn:
        talk.say(
            f"counts_per_turn {encoder.counts_per_turn} is off by a factor of "
            f"{found.counts_per_turn / encoder.counts_per_turn:g}: it counts all four edges of a line"
        )
        changes["sensor", "encoder", "counts_per_turn"] = found.counts_per_turn
    if found.sign != encoder.sign:
        answer = talk.choice(
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
            talk.say("swap them now, and do this step again after the next start: rig has not seen it work")
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
