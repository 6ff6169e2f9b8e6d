"""The step `strokes`: polarity of the drive, and static friction both ways. The motor moves."""

from __future__ import annotations

from dataclasses import replace

from rig.running.calibrate import wiring
from rig.running.calibrate.dialogue import Say, Strokes, StrokesSeen, Talk, stopped
from rig.running.calibrate.draft import Draft
from rig.running.preflight import preflight

_ABOVE_FRICTION = (2.0, 3.0)  # breakaway.max_V over the larger level


def strokes_step(talk: Talk, draft: Draft) -> Draft:
    """Sets drive.reversed and breakaway.max_V. Asks before each time that the motor moves."""
    while True:
        e = draft.experiment
        if problems := preflight(e).problems:
            talk.say(
                "the motor does not move yet, because `rig check` would refuse this config:\n"
                + "\n".join(f"  {problem}" for problem in problems),
                "refused",
            )
            return draft
        answer = talk.choice(
            Say(
                f"THE MOTOR MOVES: strokes to and fro, slowly stronger, up to {e.breakaway.max_V:g} V. With a sensor\n"
                "that does not follow, the shaft turns less than 0.5 rad (`rig check` says how that is bounded). Turn\n"
                "the shaft near its centre, switch the motor's supply on, keep a hand on the e-stop."
            ),
            "may the motor move?",
            (("no", "leave this step out"), ("yes", "it is ready")),
        )
        if answer == "no":
            talk.say("the motor does not move: polarity and static friction are not measured")
            return draft
        seen: StrokesSeen = talk.perform(Strokes(e))
        for note in seen.notes:
            talk.say(note)
        if seen.fault is None:
            return _friction(talk, draft, seen)
        code = seen.fault.code
        if seen.folder:
            talk.say(f"recorded: {seen.folder}")
        if code == "POLARITY":
            answer = talk.choice(
                Say(f"moved the wrong way: {seen.fault.detail}", "refused", wiring.swapped_motor(e)),
                "swap the wires, or let the config turn the sign?",
                (
                    ("reversed", f"set drive.reversed: {_yaml(not e.drive.reversed)}, and leave the wires"),
                    ("swapped", "I have swapped them"),
                    ("stop", "leave this step out"),
                ),
            )
            if answer == "reversed":
                draft = draft.with_changes({("drive", "reversed"): not e.drive.reversed})
        elif code == "NO_MOTION":
            answer = talk.choice(
                Say(f"not moved: {seen.fault.detail}", "refused"),
                "did the shaft turn, as far as you could see?",
                (("no", "it stood still"), ("yes", "it turned, and rig did not see it")),
            )
            sensor = wiring.sensor if e.sensor.encoder is None else wiring.encoder
            drawings = sensor(draft.board) if answer == "yes" else wiring.drive(e, draft.board)
            answer = talk.choice(Say("look at these wires, with the motor's supply off" if answer == "yes" else
                    "look at these wires, with the motor's supply off; if all are well, raise breakaway.max_V by a "
                    "fifth", "refused", drawings),
                "and then?", (("again", "the strokes again"), ("stop", "leave this step out")),
            )  # fmt: skip
        else:
            answer = talk.choice(
                Say(stopped(seen.fault) if code == "INTERRUPTED" else f"{seen.fault}\n{seen.fault.cure}", "refused"),
                "and then?",
                (("again", "the strokes again"), ("stop", "leave this step out")),
            )
        if answer == "stop":
            return draft


def _friction(talk: Talk, draft: Draft, seen: StrokesSeen) -> Draft:
    """What the strokes have found, and a largest breakaway drive that goes with it."""
    e, draft = draft.experiment, replace(draft, follows=True)
    larger_V = max(seen.plus_V, seen.minus_V)
    talk.say(
        f"the shaft follows the drive, in its sense; it breaks away at {seen.plus_V:.2f} V towards rising positions, "
        f"at {seen.minus_V:.2f} V towards falling ones. Recorded: {seen.folder}",
        "found",
    )
    least, most = (factor * larger_V for factor in _ABOVE_FRICTION)
    if least <= e.breakaway.max_V <= most:
        return draft
    wanted_V = min(round(0.5 * (least + most), 2), e.drive.max_V)
    new = draft.with_changes({("breakaway", "max_V"): wanted_V})
    if problems := preflight(new.experiment).problems:
        talk.say(f"breakaway.max_V stays {e.breakaway.max_V:g}: with {wanted_V:g}, {problems[0]}")
        return draft
    return new


def _yaml(value: bool) -> str:
    return "true" if value else "false"
