"""What the Python API gives back: recordings and identifications that show themselves, on paper and in a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast

from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from rig.core.optional import needed
from rig.identification import Estimate, Identification
from rig.output.compare.comparison import Comparison
from rig.output.compare.page import write_page
from rig.output.report import source
from rig.output.report.fitted import forest_figure, residual_figure
from rig.output.report.measured import whole_run_figure
from rig.output.report.simulated import Simulated, beyond, drawn, figure_of, predicted_record, simulated
from rig.output.report.style import AbsentError, laid_out, style
from rig.output.report.tables import estimates as estimate_rows
from rig.output.report.words import PARAMETERS, quantity
from rig.output.text import (
    BUDGET_HEADINGS,
    MOTOR_LAW_HEADINGS,
    budget_rows,
    comparison_words,
    law_causes,
    motor_law_rows,
    plain_table,
)
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import META
from rig.run_folder.recording.reader import recordings_of
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.sample_columns import COLUMNS, UNITS
from rig.run_folder.results import Answer, EstimateResult, FoundLawResult, RunMeta, RunResult
from rig.run_folder.results.answer_words import answer_lines, of_all

if TYPE_CHECKING:
    from pandas import DataFrame

_PARAMETER_HEADINGS = ("parameter", "value", "95 % interval of the fit's scatter")
_HEADINGS = ("method, ± scatter alone", "tau, s", "K, (rad/s)/V", "f_c, V", "verdict")


@dataclass(frozen=True, eq=False, repr=False)
class Run(Recording):
    """A recording: a run folder, a CSV file, a simulation, or a stage of one. Its columns are those of ``Recording``.

    result   what result.json says; None of what is no run folder
    failure  why the run is not a success, in words; empty if it is
    """

    result: RunResult | None = None
    failure: str = ""

    @classmethod
    def of(cls, recording: Recording, result: RunResult | None = None, failure: str = "") -> Self:
        """A recording with what is known beside it."""
        columns = {field.name: getattr(recording, field.name) for field in fields(Recording)}
        return cls(**columns, result=result, failure=failure)

    @property
    def folder(self) -> Path:
        """The run folder. Raises RecordingError where the recording is in none."""
        if not (self.source / META).exists():
            raise RecordingError(self.source, "is no run folder", "give a run that rig.run has made")
        return self.source

    def __getitem__(self, stage: str) -> Run:
        """The rows of one stage, such as "relay-1" or "law". Raises RecordingError where there is none."""
        rows = self.stage_rows(stage)
        return Run.of(self.select(rows.start, rows.stop - 1), self.result, self.failure)

    def to_dataframe(self) -> DataFrame:
        """The columns that the recording has, one line a sample, as a DataFrame of pandas; ``attrs["units"]`` by name.

        Raises ImportError where pandas is not installed.
        """
        pandas = needed("pandas", "to_dataframe()")
        names = [name for name in COLUMNS if name in self.columns_present]
        index = pandas.RangeIndex(self.first_row, self.first_row + len(self), name="row")
        frame: DataFrame = pandas.DataFrame({name: getattr(self, name) for name in names}, index=index)
        frame.attrs["units"] = {name: UNITS[name] for name in names}
        return frame

    def plot(self) -> Figure:
        """Position and drive over time, with stages, cycles and faults; a figure of matplotlib, which is not shown."""
        run = source.ReportedRun(self.source, self, self.meta, self.result or RunResult(), events=self.events)
        with style():
            return laid_out(whole_run_figure(run)[0])

    def __repr__(self) -> str:
        return f"<Run {self.source}: " + ", ".join(f"{name} {text}" for name, text in self._facts()) + ">"

    def _repr_html_(self) -> str:
        facts = [("recording", str(self.source)), *self._facts()]
        shown = "" if self.result is None or not self.result.estimates else _estimates_html(self.result, self.meta)
        return _html_table(None, facts) + shown

    def _facts(self) -> list[tuple[str, str]]:
        """What there is to say of it in a few words."""
        duration_s = float(self.t_s[-1] - self.t_s[0])
        said = [("rows", f"{len(self)} in {duration_s:.4g} s"), ("stages", " ".join(self.stages()))]
        said += [("backend", self.meta.backend), ("failure", self.failure), ("notes", "; ".join(self.notes))]
        return [(name, text) for name, text in said if text]


@dataclass(frozen=True, eq=False, repr=False)
class Compared(Comparison):
    """Runs that were compared: both answers, and ``result``, which has all that `rig compare --json` prints."""

    @classmethod
    def of(cls, found: Comparison) -> Self:
        """A comparison that shows itself."""
        return cls(found.runs, found.result)

    @property
    def differs_measurably(self) -> bool:
        """Whether the runs differ by more than their noise explains."""
        return self.result.measurably.differs

    @property
    def differs_beyond_scatter(self) -> bool:
        """Whether they differ by more than one motor does from run to run."""
        return self.result.beyond_scatter.differs

    @property
    def odd(self) -> tuple[str, ...] | None:
        """The runs without which the others agree within their noise; None if no majority agrees, and of two runs."""
        return self.result.measurably.odd

    def summary(self) -> str:
        """Both answers, the scatter, the trends and the notes."""
        return "\n".join(comparison_words(self.result))

    def report(self, path: str | PathLike[str]) -> Path:
        """Write the report, a page of HTML, and return its path. Raises CannotWriteError."""
        write_page(self, Path(path))
        return Path(path)

    def __repr__(self) -> str:
        return self.summary()


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Simulated):
    """A record and what an answer says of it: ``t_s``, ``measured_rad``, ``y_rad``, ``residual_rad``, ``fit_percent``.

    beyond  where the record goes beyond what the answer was measured over, in words; empty where it does not
    method  of the answer
    """

    beyond: str = ""
    method: str = ""

    def plot(self) -> Figure:
        """Measured against predicted position, residual and fit; a figure of matplotlib, which is not shown."""
        with style():
            return laid_out(drawn([self], self.method))

    def __repr__(self) -> str:
        return f"{self.name}: fit {of_all(self.fit_percent)}" + (f"; {self.beyond}" if self.beyond else "")


@dataclass(frozen=True, repr=False)
class FoundEstimate(Estimate):
    """One estimator's result: ``tau_s``, ``K_rad_s_V``, ``fc_V``, ``ci95``, ``verdict``, ...: see ``Estimate``."""

    @classmethod
    def of(cls, estimate: Estimate) -> Self:
        """An estimate that shows itself."""
        return cls(**{field.name: getattr(estimate, field.name) for field in fields(Estimate)})

    def summary(self) -> str:
        """The verdict, the parameters with their 95 % intervals, the reasons; a refused estimate shows no number."""
        rows = self._rows()
        table = plain_table(_PARAMETER_HEADINGS, rows) if rows else []
        return "\n".join([f"{self.method}: {self.verdict}", *table, *self.reasons])

    def plot(self) -> Figure:
        """The residual: over time, its histogram, its autocorrelation; a figure of matplotlib, which is not shown.

        Raises ValueError for an estimate without a residual.
        """
        with _drawing():
            return laid_out(residual_figure(self.method, self.residual_t_s, self.residual_rad))

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        facts = [(self.method, self.verdict), *(("", reason) for reason in self.reasons)]
        rows = self._rows()
        return _html_table(None, facts) + (_html_table(_PARAMETER_HEADINGS, rows) if rows else "")

    def _result(self) -> EstimateResult:
        return self.as_result()

    def _rows(self) -> list[list[str]]:
        """The parameters that it has, a row each: meaning and unit, value, interval."""
        if self.verdict == "refused":
            return []
        all_of_them = [quantity(parameter, self._result(), {}) for parameter in PARAMETERS]
        known = [one for one in all_of_them if one.exact is not None]
        return [[f"{one.parameter.meaning}, {one.parameter.unit}", one.text, one.interval] for one in known]


