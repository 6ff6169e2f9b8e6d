"""An answer in a few lines, for a terminal and a notebook; and how its numbers are rounded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from rig.run_folder.results.answer import Answer, HoldsResult
from rig.run_folder.results.estimates import FittedRecord, FoundLawResult, known
from rig.run_folder.results.meta import TrueMotor

PARAMETERS = (("tau_s", "tau", "s"), ("K_rad_s_V", "K", "(rad/s)/V"), ("fc_V", "f_c", "V"))
VERDICTS = {"ok": "ok: rig promises 5 %"}
NOT_KNOWN = "not known"
NOTHING_TO_IDENTIFY = "nothing to identify"  # begins the note of a run without an estimate
BEYOND = 1.05  # of the largest drive that the motor was measured with: so much more is no other range
MOST_DIGITS = 4  # of a share
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


def percent(ratio: float) -> str:
    """A ratio in per cent, with two significant digits and its sign; zero has none."""
    if not math.isfinite(ratio):
        return "–"
    value = 100.0 * ratio
    digits = 0 if abs(value) >= 9.95 else (1 if abs(value) >= 0.995 else 2)
    return f"{value:+.{digits}f} %" if round(value, digits) else "0 %"


def of_all(percent: float) -> str:
    """A share as ``98.7 %``; one that is nearly all with the digits that what is missing needs: ``99.997 %``.

    percent   the share, %; what is missing below a ten-thousandth of it does not count
    """
    missing = 100.0 - percent
    digits = 1 if missing >= 0.05 else min(-math.floor(math.log10(max(missing, 1e-9))), MOST_DIGITS)
    said = f"{percent:.{digits}f}"
    return f"{100 if float(said) == 100.0 else said} %"


def records_in_words(records: Sequence[FittedRecord] | None) -> str:
    """What the answer was fitted to, as in ``relay-1 (13.7 s), search (18.2 s)``."""
    return ", ".join(f"{record.name} ({known(record.duration_s):.1f} s)" for record in records or ())


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
        if numbers and answer.verdict == "ok":
            numbers[-1] = f"{numbers[-1]:<42}  {verdict}"
        yield from numbers
        if answer.verdict != "ok" and not answer.reasons:  # each reason begins with it
            yield verdict
        laws = [_law(law, *causes.get(law.name, (law.name.replace("_", " "), ""))) for law in answer.law or ()]
        if laws:
            yield f"also: {'; '.join(laws)}"
        yield from validity(answer)
    most = 1 if answer.is_refused else MOST_REASONS  # the first is the cause, and others follow from it
    for reason in answer.reasons[:most]:
        yield f"{answer.verdict}: {reason}"
    if len(answer.reasons) > most:
        more = len(answer.reasons) - most
        yield f"{answer.verdict}: {more} more reason{'s' if more > 1 else ''}"
    if answer.is_refused and not answer.reasons:
        yield verdict


def graded_words(answer: Answer) -> str:
    """How good each number is, as ``tau is good, K is rough, f_c is not known``; empty where nobody looked.

    Of an answer that is ok: what rig promises of them.
    """
    if answer.verdict == "ok":
        return "the verdict is ok: rig promises that tau, K and f_c are within 5 %"
    grade = answer.grade or {}
    return ", ".join(f"{name} is {grade[key].grade}" for key, name, _ in PARAMETERS if key in grade)


def validity(answer: Answer) -> Iterator[str]:
    """Where an answer holds, and how well it predicts what it has not seen: a line each, where that is known."""
    holds, predicts = answer.holds, answer.predicts
    for law in answer.law or ():
        if full_V := (law.numbers or {}).get("full_drive_V"):
            yield f"gives tau and K at a drive of {full_V:.3g} V: below it both are larger"
    if holds is not None and holds.drive_V is not None and holds.speed_rad_s is not None:
        ways = "both ways" if holds.ways == "both" else "one way"
        drive, speed = (
            list(dict.fromkeys(f"{float(f'{known(end):.3g}'):g}" for end in ends))
            for ends in (holds.drive_V, holds.speed_rad_s)
        )
        near, fast = ("at" if len(ends) == 1 else "between" for ends in (drive, speed))
        if known(holds.drive_V[0]) < known(answer.value("fc_V")):  # a drive that goes through zero, as a chirp does
            near, drive = "up to", drive[-1:]
        at = "" if fast == near else f"{fast} "
        yield f"holds {near} {' and '.join(drive)} V, {at}{' and '.join(speed)} rad/s, {ways}"
    if predicts is not None and math.isfinite(known(predicts.error)):
        linear = known(predicts.linear_error)
        beside = f" (a linear model: {_seen(linear)})" if math.isfinite(linear) else ""
        yield f"predicts {_seen(known(predicts.error))} of motion that it has not seen{beside}"


def beyond_drive(holds: HoldsResult | None, largest_V: float) -> str:
    """That a drive goes beyond those that the motor was measured with, in words; empty where it does not."""
    if holds is None or holds.drive_V is None or not largest_V > BEYOND * known(holds.drive_V[1]):
        return ""
    return f"a drive of {largest_V:.3g} V, and the answer holds up to {known(holds.drive_V[1]):.3g} V"


def _seen(error: float) -> str:
    """The share of motion that is predicted, less than nothing as 0 %."""
    return of_all(100.0 * (1.0 - error)) if error < 5e-4 else f"{100.0 * max(1.0 - error, 0.0):.3g} %"


def _numbers(answer: Answer, truth: TrueMotor | None) -> Iterator[str]:
    for key, name, unit in PARAMETERS:
        value, bounds = known(answer.value(key)), answer.at_95(key)
        if not math.isfinite(value):
            continue
        half = 0.5 * (bounds[1] - bounds[0]) if bounds is not None else math.nan
        width = "" if bounds is None else share(value, half)
        graded = (answer.grade or {}).get(key)
        if graded is not None and graded.grade == NOT_KNOWN:
            yield f"{name:<4} not known: {_why_not(answer, key, value, known(graded.u95))}"
            continue
        if width == "unknown":
            yield f"{name:<4} unknown: at 95 % it may be off by more than its own size"
            continue
        true = None if truth is None else truth.value(key)
        off = f"  ({percent(value / true - 1.0)} off the emulated motor)" if true else ""
        grade = "" if graded is None or answer.verdict == "ok" else f"{graded.grade:<5}"  # ok: each is exact
        yield f"{name:<4} {rounded(value, half) + ' ' + unit:<18} {width + ' ' * bool(grade):<10}{grade}{off}".rstrip()


def _why_not(answer: Answer, key: str, value: float, half: float) -> str:
    """Why a number is not known; of a shaft that turned one way, what is known instead."""
    taken = (answer.grade or {}).get("fc_less_bias_V")
    if key == "fc_V" and taken is not None:
        both = "f_c + a" if answer.holds is not None and answer.holds.ways == "backward" else "f_c - a"
        number, u95 = known(taken.value), known(taken.u95)
        known_V = f"; {both} = {rounded(number, u95)} V {share(number, u95)} {taken.grade}"
        return f"the shaft turned one way only{known_V if math.isfinite(number) else ''}"
    if math.isfinite(half) and half <= abs(value):
        return f"at 95 % it may be {100.0 * half / abs(value):.2g} % off"
    return "at 95 % it may be off by more than its own size"


def _law(law: FoundLawResult, title: str, cause: str) -> str:
    low, high = map(known, law.ci95 or (None, None))
    half = 0.5 * (high - low)
    size = f" ± {rounded(half, half)}" if math.isfinite(half) else ""
    unit = "" if law.unit == "1" else f" {law.unit}"
    why = f" ({cause.rstrip('?')}?)" if cause else ""
    return f"{title} {rounded(known(law.value), half)}{size}{unit}{why}"
