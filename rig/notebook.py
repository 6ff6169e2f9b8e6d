"""What the Python API gives back: recordings and identifications that show themselves, on paper and in a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Self

from matplotlib.figure import Figure

from rig.identify import Estimate, Identification
from rig.optional import needed
from rig.recording.columns import COLUMNS, UNITS
from rig.recording.errors import RecordingError
from rig.recording.folder import META
from rig.recording.recording import Recording
from rig.report import source
from rig.report.fitted import forest_figure
from rig.report.measured import whole_run_figure
from rig.report.style import AbsentError, laid_out, style
from rig.report.tables import estimates as estimate_rows
from rig.results import RunMeta, RunResult
from rig.terminal import plain_table

if TYPE_CHECKING:
    from pandas import DataFrame

_HEADINGS = ("method", "tau, s", "K, (rad/s)/V", "f_c, V", "verdict")


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


@dataclass(repr=False)
class Found(Identification):
    """What was identified: ``best``, ``found["sampled-data"]``, ``estimates``, ``notes``: see ``Identification``."""

    @classmethod
    def of(cls, identification: Identification) -> Self:
        """An identification that shows itself."""
        return cls(**{field.name: getattr(identification, field.name) for field in fields(Identification)})

    def __getitem__(self, method: str) -> Estimate:
        """The estimate of one method. Raises KeyError, which names those there are."""
        if method not in self.estimates:
            raise KeyError(f"no estimate {method!r}; there are: {', '.join(self.estimates) or 'none'}")
        return self.estimates[method]

    def summary(self) -> str:
        """The estimates as a table with their 95 % intervals, then the reasons of their verdicts and the notes."""
        reasons = [f"{name}: {reason}" for name, e in self.estimates.items() for reason in e.reasons]
        return "\n".join([*plain_table(_HEADINGS, _table(self._result())), *reasons, *self.notes])

    def plot(self) -> Figure:
        """The estimates side by side with their 95 % intervals; a figure of matplotlib, which is not shown.

        A hollow mark is an estimate whose verdict is not ok. Raises ValueError where there is no estimate.
        """
        run = source.ReportedRun(Path(), None, RunMeta(), self._result())
        try:
            with style():
                return laid_out(forest_figure(run))
        except AbsentError as error:
            raise ValueError(str(error)) from error

    def _result(self) -> RunResult:
        return RunResult(estimates=self.as_result().estimates)

    def __repr__(self) -> str:
        return "\n".join(plain_table(_HEADINGS, _table(self._result())))

    def _repr_html_(self) -> str:
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in self.notes)
        return _estimates_html(self._result(), RunMeta()) + (f"<ul>{notes}</ul>" if notes else "")


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