@dataclass(frozen=True, repr=False)
class FoundAnswer(FoundEstimate):
    """The answer: an estimate with the laws that the tests show, and with ``answer``, which is as in result.json."""

    answer: Answer = field(default_factory=Answer)

    @property
    def law(self) -> tuple[FoundLawResult, ...] | None:
        """What the motor has beyond tau, K and friction; (): nothing; None: nobody looked."""
        return self.answer.law

    @property
    def u95(self) -> Mapping[str, float | None]:
        """Half widths at 95 % by parameter, in its unit, of all that the tests do not exclude; empty: not known."""
        return self.answer.u95 or {}

    def _result(self) -> EstimateResult:
        return self.answer


@dataclass(repr=False)
class Found(Identification):
    """What was identified: ``answer``, ``best``, ``found["sampled-data"]``, ``notes``: see ``Identification``."""

    @classmethod
    def of(cls, identification: Identification) -> Self:
        """An identification that shows itself."""
        parts = {field.name: getattr(identification, field.name) for field in fields(Identification)}
        return cls(**parts | {"estimates": {name: FoundEstimate.of(e) for name, e in identification.estimates.items()}})

    def __getitem__(self, method: str) -> FoundEstimate:
        """The estimate of one method. Raises KeyError, which names those there are."""
        if method not in self.estimates:
            raise KeyError(f"no estimate {method!r}; there are: {', '.join(self.estimates) or 'none'}")
        return cast(FoundEstimate, self.estimates[method])  # as ``of`` made it

    @property
    def best(self) -> FoundAnswer | None:
        """The answer: its estimate, with laws and u95; None where it is refused, or has no tau and K."""
        best, answer = super().best, self.answer
        return None if best is None or answer is None else replace(FoundAnswer.of(best), answer=answer)

    def to_control(self) -> Any:
        """The linear part of the answer, as a transfer function of python-control: see ``Estimate.to_control``.

        Raises ValueError where no estimate gives a motor; ImportError where the package control is not installed.
        """
        if self.best is None:
            raise ValueError("the answer is no motor; summary() says why")
        return self.best.to_control()

    def summary(self) -> str:
        """The answer; then each method, the laws, the uncertainty, reasons and notes."""
        reasons = [f"{name}: {reason}" for name, e in self.estimates.items() for reason in e.reasons]
        result = self.as_result()
        tables = (
            (_HEADINGS, _table(self._result())),
            (MOTOR_LAW_HEADINGS, motor_law_rows(result)),
            (BUDGET_HEADINGS, budget_rows(result)),
        )
        added = [line for headings, rows in tables if rows for line in plain_table(headings, rows)]
        return "\n".join([repr(self), *added, *reasons, *self.notes])

    def plot(self) -> Figure:
        """Measured against simulated position, residual and fit of each test; a figure of matplotlib, not shown.

        Raises ValueError where the answer is no motor.
        """
        with _drawing():
            return laid_out(figure_of(self, simulated(self)))

    def predict(
        self, data: Any, u: ArrayLike | None = None, y: ArrayLike | None = None, t_u: ArrayLike | None = None
    ) -> Prediction:
        """The motion of a record under its drive, by the answer with its laws and its delay.

        data, u, y, t_u  one record, as ``rig.identify`` takes it: a run, a path, or arrays of times, s, drives, V,
                         positions, rad, and times at which the drives act, s. Only the start is fitted to y
        Raises ValueError where the answer is no motor or there are several records; else as ``rig.identify``.
        """
        wanted = "found.predict takes one run, a path, or t, u and y"
        recordings = recordings_of(data, u, y, t_u, wanted)
        if len(recordings) != 1:
            raise ValueError(f"{wanted}: here are {len(recordings)} records")
        if self.answer is None:
            raise ValueError("there is no answer to predict with")
        try:
            shown = predicted_record(self.answer, recordings[0])
        except AbsentError as error:
            raise ValueError(str(error)) from error
        return Prediction(**vars(shown), beyond=beyond(self.answer, recordings[0]), method=self.answer.method)

    def plot_methods(self) -> Figure:
        """The answer and each method side by side with their 95 % intervals; a figure of matplotlib, not shown.

        A hollow mark: its verdict is not ok. Raises ValueError where there is no estimate.
        """
        run = source.ReportedRun(Path(), None, RunMeta(), self._result())
        with _drawing():
            return laid_out(forest_figure(run))

    def _result(self) -> RunResult:
        return RunResult(answer=self.answer, estimates=self.as_result().estimates)

    def __repr__(self) -> str:
        return "\n".join(answer_lines(self.answer, law_causes()))

    def _repr_html_(self) -> str:
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in self.notes)
        return _estimates_html(self._result(), RunMeta()) + (f"<ul>{notes}</ul>" if notes else "")


