"""The answer of an identification: the one estimate that counts, with its laws, its uncertainty and its verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol, TypeVar

from rig.core.estimators import ESTIMATORS, LEADING
from rig.run_folder.results.estimates import EstimateResult, FoundLawResult, LawFrameResult, known
from rig.run_folder.results.part import Count, Number, Part, Text, key


class GradedNumber(Part):
    """One number with an interval that has the errors of the model in it, and how good that makes it.

    Keys of ``grade``: tau_s, K_rad_s_V and fc_V. Of a shaft that turned one way only fc_V is not known, and
    fc_less_bias_V is what friction and bias together take from the drive that way.
    """

    value: Number = key("the number; null: not known")
    u95: Number = key("half width at 95 %, in the number's unit; null: not known")
    grade: Text = key("exact: at most 2.5 %; good: at most 10 %; rough: at most 25 %; else not known", "not known")


class PredictsResult(Part):
    """How well the answer predicts blocks of the records that it was not fitted to, in four folds."""

    error: Number = key("RMS error over that of 'it stays as it was'; 0: exact")
    linear_error: Number = key("the same of a linear model without friction, in the same folds")
    block_s: Number = key("length of a block, s; its first 0.1 s shows its start")
    blocks: Count | None = key("number of blocks")


class HoldsResult(Part):
    """What the records hold: beyond it nothing was measured."""

    drive_V: tuple[Number, Number] | None = key("smallest and largest size of the drive, V")
    speed_rad_s: tuple[Number, Number] | None = key("smallest and largest speed in motion, rad/s")
    travel_rad: tuple[Number, Number] | None = key("lowest and highest position, rad")
    ways: Text = key("both, forward (rising positions) or backward", "both")


class Answer(EstimateResult):
    """The numbers to use, by the most trusted method: with the laws that the tests show, where they show some."""

    method: Text = key("the method that they come from", "")
    law: tuple[FoundLawResult, ...] | None = key(
        "what the motor has beyond tau, K and friction; []: nothing; null: nobody looked"
    )
    law_frame: LawFrameResult | None = key("what the numbers of these laws refer to")
    u95: dict[str, Number] | None = key(
        "expanded uncertainty, half width at 95 %, by parameter, in the bench's own volts, radians and "
        "seconds: the scatter of `ci95`, and what the tests do not exclude; null: not known"
    )
    u95_absolute: dict[str, Number] | None = key(
        "the same in true volts, radians and seconds: with the errors of supply, calibration and clock"
    )
    grade: dict[str, GradedNumber] | None = key("how good each number is; null: nobody looked")
    predicts: PredictsResult | None = key("how well it predicts unseen motion; null: nobody looked")
    holds: HoldsResult | None = key("the drives, speeds and travel that the records hold")

    def at_95(self, name: str) -> tuple[float, float] | None:
        """As of an estimate, and as wide as u95 where that is known: what the tests do not exclude is in it, too.

        None of a number that may be anything: its scatter alone would say that it is known.
        """
        graded = (self.grade or {}).get(name)
        if graded is not None and not math.isfinite(known(graded.u95)):
            return None
        bounds, value = self.interval(name), known(self.value(name))
        half, u95 = (math.nan if bounds is None else 0.5 * (bounds[1] - bounds[0])), known((self.u95 or {}).get(name))
        if not math.isfinite(value) or half >= u95 or math.isnan(u95):
            return bounds
        return value - u95, value + u95


class _Judged(Protocol):
    @property
    def verdict(self) -> str: ...


_E = TypeVar("_E", bound=_Judged)


def chosen(estimates: Mapping[str, _E], with_laws: _E | None) -> tuple[str, _E] | None:
    """The method and the estimate that count; None without any. This is the only place that chooses.

    estimates   by method, of the plain motor
    with_laws   by the leading method, with the laws that the tests show and from all records; None: it is the plain one
    The leading method counts, and a refusal of it counts, too: what another method says of such tests is no answer.
    The others count in the order of their list where the leading one was not asked for.
    """
    leading = [(LEADING, one) for one in (with_laws, estimates.get(LEADING)) if one is not None]
    order = [entry.name for entry in ESTIMATORS if entry.name in estimates]
    others = [(name, estimates[name]) for name in dict.fromkeys([*order, *estimates]) if name != LEADING]
    candidates = leading if LEADING in estimates else leading + others
    usable = (one for one in candidates if one[1].verdict != "refused")
    return next(usable, next(iter(candidates), None))


def answer_of(
    estimates: Mapping[str, EstimateResult],
    with_laws: EstimateResult | None = None,
    law: tuple[FoundLawResult, ...] | None = None,
    law_frame: LawFrameResult | None = None,
    u95: dict[str, Number] | None = None,
    u95_absolute: dict[str, Number] | None = None,
    grade: dict[str, GradedNumber] | None = None,
    predicts: PredictsResult | None = None,
    holds: HoldsResult | None = None,
) -> Answer | None:
    """The answer; None without an estimate.

    law, law_frame, u95, u95_absolute, grade, predicts   of ``with_laws``, or of the plain estimate where that is None.
                Where the plain one is the answer in place of a refused ``with_laws``, no interval knows what it leaves
                out: it says no number
    holds       of the records
    """
    found = chosen(estimates, with_laws)
    if found is None:
        return None
    method, estimate = found
    numbers = {name: getattr(estimate, name) for name in EstimateResult.model_fields}
    if with_laws is not None and estimate is not with_laws:  # the plain motor is the answer, and has none of these
        law, law_frame, u95, u95_absolute, predicts = None if law is None else (), None, None, None, None
        grade = None if grade is None else {name: GradedNumber() for name in ("tau_s", "K_rad_s_V", "fc_V")}
    return Answer(
        **numbers,
        method=method,
        law=law,
        law_frame=law_frame if law else None,
        u95=u95,
        u95_absolute=u95_absolute,
        grade=grade,
        predicts=predicts,
        holds=holds,
    )
