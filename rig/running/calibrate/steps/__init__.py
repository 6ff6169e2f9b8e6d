"""The steps of a calibration: each asks, measures, computes, and says why it refuses.

``rig.running.calibrate.dialogue`` says how a terminal or a page goes through them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rig.config.schema import Experiment
from rig.running.calibrate.dialogue import Refusal, Skipped, Talk
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.steps.angles import angles_step
from rig.running.calibrate.steps.dead_band import dead_band_step
from rig.running.calibrate.steps.strokes import strokes_step
from rig.running.calibrate.steps.travel import travel_step
from rig.running.calibrate.steps.turn import turn_step


def calibration(talk: Talk, draft: Draft, names: Sequence[str]) -> Draft:
    """These steps, by name, one after the other. A step that somebody skips leaves the draft as it was.

    Raises KeyError for a name that is not among ``steps_for`` this config.
    """
    for name in names:
        title, step = steps_for(draft.original)[name]
        talk.say(f"{name}: {title}", "step")
        try:
            draft = step(talk, draft)
        except Skipped:
            talk.say(f"{name} is left out")
        except Refusal as refusal:  # what the step cannot ask for again
            talk.refuse(refusal)
    return draft


Step = Callable[[Talk, Draft], Draft]


def steps_for(e: Experiment) -> dict[str, tuple[str, Step]]:
    """The steps that this bench needs, in their order: what each measures, and the step."""
    sensor: dict[str, tuple[str, Step]] = {"angles": ("centre, and the reading at known angles", angles_step)}
    if e.sensor.servo is not None:
        sensor = {}
    elif e.sensor.encoder is not None:
        sensor = {"turn": ("zero, counts per turn and sign of the encoder", turn_step)}
    if not e.limits.is_endless:
        sensor["travel"] = ("the mechanical stops, hard and soft limits", travel_step)
    sensor["strokes"] = ("polarity of the drive, and static friction both ways: the motor moves", strokes_step)
    if e.sensor.servo is None:  # its bridge is inside
        sensor["dead-band"] = ("the bridge's dead band: with a voltmeter, the motor taken off", dead_band_step)
    return sensor