@contextmanager
def _drawing() -> Iterator[None]:
    """The style of figures in the block. Raises ValueError where there is nothing to draw."""
    try:
        with style():
            yield
    except AbsentError as error:
        raise ValueError(str(error)) from error


def _table(result: RunResult, meta: RunMeta | None = None) -> list[list[str]]:
    """The estimates, a row each; a refusal gives no number."""
    rows = []
    for row in estimate_rows(source.ReportedRun(Path(), None, meta or RunMeta(), result)):
        numbers = [f"{quantity.text} {quantity.plus_minus}".strip() for quantity in row.quantities[:3]]
        rows.append([row.method, *(["–"] * 3 if row.verdict == "refused" else numbers), row.verdict])
    return rows


def _estimates_html(result: RunResult, meta: RunMeta) -> str:
    reasons = [(name, reason) for name, e in result.estimates.items() for reason in e.reasons]
    return _html_table(_HEADINGS, _table(result, meta)) + (_html_table(None, reasons) if reasons else "")


def _html_table(headings: Sequence[str] | None, rows: Iterable[Sequence[str]]) -> str:
    head = "" if headings is None else _html_row("th", headings)
    return f"<table>{head}{''.join(_html_row('td', row) for row in rows)}</table>"


def _html_row(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f'<{tag} style="text-align:left">{html.escape(cell)}</{tag}>' for cell in cells) + "</tr>"
