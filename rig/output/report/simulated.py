"""``--picture``: what the motor of an answer does under any recorded drive, beside what was measured."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rig.core.arrays import Array
from rig.identification.identification import Identification
from rig.identification.known_model import model_of
from rig.identification.measurements import at_their_times
from rig.identification.preprocessing import from_recording
from rig.model.real_motor import FramedMotor
from rig.output.report.model_curves import predicted
from rig.output.report.style import (
    INK,
    MEASURED,
    MUTED,
    RASTER_FROM,
    AbsentError,
    Picture,
    colour,
    laid_out,
    new_figure,
    plain,
    render,
    style,
)
from rig.run_folder.recording.folder import write_whole
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.results import Answer, known
from rig.run_folder.results.answer_words import beyond_drive, of_all

PNG_DPI = 130
TURNS_BACK = 0.1  # of the motion one way: from here on the shaft turns both ways
GAP = 5.0  # of the sampling period: over it no line is drawn
TITLE = 120  # letters in a row of titles
MOST = 3  # tests in one picture: beside each other, more are too narrow to read


@dataclass(frozen=True)
class Simulated:
    """One test, simulated from its start to its end under its recorded drive. Arrays of one length.

    t_s                   time since its first sample, s
    measured_rad, y_rad   position as recorded and as simulated; only the start is fitted
    parts                 between gaps, each with a start of its own
    """

    name: str
    t_s: Array
    measured_rad: Array
    y_rad: Array
    parts: int = 1

    @property
    def residual_rad(self) -> Array:
        """Recorded less simulated position, rad."""
        return self.measured_rad - self.y_rad

    @property
    def rms_rad(self) -> float:
        """RMS of the residual, rad."""
        return float(np.sqrt(np.mean(self.residual_rad**2)))

    @property
    def fit_percent(self) -> float:
        """100 % less the RMS residual over the standard deviation of the recorded position; 0 if it is no better."""
        spread_rad = float(np.std(self.measured_rad))
        if spread_rad == 0.0:
            return 0.0
        return 100.0 * max(1.0 - self.rms_rad / spread_rad, 0.0)


def simulated(found: Identification) -> list[Simulated]:
    """Each test of an identification, parts of one file as one, simulated by its answer.

    Raises AbsentError where the answer is no motor.
    """
    estimate, motor = found.best, found.real_motor
    if estimate is None or motor is None:
        raise AbsentError("The answer is refused, or has no tau and K: there is no motor to simulate.")
    shown: list[list[TimeSeries]] = []
    for test in found.tests:
        last = shown[-1][-1] if shown else None
        if last is not None and last.name == test.name and test.first_row >= last.first_row + len(last):
            shown[-1].append(test)
        else:
            shown.append([test])
    return [_of_parts(parts, motor, estimate.delay_s) for parts in shown]


def _of_parts(parts: Sequence[TimeSeries], motor: FramedMotor, delay_s: float) -> Simulated:
    """What lies between the gaps of one recording, side by side, each with a start of its own."""
    y_rad = np.concatenate([predicted(motor, part, slice(None), (delay_s,)).y_rad for part in parts])
    t_s, measured_rad = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_s", "y_rad"))
    return Simulated(parts[0].name, t_s - t_s[0], measured_rad, y_rad, len(parts))


def predicted_record(answer: Answer, recording: Recording) -> Simulated:
    """A recording as the motor of an answer moves under its drive: with laws and delay, from the start that fits best.

    A drift over the records that it was fitted to says nothing of another: it is left out. Raises AbsentError where the
    answer is no motor, IdentifyError where the recording is too short. What lies between gaps has a start of its own.
    """
    try:
        motor = model_of(answer)
    except ValueError as error:
        raise AbsentError(f"The answer holds a motor that cannot be: {error}.") from error
    if motor is None:
        raise AbsentError("The answer is refused, or has no tau, K and f_c: there is no motor to predict with.")
    motor = replace(motor, motor=motor.motor._replace(drift=0.0))
    name = recording.source.name
    parts = at_their_times(from_recording(recording, slice(0, len(recording)), name)[0])[0]
    return _of_parts(parts, motor, known(answer.delay_s))


def beyond(answer: Answer, recording: Recording) -> str:
    """Where a recording goes beyond what the answer was measured over, as a sentence; empty where it does not.

    Of a servo's own loop whose P nobody has measured, that its drive is hardly known.
    """
    holds, loop = answer.holds, recording.own_loop
    if loop is not None and loop.scale.high > loop.scale.low:
        factor = loop.scale.high / loop.scale.low
        return (
            f"the drive of this record is known to a factor of {factor:.3g} only, so a poor fit says nothing: --p-scale"
        )
    if holds is None:
        return ""
    drive = beyond_drive(holds, float(np.abs(recording.u_V).max()))
    said = [drive] if drive else []
    forth, back = (float(np.max(way - np.minimum.accumulate(way))) for way in (recording.y_rad, -recording.y_rad))
    least = TURNS_BACK * max(forth, back)
    if (holds.ways == "forward" and back > least) or (holds.ways == "backward" and forth > least):
        said.append(f"motion both ways, and the answer holds {holds.ways} alone")
    return f"beyond what the answer was measured over: {'; '.join(said)}" if said else ""


def fit_in_words(tests: Sequence[Simulated]) -> str:
    """The fit of each test, as ``any.csv 99.2 %, smaller.csv 98.7 %``."""
    return ", ".join(f"{one.name} {of_all(one.fit_percent)}" for one in tests)


def figure_of(found: Identification, tests: Sequence[Simulated]) -> Figure:
    """Measured against simulated position, the residual below, and the fit; a column for each of the first tests."""
    return drawn(tests, "" if found.best is None else found.best.method)


def drawn(tests: Sequence[Simulated], method: str) -> Figure:
    """As ``figure_of``; ``method``: of the answer, it gives the colour."""
    tests = tests[:MOST]
    figure = new_figure(4.4)
    panels = figure.subplots(2, len(tests), sharex="col", squeeze=False, height_ratios=(1.7, 1.0))
    for column, one in enumerate(tests):
        top, bottom = panels[0, column], panels[1, column]
        dense = one.t_s.size > RASTER_FROM
        gaps = np.flatnonzero(np.diff(one.t_s) > GAP * np.median(np.diff(one.t_s))) + 1
        t_s, measured_rad, y_rad = (np.insert(a, gaps, np.nan) for a in (one.t_s, one.measured_rad, one.y_rad))
        top.plot(t_s, measured_rad, color=MEASURED, lw=2.4, alpha=0.45, label="measured", rasterized=dense)
        top.plot(t_s, y_rad, color=colour(method), lw=0.9, label="simulated", rasterized=dense)
        most = TITLE // len(tests)
        name = one.name if len(one.name) <= most else f"{one.name[: most // 2]}…{one.name[-(most // 2) :]}"
        top.set_title(f"{plain(name)}\nfit {of_all(one.fit_percent)}")
        bottom.plot(t_s, 1e3 * (measured_rad - y_rad), color=colour(method), lw=0.6, rasterized=dense)
        bottom.axhline(0.0, color=INK if dense else MUTED, lw=0.7)
        bottom.set_xlabel("time since the start of the test, s")
    panels[0, 0].set_ylabel("position, rad")
    panels[1, 0].set_ylabel("residual, mrad")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def write_picture(found: Identification, path: Path) -> None:
    """``figure_of`` as a PNG. Raises AbsentError as ``simulated``, and CannotWriteError."""
    write_drawn(simulated(found), "" if found.best is None else found.best.method, path)


def write_drawn(tests: Sequence[Simulated], method: str, path: Path) -> None:
    """``drawn`` as a PNG. Raises CannotWriteError."""
    with style():
        buffer = io.BytesIO()
        laid_out(drawn(tests, method)).savefig(buffer, format="png", dpi=PNG_DPI)
    write_whole(path, buffer.getvalue())


def picture_of(found: Identification, source: str) -> Picture:
    """``figure_of`` for a page; ``source``: what it was recorded from. Raises AbsentError as ``simulated``."""
    tests = simulated(found)
    left_out = f" The other {len(tests) - MOST} tests: {fit_in_words(tests[MOST:])}." if len(tests) > MOST else ""
    return render(
        figure_of(found, tests), source, "Measured against simulated position, and the residual.",
        "The motor of the answer under the recorded drive, from the start of each test to its end; only position and "
        "speed at the start are fitted. Below: recorded less simulated position. Fit: 100 % less the RMS residual over "
        f"the standard deviation of the position.{left_out}",
    )  # fmt: skip
