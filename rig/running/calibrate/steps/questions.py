"""What the steps share: questions with their answers, and readings of a shaft that stands."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Final

from rig.running.calibrate import wiring
from rig.running.calibrate.dialogue import Read, Reading, Refusal, Talk
from rig.running.calibrate.draft import Draft

_LARGEST_ANGLE_RAD = math.radians(36_000.0)
_LARGEST_ERROR_DEG = 10.0
MOVED_COUNTS = 3.0  # less is a sensor that has not moved


def standing(talk: Talk, draft: Draft, request: Read) -> tuple[Draft, Reading]:
    """A reading of a shaft that stands, away from the rails; and the draft that knows the board. Raises Refusal."""
    reading: Reading = talk.perform(request)
    must_stand(reading)
    e = request.experiment
    low, high = e.sensor.rails
    if e.sensor.encoder is None and not low < reading.y_counts < high:
        raise Refusal(
            f"the sensor reads {reading.y_counts:g} counts, its rail ({low} and {high}): a broken wire, or the end of "
            "the potentiometer",
            "turn the shaft inward; if it reads the same everywhere, look at these wires",
            wiring.sensor(reading.board),
        )
    return replace(draft, board=reading.board), reading


def must_stand(reading: Reading) -> None:
    """Raise Refusal if the shaft turned while it was read."""
    # a ramp's halves differ by 1.7 times its standard deviation, those of noise by 0.4 times at random
    if abs(reading.drift_counts) > max(1.5 * reading.noise_counts, 2.0):
        raise Refusal(
            f"the shaft still turns: {reading.drift_counts:+.1f} counts while it was read", "hold it still, and again"
        )


_ANGLE: Final = re.compile(r"\s*([-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(rad|deg|degrees|°|)\s*\Z")


def angle_rad(answer: str) -> float:
    """An angle as typed, rad: degrees, or with `rad` behind it. Raises Refusal."""
    found = _ANGLE.match(answer)
    if found is None:
        raise Refusal(
            f"{answer.strip()[:40]!r} is no angle",
            "type degrees, such as -45 or 22.5 (a point, no comma), or `0.5 rad`",
        )
    value = float(found[1])
    rad = value if found[2] == "rad" else math.radians(value)
    if not abs(rad) <= _LARGEST_ANGLE_RAD:
        raise Refusal(f"{value:g} is no angle of a shaft", "type degrees, such as -45")
    return rad


def number(answer: str) -> float:
    """A finite number as typed. Raises Refusal."""
    try:
        value = float(answer)
    except ValueError as error:
        raise Refusal(
            f"{answer.strip()[:40]!r} is no number", "type a number, such as 1.25 (a point, no comma)"
        ) from error
    if not math.isfinite(value):
        raise Refusal(f"{answer.strip()} is no number here", "type a number, such as 1.25")
    return value


def angle_error(talk: Talk, believed_rad: float) -> float:
    """By how much each angle may be off, rad; as believed, if nobody says otherwise."""
    default = f"{math.degrees(believed_rad):.2g}"
    while True:
        answer = talk.ask(
            "by how many degrees may each angle be off? a printed protractor is good to 0.5", "number", default=default
        )
        try:
            return believed_rad if answer.strip() in ("", default) else _error_rad(number(answer))
        except Refusal as refusal:
            talk.refuse(refusal)


def _error_rad(error_deg: float) -> float:
    if not 0.0 < error_deg <= _LARGEST_ERROR_DEG:
        raise Refusal(f"{error_deg:g}° is no error of an angle", f"more than 0, at most {_LARGEST_ERROR_DEG:g}°")
    return math.radians(error_deg)
