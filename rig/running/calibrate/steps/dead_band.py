"""The step `dead-band`: a bridge's dead band, with a voltmeter, while the motor is taken off."""

from __future__ import annotations

from rig.running.calibrate.dialogue import Ask, Hold, Say
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.refusal import Refusal
from rig.running.calibrate.steps.questions import Steps, choice, number, refused
from rig.running.calibrate.sums.bridge import DUTIES, Volts, dead_band
from rig.running.preflight import preflight

_HOLD_S = 5.0  # long enough for a hand-held meter


def dead_band_step(draft: Draft) -> Steps[Draft]:
    """Sets drive.dead_band_duty. The bridge drives, with no motor at it."""
    e = draft.experiment
    if not draft.follows:
        yield Say(
            "the bridge does not drive: only a sensor that follows the drive can tell that the motor is off.\n"
            "Do the step `strokes` before this one, in the same go",
            "refused",
        )
        return draft
    answer = yield from choice(
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
        yield Say(f"the bridge does not drive yet: {problems[0]}", "refused")
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
                    readings.append((yield from _volts(Hold(without, u_V, _HOLD_S), abs(u_V) / full_V)))
                band = dead_band(readings, e.drive.supply_V)
                break
            except Refusal as refusal:
                yield refused(refusal)
                yield Ask("get ready to measure this direction again", empty="measure again")
        name = "plus" if (way > 0) != e.drive.reversed else "minus"
        found[name] = round(band.duty, 3)
        yield Say(f"{name}: nothing passes up to {100.0 * band.duty:.1f} % duty", "found")
        if abs(band.full_V - full_V) > 0.05 * full_V:
            yield Say(
                f"by these voltages full duty gives {band.full_V:.3g} V, the config says {full_V:.3g} V: measure "
                "drive.supply_V and drive.bridge_drop_V under load"
            )
    return draft.with_changes({("drive", "dead_band_duty"): {"plus": found["plus"], "minus": found["minus"]}})


def _volts(hold: Hold, duty: float) -> Steps[Volts]:
    yield Say(f"the bridge drives {hold.u_V:+.2f} V, {100.0 * duty:.0f} % duty, for {hold.seconds:g} s: read the meter")
    moved_rad = yield hold
    if abs(moved_rad) > hold.experiment.breakaway.motion_rad:
        raise Refusal(
            f"the shaft turned by {moved_rad:+.3f} rad: the motor is still at the bridge",
            "switch the supply off, take one of the motor's wires off, and measure again",
        )
    while True:
        answer = yield Ask("what did the meter show, V?", "number")
        try:
            volts = number(answer)
            break
        except Refusal as refusal:
            yield refused(refusal)
    return Volts(duty, abs(volts))
