"""The motor of a run as an export gives it: numbers with units and intervals, laws, and where they come from."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

from rig.core.motor_numbers import FRAME, PARTS
from rig.core.motor_numbers import NUMBERS as OF_MOTOR
from rig.core.package import VERSION
from rig.identification.known_model import known_model
from rig.model.real_motor import FramedMotor
from rig.output.export.whole_run import ExportedRun
from rig.run_folder.recording.text_file import content_of
from rig.run_folder.recording.writer import SAMPLES
from rig.run_folder.results import Answer, FoundLawResult, JsonObject, known, whole
from rig.run_folder.results.answer_words import validity

# What the estimate calls what the motor calls otherwise.
_OF_ESTIMATE: Final = {"bias_V": "asym_V"}
_OVER_POSITION: Final = tuple(
    name for part in ("force_over_position", "friction_over_position", "cogging", "linearity") for name in PARTS[part]
)
_OF_PLACES: Final = ("centre_rad", "half_travel_rad")
# Every number that an export may write, in the order of the equation.
NUMBERS: Final = OF_MOTOR | {name: FRAME[name] for name in _OF_PLACES}


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from.

    run             name of the run folder; of a run that another run's models drove: of that one
    record_sha256   SHA-256 of its samples.csv; None: there is none in the folder that was read
    bench           the bench in words
    emulated        whether nothing real moved
    method          the estimator
    verdict         of the estimate: ok or doubtful
    reasons         why it is doubtful, in words
    holds           drives, speeds and ways that it was measured over, and what it predicts, in words
    """

    run: str
    record_sha256: str | None
    bench: str
    emulated: bool
    method: str
    verdict: str
    reasons: tuple[str, ...]
    holds: tuple[str, ...]

    def lines(self) -> list[str]:
        """In words, for the head of a file."""
        record = (
            f"SHA-256 of its samples.csv: {self.record_sha256}"
            if self.record_sha256
            else "its samples.csv is not at hand"
        )
        lines = [
            f"Identified by rig {VERSION} from run {self.run}.",
            record,
            f"Bench: {self.bench or 'not known'}{' (emulated)' if self.emulated else ''}.",
            f"Estimate: {self.method}, verdict {self.verdict}.",
        ]
        return [*lines, *(f"- {one}" for one in self.reasons), *(f"It {one}." for one in self.holds)]


@dataclass(frozen=True)
class KnownNumber:
    """One number of the model.

    ci95   its 95 % interval by the scatter of the fit, or of its law's size; None: not known
    u95    half width at 95 % with all that the tests do not exclude, in the bench's own units; None: not known
    u95_absolute   the same in true volts, radians and seconds
    """

    name: str
    value: float
    ci95: tuple[float, float] | None = None
    u95: float | None = None
    u95_absolute: float | None = None

    @property
    def unit(self) -> str:
        """Its unit; 1: none."""
        return NUMBERS[self.name].unit

    @property
    def meaning(self) -> str:
        """In words."""
        return NUMBERS[self.name].meaning

    def as_json(self) -> JsonObject:
        """As an export writes it."""
        return {
            "value": self.value,
            "unit": self.unit,
            "meaning": self.meaning,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "u95": self.u95,
            "u95_absolute": self.u95_absolute,
        }

    def line(self) -> str:
        """Name, value, unit, interval and meaning."""
        unit = f" {self.unit}" if self.unit != "1" else ""
        return f"{self.name} = {self.value!r}{unit}, {self.words()}"

    def words(self) -> str:
        """Interval and meaning."""
        parts = []
        if self.ci95 is not None:
            parts.append(f"95 % {self.ci95[0]:.6g} to {self.ci95[1]:.6g}")
        if self.u95 is not None:
            parts.append(f"u95 {self.u95:.3g}")
        return ", ".join([*parts, self.meaning])


def law_words(law: FoundLawResult) -> str:
    """A law that the tests show, in one line: its name, its size and the interval of its size."""
    unit = f" {law.unit}" if law.unit != "1" else ""
    interval = f", 95 % {ci95[0]:.4g} to {ci95[1]:.4g}" if (ci95 := whole(law.ci95)) is not None else ""
    return f"{law.name} {known(law.value):.4g}{unit}{interval}"


