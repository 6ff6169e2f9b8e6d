"""The identification of recordings: the answer, the estimates beside it, and what they are made of."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from rig.run_folder.results import estimates as parts
from rig.run_folder.results.answer import Answer, answer_of
from rig.run_folder.results.part import Flag, JsonObject, Number, Part, Sometimes, Text, key


class MotorLawResult(Part):
    """What the answer was fitted to, and what its uncertainty is made of. A part of two other files."""

    not_told_apart: Sometimes[tuple[tuple[Text, ...], ...]] = key("groups of laws that explain the tests equally well")
    ok_asks_u95_percent: Sometimes[Number] = key("largest u95 of a verdict ok, % of each of tau, K and friction")
    budget: Sometimes[tuple[parts.BudgetEntry, ...]] = key("what u95 and u95_absolute are made of, the largest first")
    pieces: Sometimes[tuple[parts.PieceResult, ...]] = key("residual by the length of the fitted pieces")
    law_records: Sometimes[tuple[parts.FittedRecord, ...]] = key("what the answer was fitted to; tracking never is")


class Answered(Part):
    """The answer, and the estimates that it is chosen from."""

    answer: Answer | None = key("the numbers to use; null: nothing was identified. rig makes it for an older file")
    estimates: dict[str, parts.EstimateResult] = key(
        "the plain motor by each method, to compare the methods; the answer may have laws", {}
    )


class OlderKeys(Answered):
    """The keys in which older versions gave the answer. It is made from them, here; nothing else reads them."""

    law: Sometimes[tuple[parts.FoundLawResult, ...]] = key("older versions: `law` of the answer")
    with_law: Sometimes[parts.EstimateResult] = key("older versions: the answer with these laws")
    law_frame: Sometimes[parts.LawFrameResult] = key("older versions: `law_frame` of the answer")
    u95: Sometimes[dict[str, Number]] = key("older versions: `u95` of the answer")
    u95_absolute: Sometimes[dict[str, Number]] = key("older versions: `u95_absolute` of the answer")
    friction_law: Sometimes[JsonObject] = key("older versions: a friction law, chosen by itself")

    @model_validator(mode="after")
    def _answered(self) -> Self:
        """Make the answer of an older file. It is written from then on."""
        if self.estimates and not self.says("answer"):
            answer = answer_of(self.estimates, self.with_law, self.law, self.law_frame, self.u95, self.u95_absolute)
            self.__dict__["answer"] = answer  # a part is frozen for all but its own making
            self.model_fields_set.add("answer")
        return self


class _Found(Part):
    """What was read, and what else the tests say."""

    rehearsal: Sometimes[Flag] = key("true: a recording is a rehearsal, and measured no motor")
    relays: tuple[parts.RelayTestResult, ...] = key("relay tests that were used", ())
    notes: tuple[Text, ...] = key("what else there is to know, in words", ())
    hysteretic: Sometimes[tuple[parts.HystereticResult, ...]] = key("runs of hysteretic relays")
    breakaway: Sometimes[parts.StaticFrictionResult] = key("static friction")
    friction_map: Sometimes[parts.FrictionMapResult] = key("the drive over speed and over position")


class SamplingResult(Part):
    """How the tests were sampled; of tests that differ the coarser."""

    period_s: Number = key("between two rows, s")
    noise_rad: Number = key("standard deviation of the position's noise, its steps included, rad")
    step_rad: Number = key("step of the sensor, rad; 0: none is seen")


class IdentificationResult(OlderKeys, MotorLawResult, _Found, Answered):
    """The identification of recordings: `rig identify --json`."""

    # Its parts are read from right to left: the JSON keeps that order of keys.
    sampling: Sometimes[SamplingResult] = key("how the tests were sampled")
