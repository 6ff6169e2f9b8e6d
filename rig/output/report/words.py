"""The report's words and numbers: the headline, what to do next, and values rounded to their uncertainty."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

from rig.core.estimators import LEADING
from rig.identification.departures import DEPARTURES
from rig.output.report.source import ReportedRun
from rig.output.report.style import stage_kind
from rig.run_folder.results import Answer, BreakawayResult, EstimateResult, known
from rig.run_folder.results.answer_words import NOTHING_TO_IDENTIFY, graded_words, share, validity
from rig.run_folder.results.answer_words import percent as in_percent
from rig.run_folder.results.answer_words import rounded as as_digits

TRIPLE = "triple-relay"
HeadlineOutcome = Literal["ok", "doubtful", "refused", "none"]

STATED = 1e-6  # width of an interval over its number: narrower ones are of what a recording states, not of an estimate


@dataclass(frozen=True)
class Parameter:
    """How the page shows one parameter: symbol, unit, factor from SI to that unit, meaning."""

    key: str
    symbol: str
    unit: str
    factor: float
    meaning: str


PARAMETERS = (
    Parameter("tau_s", "τ", "s", 1.0, "velocity time constant"),
    Parameter("K_rad_s_V", "K", "(rad/s)/V", 1.0, "velocity gain of the measured shaft"),
    Parameter("fc_V", "f_c", "V", 1.0, "Coulomb friction, as a voltage"),
    Parameter("asym_V", "a", "mV", 1e3, "asymmetry of the effective drive"),
    Parameter("delay_s", "d", "ms", 1e3, "from a sample to the effect of its drive"),
)
HEADLINE_PARAMETERS = PARAMETERS[:3]


@dataclass(frozen=True)
class Quantity:
    """One value of an estimate as text.

    exact       the value in the file; None if there is none
    interval    "low to high"
    plus_minus  "± half"; if the interval is not symmetric: as ``interval``
    relative    half of the interval over the value
    error       against the truth, if that is known
    """

    parameter: Parameter
    exact: float | None
    text: str
    interval: str
    plus_minus: str
    relative: str
    error: str


class Step(NamedTuple):
    """One thing to do next, and its command, if it has one."""

    text: str
    command: str = ""


@dataclass(frozen=True)
class Headline:
    """The result of the run, for the top of the page."""

    outcome: HeadlineOutcome
    title: str
    sentences: tuple[str, ...]
    reasons: tuple[str, ...]
    next_steps: tuple[Step, ...]
    method: str
    quantities: tuple[Quantity, ...]


_DRIVEN = {
    "breakaway": "a breakaway check",
    "search": "a search",
    "relay": "relay tests",
    "strokes": "stroke tests",
    "hysteretic": "a hysteretic relay",
    "survey": "slow sweeps",
    "law": "a law of your own",
    "jog": "a jog",
    "track": "tracking",
}


def driven(run: ReportedRun) -> str:
    """What drove the motor of this run, for the page's head; empty if its samples are missing."""
    kinds = dict.fromkeys(stage_kind(span.stage) for span in run.spans())
    return ", ".join(words for kind, words in _DRIVEN.items() if kind in kinds)


def rounded(value: float, half_width: float = math.nan) -> str:
    """``value`` rounded to its ``half_width``, both in one unit, as ``answer_words`` does; with the minus of print."""
    return as_digits(value, half_width).replace("-", "−")


def percent(ratio: float) -> str:
    """A ratio in per cent, as ``answer_words`` has it; with the minus of print."""
    return in_percent(ratio).replace("-", "−")


def quantity(parameter: Parameter, estimate: EstimateResult, truth: dict[str, float]) -> Quantity:
    """One parameter of an estimate, with its interval, and its error if the truth is known."""
    exact = known(estimate.value(parameter.key))
    if not math.isfinite(exact):
        return Quantity(parameter, None, "–", "", "", "", "")
    value = parameter.factor * exact
    bounds = estimate.at_95(parameter.key)
    if parameter not in HEADLINE_PARAMETERS and exact == 0.0 and bounds is None:
        return Quantity(parameter, None, "–", "", "", "", "")  # zero stands for "not estimated"
    between = plus_minus = relative = ""
    half = math.nan
    if bounds is not None and bounds[1] - bounds[0] < STATED * abs(exact):
        bounds = None  # the times of the recording say it
    if bounds is not None:
        low, high = (parameter.factor * b for b in bounds)
        half = 0.5 * (high - low)
        middle = abs(0.5 * (low + high) - value) < 0.01 * half
        between = f"{rounded(low, half)} to {rounded(high, half)}"
        plus_minus = f"± {rounded(half, half)}" if middle else between
        if value and parameter in HEADLINE_PARAMETERS:
            relative = share(value, half)
    error = ""
    true = truth.get(parameter.key, math.nan)
    if math.isfinite(true):
        if parameter in HEADLINE_PARAMETERS and true:
            error = percent(exact / true - 1.0)
        else:
            difference = parameter.factor * (exact - true)
            error = f"{'+' if difference > 0.0 else ''}{rounded(difference, abs(difference))} {parameter.unit}"
    return Quantity(parameter, exact, rounded(value, half), between, plus_minus, relative, error)


