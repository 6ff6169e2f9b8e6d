"""An answer in a few lines, for a terminal and a notebook; and how its numbers are rounded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from rig.results.answer import Answer
from rig.results.estimates import FoundLawResult, known
from rig.results.meta import TrueMotor

PARAMETERS = (("tau_s", "tau", "s"), ("K_rad_s_V", "K", "(rad/s)/V"), ("fc_V", "f_c", "V"))
VERDICTS = {"ok": "ok: at most 5 % off"}
MOST_REASONS = 2  # the others are among the details


def rounded(value: float, half_width: float = math.nan) -> str:
    """``value`` rounded to two digits of its uncertainty ``half_width``, in the same unit; without one: four digits."""
    if not math.isfinite(value):
        return "–"
    if math.isfinite(half_width) and half_width > 0.0:
        digits = 1 - math.floor(math.log10(half_width))
        if value != 0.0:
            digits = max(digits, 1 - math.floor(math.log10(abs(value))))
    elif value != 0.0:
        digits = 3 - math.floor(math.log10(abs(value)))
    else:
        digits = 0
    return f"{value:.{min(max(digits, 0), 9)}f}"


def share(value: float, half_width: float) -> str:
    """``half_width`` over ``value``, both in one unit, as ``± 0.5 %``; ``unknown`` where it is more than that."""
    if not half_width <= abs(value):
        return "unknown"
    return f"± {100.0 * half_width / abs(value):.2g} %" if value else ""


def answer_lines(
    answer: Answer | None, causes: Mapping[str, tuple[str, str]], truth: TrueMotor | None = None
) -> Iterator[str]:
    """The numbers, a line each, with their 95 % intervals; the verdict, what else the motor has, and why not ok.

    causes  of laws by name: title, and what it may come from
    truth   the emulated motor, if there is one
    A refused answer shows no number.
    """
    if answer is None:
        yield "no answer: nothing was identified"
        return
    verdict = VERDICTS.get(answer.verdict, answer.verdict)
    if not answer.is_refused:
        numbers = list(_numbers(answer, truth))
        yield from numbers[:-1]
        yield f"{numbers[-1]:<42}  {verdict}" if numbers else verdict
        laws = [_law(law, *causes.get(law.name, (law.name.replace("_", " "), ""))) for law in answer.law or ()]
        if laws:
            yield f"also: {'; '.join(laws)}"
    for reason in answer.reasons[:MOST_REASONS]:
        yield f"{answer.verdict}: {reason}"
    if len(answer.reasons) > MOST_REASONS:
        yield f"{answer.verdict}: {len(answer.reasons) - MOST_REASONS} more reasons"
    if answer.is_refused and not answer.reasons:
        yield verdict


def _numbers(answer: Answer, truth: TrueMotor | None) -> Iterator[str]:
    for key, name, unit in PARAMETERS:
        value, bounds = known(answer.value(key)), answer.at_95(key)
        if not math.isfinite(value):
            continue
        half = 0.5 * (bounds[1] - bounds[0]) if bounds is not None else math.nan
        width = "" if bounds is None else share(value, half)
        if width == "unknown":
            yield f"{name:<4} unknown: at 95 % it may be off by more than its own size"
            continue
        true = None if truth is None else truth.value(key)
        off = f"  ({100.0 * (value / true - 1.0):+.1f} % off the emulated motor)" if true else ""
        yield f"{name:<4} {rounded(value, half) + ' ' + unit:<18} {width}{off}"


def _law(law: FoundLawResult, title: str, cause: str) -> str:
    low, high = map(known, law.ci95 or (None, None))
    half = 0.5 * (high - low)
    size = f" ± {rounded(half, half)}" if math.isfinite(half) else ""
    unit = "" if law.unit == "1" else f" {law.unit}"
    why = f" ({cause.rstrip('?')}?)" if cause else ""
    return f"{title} {rounded(known(law.value), half)}{size}{unit}{why}"
