"""An answer in volts that are known up to a factor only: of a servo's own loop, whose P no manual says well. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from rig.identification.motor_law import GRADES, NOT_KNOWN
from rig.identification.verdict import in_percent
from rig.run_folder.recording.servo_law import Scale
from rig.run_folder.results import Answer, GradedNumber, known

_IN_VOLTS: Final = ("K_rad_s_V", "fc_V")


def widest(scales: Sequence[Scale | None]) -> Scale | None:
    """The least known of several recordings' scales; None where all volts are volts."""
    some = [one for one in scales if one is not None]
    return max(some, key=lambda one: one.high / one.low, default=None)


def in_unsure_volts(answer: Answer, scale: Scale) -> Answer:
    """The answer with K and f_c as uncertain as the scale, and the reason; as it is where the scale is known."""
    share = scale.high / scale.middle - 1.0
    if share == 0.0:
        return answer
    u95, absolute, grade = dict(answer.u95 or {}), dict(answer.u95_absolute or {}), dict(answer.grade or {})
    for name in _IN_VOLTS:
        value = known(answer.value(name))
        for halves in (u95, absolute):
            halves[name] = _wider(halves.get(name), share * abs(value))
        if name in grade:
            grade[name] = _graded(grade[name], value, u95[name])
    reason = (
        f"what a step of the servo's P means is known to a factor of {scale.high / scale.low:.3g} only "
        f"({scale.source}), so K and f_c are off by up to {in_percent(share)}, and laws in volts; tau hardly: "
        "`rig servo facts` measures it, --p-scale states it"
    )
    verdict = "doubtful" if answer.verdict == "ok" else answer.verdict
    return answer.model_copy(
        update={
            "u95": u95,
            "u95_absolute": absolute,
            "grade": grade or None,
            "verdict": verdict,
            "reasons": (reason, *answer.reasons),
        }
    )


def _wider(half: float | None, more: float) -> float:
    return more if half is None else math.hypot(half, more)


def _graded(before: GradedNumber, value: float, half: float | None) -> GradedNumber:
    share = math.inf if half is None or not math.isfinite(value) else half / abs(value)
    if before.grade == NOT_KNOWN:
        return before
    grade = next((grade for grade, most in GRADES.items() if share <= most), NOT_KNOWN)
    return GradedNumber(value=value if grade != NOT_KNOWN else None, u95=half, grade=grade)