def headline(run: ReportedRun) -> Headline:
    """Headline of the run: verdict, the three parameters, why, and what to do next."""
    answer = run.result.answer
    if answer is None or not answer.model_fields_set & EstimateResult.model_fields.keys():
        return _nothing(run)
    outcome: HeadlineOutcome = next((o for o in ("ok", "doubtful", "refused") if o == answer.verdict), "doubtful")
    quantities = tuple(_headed(quantity(p, answer, run.truth), answer) for p in HEADLINE_PARAMETERS)
    name = answer.method.replace("-", " ")
    models_from = run.result.models_from or ""
    sentences: list[str] = []
    next_steps: list[Step] = []
    if outcome == "refused":
        title = "No model: the estimate was refused"
        sentences.append(f"The {name} estimate does not describe this motor. The values below are for diagnosis only.")
        next_steps.append(Step("Do not use these values. Do what each reason says, then run the experiment again."))
    else:
        whole = all(q.exact is not None for q in quantities)
        found = "The motor is identified" if whole else "The friction is identified"
        if run.rehearsal:
            found = "The made-up motor is identified"
        title = found if outcome == "ok" else "Identified, but doubtful"
        if models_from:
            title = "Driven with the models of another run"
            sentences.append(f"What is shown here was identified in {models_from}.")
        if run.faults:
            title += ", and the run ended with a fault"
            next_steps.append(Step("Cure the fault above first."))
        sentences.extend(_plain_words(quantities, run, _unknown(answer)))
        if run.laws:
            titles = {law.name: law.title for law in DEPARTURES}
            laws = ", ".join(titles.get(law.name, law.name.replace("_", " ")) for law in run.laws)
            sentences.append(f"The motor has more than tau, K and friction: {laws}. The values include that.")
        graded = graded_words(answer)
        sentences.extend(f"{line[0].upper()}{line[1:]}." for line in ([graded] if graded else []))
        sentences.extend(f"It {line}." for line in validity(answer))
        if not whole:
            next_steps.append(
                Step("Friction is not enough to drive the bench: record a relay test for the other parameters.")
            )
        elif models_from:
            next_steps.append(Step("The tracking check below shows how well each of these models drives the bench."))
        elif outcome == "ok":
            next_steps.append(_drive_with(run))
        else:
            next_steps.append(Step("Treat the values as a first guess. Do what each reason says, then run again."))
    if answer.method != LEADING:
        text = f"These values come from the {name} method. A {LEADING} estimate is more exact; this run has none."
        next_steps.append(Step(text))
    return Headline(outcome, title, tuple(sentences), answer.reasons, tuple(next_steps), answer.method, quantities)


def _headed(one: Quantity, answer: Answer) -> Quantity:
    """What a shaft that turned one way tells of friction is named so: less the asymmetry, or with it."""
    if one.parameter.key != "fc_V" or "fc_less_bias_V" not in (answer.grade or {}):
        return one
    sign = "+" if answer.holds is not None and answer.holds.ways == "backward" else "−"
    return replace(
        one, parameter=replace(one.parameter, symbol=f"f_c {sign} a", meaning="friction one way, as a voltage")
    )


def _unknown(answer: Answer) -> set[str]:
    """The keys of the parameters that are not known."""
    return {key for key, one in (answer.grade or {}).items() if one.grade == "not known"}