@dataclass(frozen=True)
class IdentifiedMotor:
    """The motor of a run: what every export of a model writes.

    framed    the motor with its laws, and what they refer to; its own delay is 0
    delay_s   from a sample to the effect of its drive, s, >= 0
    correlation   of the estimates of tau and K, -1 to 1; None: not known
    lacks     laws that the tool cannot express, each with what follows; an exporter sets it
    torque_N_m_V, R_ohm   of a volt and of the winding, as the user states them; None: not stated
    """

    framed: FramedMotor
    delay_s: float
    numbers: tuple[KnownNumber, ...]
    laws: tuple[FoundLawResult, ...]
    provenance: Provenance
    correlation: float | None
    lacks: Mapping[str, str]
    torque_N_m_V: float | None = None
    R_ohm: float | None = None

    def lacking(self, parts: Mapping[str, str]) -> IdentifiedMotor:
        """The same for a tool that cannot express ``parts`` (name: what follows), as far as the motor has them."""
        return replace(self, lacks={name: why for name, why in parts.items() if name in self.framed.parts})

    def number(self, name: str) -> KnownNumber:
        """One number of motor or frame by its name; 0 if the motor has not that part."""
        return next((one for one in self.numbers if one.name == name), KnownNumber(name, 0.0))

    def value(self, name: str) -> float:
        """Its value."""
        return self.number(name).value

    def all_values(self) -> dict[str, float]:
        """Every number by its name; 0 for a part that the motor has not."""
        return {name: self.value(name) for name in NUMBERS}

    def as_json(self) -> JsonObject:
        """Everything, as one object."""
        source = self.provenance
        return {
            "rig": VERSION,
            **asdict(source),
            "reasons": list(source.reasons),
            "holds": list(source.holds),
            "numbers": {one.name: one.as_json() for one in self.numbers},
            "laws": [
                {
                    "name": law.name,
                    "value": law.value,
                    "unit": law.unit,
                    "ci95": (ci95 := whole(law.ci95)) and list(ci95),
                }
                for law in self.laws
            ],
            "lacks": dict(self.lacks),
        }

    def head(self) -> list[str]:
        """What a file says first: source, laws, and what it lacks."""
        found = [f"Laws beyond Coulomb friction: {'; '.join(map(law_words, self.laws)) or 'none'}."]
        return [*self.provenance.lines(), *found, *self.lacks_in_words()]

    def lacks_in_words(self) -> list[str]:
        """One line for each law that the tool cannot express: its size, and what follows."""
        sizes = {law.name: law_words(law) for law in self.laws}
        return [f"LACKS {sizes.get(name, name)}: {why}" for name, why in self.lacks.items()]


def identified_motor(run_folder: Path, run: ExportedRun) -> IdentifiedMotor:
    """The motor of a run folder that was read as ``run``, by its result.json.

    Raises RecordingError if it holds no model that was not refused.
    """
    framed, answer = known_model(run_folder, math.inf), run.result.answer
    assert answer is not None  # it is where the model comes from
    laws = tuple(law for law in answer.law or () if law.value is not None)
    meta, samples, others = run.recording.meta, run_folder / SAMPLES, run.result.models_from
    is_own = others is None and samples.exists()
    provenance = Provenance(
        run_folder.resolve().name if others is None else Path(others).name,
        hashlib.sha256(content_of(samples, own=True)).hexdigest() if is_own else None,
        meta.backend,
        meta.emulated,
        answer.method,
        answer.verdict,
        answer.reasons,
        tuple(validity(answer)),
    )
    delay_s = max(answer.delay_s or 0.0, 0.0)
    numbers = tuple(_numbers(framed, delay_s, answer))
    correlation = answer.correlation_of("tau_s", "K_rad_s_V")
    return IdentifiedMotor(framed, delay_s, numbers, laws, provenance, correlation, {})


def _numbers(framed: FramedMotor, delay_s: float, answer: Answer) -> Iterable[KnownNumber]:
    """Every number that the motor has, in the order of ``NUMBERS``."""
    has = framed.numbers | {"delay_s": delay_s}
    u95, absolute = answer.u95 or {}, answer.u95_absolute or {}
    sizes = {}
    for law in answer.law or ():
        if len(law.numbers) == 1:  # then the size of the law is the number itself
            sizes[next(iter(law.numbers))] = whole(law.ci95)
    of_places = any(has.get(name) for name in _OVER_POSITION)
    for name in NUMBERS:
        if name not in has or (name in _OF_PLACES and not of_places):
            continue
        of_estimate = _OF_ESTIMATE.get(name, name)
        interval = answer.interval(of_estimate) or sizes.get(name)
        yield KnownNumber(name, has[name], interval, u95.get(of_estimate), absolute.get(of_estimate))
