"""The step `dead-band`: a bridge's dead band, with a voltmeter, while the motor is taken off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rig.running.calibrate.dialogue import Hold, Refusal, Say, Talk
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.steps.questions import number
from rig.running.preflight import preflight

DUTIES = (0.4, 0.7, 1.0)  # of the largest drive
_PASSES_V = 0.05  # less is a bridge that passes nothing
_LARGEST = 0.5
_OFF_LINE = 0.05  # of the largest voltage


class Volts(NamedTuple):
    """The voltage that a meter shows at a duty, both without sign."""

    duty: float
    V: float


@dataclass(frozen=True)
class DeadBandFound:
    """The duty up to which the bridge passes nothing, and the voltage at full duty, by the line."""

    duty: float
    full_V: float


def dead_band(readings: Sequence[Volts], supply_V: float) -> DeadBandFound:
    """From readings in one direction. Raises Refusal: nothing passes, no line, more than the supply."""
    passing = [reading for reading in readings if reading.V > _PASSES_V]
    if len(passing) < 2:
        raise Refusal(
            "the bridge passes next to nothing: "
            + ", ".join(f"{r.V:g} V at {100.0 * r.duty:.0f} % duty" for r in readings),
            "switch the motor's supply on, measure at the bridge's outputs, or raise drive.max_V",
        )
    duty, volts = (np.array(column) for column in zip(*passing, strict=True))
    slope_V, at_zero_V = (float(c) for c in np.polyfit(duty, volts, 1))
    off_V = float(np.max(np.abs(slope_V * duty + at_zero_V - volts)))
    if slope_V <= 0.0 or off_V > _OFF_LINE * float(volts.max()):
        raise Refusal(
            f"the voltages do not rise in a line with the duty: off by {off_V:.3g} V",
            "wait until the meter stands still, and read DC volts; measure again",
        )
    full_V = slope_V + at_zero_V
    if full_V > 1.1 * supply_V:
        raise Refusal(
            f"by these voltages full duty would give {full_V:.3g} V, and drive.supply_V is {supply_V:g}",
            "correct drive.supply_V, or the readings: volts, not millivolts",
        )
    found = max(-at_zero_V / slope_V, 0.0)
    if found >= _LARGEST or not math.isfinite(found):
        raise Refusal(f"a dead band of {100.0 * found:.0f} % duty is none", "measure again")
    return DeadBandFound(round(found, 4), full_V)


_HOLD_S = 5.0  # long enough for a hand-held meter


def dead_band_step(talk: Talk, draft: Draft) -> Draft:
    """Sets drive.dead_band_duty. The bridge drives, with no motor at it."""
    e = draft.experiment
    if not draft.follows:
        talk.say(
            "the bridge does not drive: only a sensor that follows the drive can tell that the motor is off.\n"
            "Do the step `strokes` before this one, in the same go",
            "refused",
        )
        return draft
    answer = talk.choice(
        Say(
            "With the motor's supply off: take the motor off the bridge, put a resistor of 1 kOhm and a voltmeter\n"
            "(DC) across the bridge's outputs. Then switch the supply on. rig drives the\n"
            f"bridge for {_HOLD_S:g} s at a time; read the meter meanwhile, and type what it showed."
        ),
        "measure the dead band?",
        (("no", "it stays as it is"), ("yes", "the motor is off the bridge")),
    )
    if answer == "no":
        return draft
    if problems := preflight(e).problems:
        talk.say(f"the bridge does not drive yet: {problems[0]}", "refused")
        return draft
    without = draft.with_changes({("drive", "dead_band_duty"): {"plus": 0.0, "minus": 0.0}}).experiment
    full_V = without.drive.map.full_V
    found = {}
    for way in (1, -1):
        while True:
            try:
                readings = []
                for share in DUTIES:
                    u_V = way * share * min(without.drive.max_V, full_V)
                    readings.append(_volts(talk, Hold(without, u_V, _HOLD_S), abs(u_V) / full_V))
                band = dead_band(readings, e.drive.supply_V)
                break
            except Refusal as refusal:
                talk.refuse(refusal)
                talk.ask("get ready to measure this direction again", empty="measure again")
        name = "plus" if (way > 0) != e.drive.reversed else "minus"
        found[name] = round(band.duty, 3)
        talk.say(f"{name}: nothing passes up to {100.0 * band.duty:.1f} % duty", "found")
        if abs(band.full_V - full_V) > 0.05 * full_V:
            talk.say(
                f"by these voltages full duty gives {band.full_V:.3g} V, the config says {full_V:.3g} V: measure "
                "drive.supply_V and drive.bridge_drop_V under load"
            )
    return draft.with_changes({("drive", "dead_band_duty"): {"plus": found["plus"], "minus": found["minus"]}})


def _volts(talk: Talk, hold: Hold, duty: float) -> Volts:
    talk.say(f"the bridge drives {hold.u_V:+.2f} V, {100.0 * duty:.0f} % duty, for {hold.seconds:g} s: read the meter")
    moved_rad = talk.perform(hold)
    if abs(moved_rad) > hold.experiment.breakaway.motion_rad:
        raise Refusal(
            f"the shaft turned by {moved_rad:+.3f} rad: the motor is still at the bridge",
            "switch the supply off, take one of the motor's wires off, and measure again",
        )
    while True:
        answer = talk.ask("what did the meter show, V?", "number")
        try:
            volts = number(answer)
            break
        except Refusal as refusal:
            talk.refuse(refusal)
    return Volts(duty, abs(volts))