def _plain_words(quantities: tuple[Quantity, ...], run: ReportedRun, unknown: set[str]) -> list[str]:
    """What the numbers mean, but for those that are not known."""
    tau, gain, friction = (q.exact for q in quantities)
    if tau is None or gain is None or friction is None:
        return []
    said = {
        "tau_s": f"After a step of drive the shaft reaches 63 % of its final speed in {1e3 * tau:.0f} ms.",
        "K_rad_s_V": f"Each volt beyond friction adds {gain:.3g} rad/s.",
        "fc_V": f"Coulomb friction takes {friction:.3g} V of the drive.",
    }
    words = " ".join(sentence for key, sentence in said.items() if key not in unknown)
    found = run.result.breakaway or BreakawayResult()
    plus = _some_V(found.static_plus_V, found.static_plus_range_V)
    minus = _some_V(found.static_minus_V, found.static_minus_range_V)
    if plus and minus:
        words += (
            f" To move the shaft from rest takes some {plus} towards rising positions, {minus} towards falling ones."
        )
    return [words.strip()] if words else []


def _some_V(value: float | None, reach: tuple[float | None, float | None] | None) -> str:
    """A drive with two digits and its interval; empty where it is not known."""
    level, low, high = map(known, (value, *(reach or (None, None))))
    if not level > 0.0:
        return ""
    digits = max(1 - math.floor(math.log10(level)), 0)
    between = f" ({low:.{digits}f} to {high:.{digits}f})" if math.isfinite(low + high) else ""
    return f"{level:.{digits}f} V{between}"


def _command(*parts: str | Path) -> str:
    """A command, quoted for a shell."""
    return shlex.join(["rig", *map(str, parts)])


def _drive_with(run: ReportedRun) -> Step:
    if run.rehearsal:
        triple = run.estimates.get(TRIPLE)
        if (
            run.spans("relay")
            and run.config.wanted_amplitude_rad is not None
            and (triple is None or triple.verdict != "ok")
        ):
            return Step(
                "The answer is good, but the limit cycles are not: the triple relay's estimate "
                f"is {'missing' if triple is None else triple.verdict}. Change relay.target, and rehearse again."
            )
        return Step(
            "The config fits this motor. Wire the bench, then: rig flash, rig calibrate, rig run (docs/real-bench.md)."
        )
    if run.has_tracked:
        words = "Its models have driven the bench: see the tracking check. For a controller:"
        return Step(words, _command("tune", run.folder))
    if not run.config.tracks:
        return Step("To drive the bench with this model, add a section `tracking` to the config and run it again.")
    if run.recording is None:
        return Step("Its samples are missing: to drive the bench with this model, identify the motor again.")
    command = _command("track", run.folder / "config.yaml", "--model", run.folder)
    return Step("Drive the bench with this model:", command)


def _again(run: ReportedRun, text: str) -> Step:
    """The advice to run the whole experiment, with its command if the config is there."""
    if not run.config.is_there:
        return Step(f"{text}.")
    return Step(f"{text}:", _command("run", run.folder / "config.yaml"))


def _nothing(run: ReportedRun) -> Headline:
    """Headline of a run without an estimate: why it has none, or what else the run did."""
    script = run.meta.script
    jogged = script is not None and script.name == "jog"
    own_law = script.law if script is not None and script.name == "law" else None
    reasons: tuple[str, ...] = ()
    if jogged:
        title = "The shaft was jogged"
    elif run.result.tuned is not None:
        title = "A tuned loop ran"
    elif own_law is not None:
        title = f"A law of your own ran: {own_law}"
    elif run.has_result:
        title = "No estimate in this run"
        reasons = tuple(n for n in run.result.notes if n.startswith(NOTHING_TO_IDENTIFY))
    else:
        title = "No result: the run ended before it had one"
    if run.faults:
        step = Step("Cure the fault above, then run again.")
    elif jogged:
        step = _again(run, "A jog identifies nothing; run the whole experiment")
    elif run.result.tuned is not None:
        step = Step("See below what was predicted, and what this bench did (docs/tune.md).")
    elif own_law is not None:
        step = Step(
            "Nothing is identified from such a run. Look at its stage `law` below, or from Python (docs/api.md)."
        )
    elif run.has_result:
        step = _again(run, "No relay test could be identified; run the whole experiment")
    elif run.spans("relay") or run.spans("hysteretic"):
        step = _again(run, "The notes below say what its relay tests lack; run the experiment again")
    elif run.recording is not None:
        step = _again(run, "It ended before a relay test; run the experiment again")
    else:
        step = Step("Nothing can be identified from this folder; run the experiment again.")
    return Headline("none", title, (), reasons, (step,), "", ())
