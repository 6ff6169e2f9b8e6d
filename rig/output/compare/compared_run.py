"""One run as `rig compare` sees it: its estimate, what its uncertainty is made of, and its bench."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rig.core.arrays import Array
from rig.core.estimators import MAIN
from rig.core.motor_numbers import PARTS
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.path_kind import no_run
from rig.run_folder.recording.reader import read_meta, read_result
from rig.run_folder.results import Answer, EstimateResult, FoundLawResult, RunMeta, RunResult, known

COVERAGE = 2.0  # of the half widths in a budget
FRICTION = "friction_over_position"
SCALES = ("supply", "calibration", "clock")  # lines of the budget that are not about laws
TYPE_A = "scatter"  # the budget's line of the noise, which the covariance holds already


class NotComparableError(Exception):
    """A run that cannot be compared. The message says why, and what to do."""


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """A run with a usable estimate.

    name         in messages and pictures
    values       (3,) ln tau (s), ln K ((rad/s)/V), friction in V
    covariance   (3, 3) of these by the noise (Type A)
    lines        what else may be wrong, by the budget's sources: (3,) standard deviations of these; None: no budget
    bench        what the run says of its bench: parts by name; a part may be missing
    laws         that the run shows
    largest_V    the largest drive that its answer was measured with, V; nan: not said
    travel_rad   middle and half width of the travel that its friction is the mean over, rad; None: not said
    """

    name: str
    folder: Path
    values: Array
    covariance: Array
    lines: Mapping[str, Array] | None
    bench: Mapping[str, object]
    meta: RunMeta
    verdict: str
    laws: tuple[FoundLawResult, ...] = ()
    notes: tuple[str, ...] = ()
    temperature_C: float | None = field(default=None)
    largest_V: float = math.nan
    travel_rad: tuple[float, float] | None = None

    @property
    def started(self) -> datetime | None:
        """When it started; None if meta.json does not say it."""
        try:
            found = datetime.fromisoformat(self.meta.started_utc or "")
        except ValueError:
            return None
        return found if found.tzinfo is not None else found.replace(tzinfo=UTC)

    @property
    def numbers(self) -> Array:
        """(3,) tau in s, K in (rad/s)/V, friction in V."""
        return in_units(self.values)


def in_units(values: Array) -> Array:
    """Tau in s, K in (rad/s)/V and friction in V, (3,).

    values   (3,) ln tau (s), ln K ((rad/s)/V), friction in V
    """
    return np.array([math.exp(values[0]), math.exp(values[1]), values[2]])


def read_run(folder: Path, name: str = "") -> ComparedRun:
    """Read a run folder's meta.json and result.json.

    name   in messages; default: the folder's
    Raises RecordingError (`no_run`) if it is no run folder, NotComparableError if it is broken, or its motor unknown.
    """
    if not folder.is_dir():
        raise no_run(folder)
    try:
        meta, meta_notes = read_meta(folder)
        result, notes = read_result(folder)
    except RecordingError as error:
        raise NotComparableError(f"its {error.path.name} {error.cause}; {error.cure}") from error
    if meta is None and result is None:
        raise no_run(folder)
    if result is None:
        raise NotComparableError(
            "it has no result.json: it was killed, or is still running; `rig report` may still help"
        )
    shown = name or folder.resolve().name
    return of_result(shown, folder, meta or RunMeta(), result, [*meta_notes, *notes])


def of_result(name: str, folder: Path, meta: RunMeta, result: RunResult, notes: Sequence[str] = ()) -> ComparedRun:
    """A run from its two files. Raises NotComparableError if its motor is not known."""
    if result.models_from is not None:
        raise NotComparableError(
            f"it was driven by the models of {result.models_from}, and measured no motor of its own"
        )
    answer = result.answer
    if answer is None:
        fault = f": {result.faults[0].code} ended it" if result.faults else ""
        raise NotComparableError(f"it identified no motor{fault}")
    why = f": {answer.reasons[0]}" if answer.reasons else ""
    if answer.is_refused:
        raise NotComparableError(f"its answer is refused{why}")
    if any(answer.interval(name) and answer.at_95(name) is None for name in MAIN):
        raise NotComparableError(f"its answer does not know its motor{why}")
    values, covariance = _values(answer)
    numbers = in_units(values)
    lines = None
    if result.budget and answer.u95:
        scale = np.array([1.0 / numbers[0], 1.0 / numbers[1], 1.0]) / COVERAGE
        lines = {
            entry.source: np.array([known(getattr(entry, key)) for key in MAIN]) * scale
            for entry in result.budget
            if entry.source != TYPE_A
        }
        lines = {source: np.where(np.isfinite(line), line, 0.0) for source, line in lines.items()}
    return ComparedRun(
        name, folder, values, covariance, lines, bench_of(meta), meta, answer.verdict,
        answer.law or (), tuple(notes), largest_V=_largest_V(answer), travel_rad=_travel_rad(answer),
    )  # fmt: skip


def _largest_V(answer: Answer) -> float:
    holds = answer.holds
    return math.nan if holds is None or holds.drive_V is None else known(holds.drive_V[1])


def _travel_rad(answer: Answer) -> tuple[float, float] | None:
    frame = answer.law_frame
    travel = (math.nan, 0.0) if frame is None else (known(frame.centre_rad), known(frame.half_travel_rad))
    return travel if math.isfinite(travel[0]) and 0.0 < travel[1] < math.inf else None


def over_one_travel(runs: Sequence[ComparedRun]) -> tuple[list[ComparedRun], tuple[float, float] | None]:
    """The runs with their friction as the mean over one travel, and that travel, rad; as they are, None: no need.

    Where friction changes over the travel, each run's is the mean over what it drove itself.
    """
    laws = [next((law for law in run.laws if law.name == FRICTION), None) for run in runs]
    travels = [run.travel_rad for run, law in zip(runs, laws, strict=True) if law is not None and run.travel_rad]
    if not travels:
        return list(runs), None
    middle, half = np.mean(travels, axis=0).tolist()
    shifted = [run if law is None else _over(run, law, middle, half) for run, law in zip(runs, laws, strict=True)]
    return shifted, (middle - half, middle + half)


def _over(run: ComparedRun, law: FoundLawResult, middle: float, half: float) -> ComparedRun:
    """The run with its friction over another travel; what its law is unsure of is in the covariance."""
    if run.travel_rad is None:
        return run
    own_middle, own_half = run.travel_rad
    mean = math.sin(half) / half
    by = np.array(
        [mean * math.sin(middle - own_middle), mean * math.cos(middle - own_middle) - math.sin(own_half) / own_half]
    )
    shift_V = float(by @ [known(law.numbers.get(name)) for name in PARTS[FRICTION]])
    low, high = law.ci95 or (None, None)
    error_V = float(np.linalg.norm(by)) * (known(high) - known(low)) / (2.0 * COVERAGE)
    if not math.isfinite(shift_V):
        return run
    values, covariance = run.values.copy(), run.covariance.copy()
    values[2] += shift_V
    covariance[2, 2] += error_V**2 if math.isfinite(error_V) else 0.0
    return replace(run, values=values, covariance=covariance)


def _values(estimate: EstimateResult) -> tuple[Array, Array]:
    tau, gain, friction = (known(estimate.value(name)) for name in MAIN)
    matrix = estimate.covariance or ()
    if len({len(row) for row in matrix}) > 1:
        raise NotComparableError("the covariance of its estimate is damaged: `rig identify` it anew")
    covariance = np.array(matrix, dtype=np.float64)
    at = [estimate.covariance_of.index(name) for name in MAIN if name in estimate.covariance_of]
    if not (tau > 0.0 and gain > 0.0 and math.isfinite(friction)):
        raise NotComparableError("its estimate lacks tau, K or f_c")
    if len(at) != len(MAIN) or covariance.ndim != 2 or min(covariance.shape) <= max(at):
        raise NotComparableError("its estimate has no covariance: an older rig wrote it; `rig identify` it anew")
    scale = np.array([1.0 / tau, 1.0 / gain, 1.0])
    own = covariance[np.ix_(at, at)] * np.outer(scale, scale)
    own = 0.5 * (own + own.T)
    if not (np.all(np.isfinite(own)) and np.all(np.diag(own) > 0.0) and np.linalg.eigvalsh(own)[0] > 0.0):
        raise NotComparableError("the covariance of its estimate is not known: record more cycles")
    return np.array([math.log(tau), math.log(gain), friction]), own


def bench_of(meta: RunMeta) -> dict[str, object]:
    """What a run says of its bench, by name: device, motor supply, sensor. What it does not say is missing."""
    said: dict[str, object] = {}
    if meta.backend:
        said["emulated"] = meta.emulated
        said["device"] = meta.backend.split(":")[0].split(" ")[0]
    if meta.firmware is not None and meta.firmware.board:
        said["board"] = meta.firmware.board
    if meta.drive is not None and meta.drive.supply_V is not None:
        said["motor supply"] = (meta.drive.supply_V, meta.drive.bridge_drop_V)
    if meta.sensor is not None:
        said["sensor"] = (meta.sensor.full_range_rad, meta.sensor.calibration_rad)
    return said


def benches(runs: Sequence[ComparedRun]) -> list[int]:
    """A number for each run, from 1: runs with one number are of one bench.

    What one of the runs does not say of its bench is not asked of the others.
    """
    numbers: dict[tuple[object, ...], int] = {}
    asked = _said_by_all(runs)
    return [numbers.setdefault(tuple(run.bench[part] for part in asked), len(numbers) + 1) for run in runs]


def bench_differences(runs: Sequence[ComparedRun]) -> list[str]:
    """The parts of their benches in which runs differ."""
    return [part for part in _said_by_all(runs) if any(run.bench[part] != runs[0].bench[part] for run in runs)]


def _said_by_all(runs: Sequence[ComparedRun]) -> list[str]:
    return [part for part in runs[0].bench if all(part in run.bench for run in runs)]


def shared_variance(runs: Sequence[ComparedRun], bench: Sequence[int]) -> dict[int, Array]:
    """For each bench the (3,) variances of what moves all its runs alike: the median of their budgets."""
    budgets: dict[int, list[Array]] = {number: [] for number in bench}
    for run, number in zip(runs, bench, strict=True):
        if run.lines:
            budgets[number].append(np.sum([line**2 for line in run.lines.values()], axis=0))
    return {
        number: np.asarray(np.median(known, axis=0), dtype=np.float64) if known else np.zeros(3)
        for number, known in budgets.items()
    }


def own_variance(runs: Sequence[ComparedRun], bench: Sequence[int]) -> Array:
    """The (n, 3) variances of what a run's budget has more of, or less, than the middle one of its bench.

    An effect that one run's tests exclude, and those of another do not, cancels between them no farther than this.
    """
    found = np.zeros((len(runs), 3))
    for number in set(bench):
        at = [k for k, run in enumerate(runs) if bench[k] == number and run.lines is not None]
        laws = [[line for source, line in (runs[k].lines or {}).items() if source not in SCALES] for k in at]
        sizes = np.sqrt([sum((line**2 for line in lines), np.zeros(3)) for lines in laws])
        found[at] += (sizes - np.sort(sizes, axis=0)[(len(at) - 1) // 2]) ** 2 if at else 0.0
    return found


def covariance_of(runs: Sequence[ComparedRun], bench: Sequence[int]) -> Array:
    """The covariance of all runs' values, (3 n, 3 n), run by run.

    Each run's noise is its own, and ``own_variance``. What else may be wrong moves all runs of a bench alike: it
    cancels between them. Between benches nothing is shared.
    """
    own = own_variance(runs, bench)
    whole = _block_diagonal([run.covariance + np.diag(more) for run, more in zip(runs, own, strict=True)])
    shared = shared_variance(runs, bench)
    if len(shared) == 1:
        return whole
    same = np.equal.outer(bench, bench)
    return whole + sum(
        np.kron(same & np.equal.outer(bench, [number] * len(runs)), np.diag(variance))
        for number, variance in shared.items()
    )


def uncancelled(runs: Sequence[ComparedRun]) -> Array:
    """The covariance of all runs' values if what else may be wrong is each run's own, (3 n, 3 n).

    That is too much for runs of one bench with tests of one kind, and a bound for any.
    """
    variances = [sum((line**2 for line in (run.lines or {}).values()), np.zeros(3)) for run in runs]
    blocks = [run.covariance + np.diag(variance) for run, variance in zip(runs, variances, strict=True)]
    return _block_diagonal(blocks)


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    from scipy.linalg import block_diag  # it loads slowly, and `import rig` loads this file

    return np.asarray(block_diag(*blocks), dtype=np.float64)
