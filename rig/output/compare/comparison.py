"""Is it one motor? Two answers, and the trend (docs/compare.md, docs/theory.md 9.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rig.core.arrays import Array
from rig.core.errors import CauseError
from rig.core.estimators import MAIN
from rig.core.signals import plain
from rig.output.compare.compared_run import (
    SCALES,
    ComparedRun,
    NotComparableError,
    bench_differences,
    benches,
    covariance_of,
    in_units,
    over_one_travel,
    own_variance,
    read_run,
    shared_variance,
    uncancelled,
)
from rig.output.compare.statistics import (
    Agreement,
    Off,
    agreement,
    between_runs,
    holm,
    odd_ones,
    off_the_others,
    quantile,
    slope,
)
from rig.run_folder.results.comparison import (
    ComparedRunResult,
    ComparisonResult,
    Difference,
    LeftOutResult,
    ScatterResult,
    TrendResult,
)
from rig.run_folder.results.meta import REHEARSAL

LEVEL = 0.05  # probability of a false alarm of each answer
MOST_RUNS = 200
REPEATS = 4  # other runs from which the scatter from run to run is taken
FOR_A_TREND = 3  # runs
WORDS = {"tau_s": "tau", "K_rad_s_V": "K", "fc_V": "f_c"}

# What a motor does whose temperature nobody holds: 2.5 K from run to run (standard deviation).
COPPER = 0.393  # %/K: its resistance at 20 degrees C (IEC 60028)
MAGNET = -0.2  # %/K: the flux of a ferrite magnet; of NdFeB it is -0.12
KELVIN = 2.5
OTHER_RANGE = 1.5  # ratio of the largest drives of two runs from which on it is said


@dataclass(frozen=True)
class Scatter:
    """Standard deviation of tau, K and f_c from run to run of one motor, % of each; and where the numbers come from.

    Raises ValueError for numbers outside of 0 to 100.
    """

    percent: tuple[float, float, float]
    why: str
    source: str = "stated"

    def __post_init__(self) -> None:
        if len(self.percent) != len(MAIN) or not all(0.0 <= one <= 100.0 for one in self.percent):
            raise ValueError("the scatter is three numbers from 0 to 100: of tau, K and f_c, in %")


# tau = R J / k^2, K = 1 / k and f_c = R T / k, for a motor of flux k, resistance R, inertia J and friction torque T
DEFAULT = Scatter(
    ((COPPER - 2.0 * MAGNET) * KELVIN, -MAGNET * KELVIN, (COPPER - MAGNET) * KELVIN),
    f"copper ({COPPER} %/K) and ferrite ({MAGNET} %/K) within {KELVIN} K; what friction itself wanders, no formula "
    "says: repeat your run, or give --scatter",
    "default",
)


class CompareError(CauseError):
    """Runs that cannot be compared. ``cause`` and ``cure`` are sentences; ``left_out`` says why of each."""

    status = 1

    def __init__(self, cause: str, cure: str, left_out: Sequence[LeftOutResult] = ()) -> None:
        super().__init__(cause, cure)
        self.left_out = tuple(left_out)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs, and what came of comparing them."""

    runs: tuple[ComparedRun, ...]
    result: ComparisonResult


def compare(
    folders: Sequence[Path], scatter: Scatter | None = None, temperatures: Mapping[str, float] | None = None
) -> Comparison:
    """Compare run folders.

    scatter       from run to run; None: from the runs where there are five or more, else ``DEFAULT``
    temperatures  in degrees C, by the names of folders
    Raises CompareError where fewer than two can be compared, RecordingError for a path that is no run.
    """
    if len(folders) > MOST_RUNS:
        raise CompareError(
            f"{len(folders)} runs are too many: {MOST_RUNS} at most", "give fewer, such as every other one"
        )
    runs, left_out = [], []
    for folder, name in zip(folders, _names(folders), strict=True):
        try:
            run = read_run(folder, name)
        except NotComparableError as error:
            left_out.append(LeftOutResult(folder=str(folder), reason=str(error)))
        else:
            runs.append(replace(run, temperature_C=(temperatures or {}).get(folder.resolve().name)))
    return compare_runs(runs, scatter, left_out, _unknown(folders, temperatures or {}))


def _names(folders: Sequence[Path]) -> list[str]:
    """The folders' own names; where two are alike, as given."""
    own = [folder.resolve().name for folder in folders]
    return [plain(name if own.count(name) == 1 else str(folder)) for name, folder in zip(own, folders, strict=True)]


def _unknown(folders: Sequence[Path], temperatures: Mapping[str, float]) -> list[str]:
    names = sorted(set(temperatures) - {folder.resolve().name for folder in folders})
    return [f"the temperatures name runs that are not compared: {', '.join(names)}"] if names else []


def compare_runs(
    runs: Sequence[ComparedRun],
    scatter: Scatter | None = None,
    left_out: Sequence[LeftOutResult] = (),
    notes: Sequence[str] = (),
) -> Comparison:
    """Compare runs that were read. As ``compare``.

    Raises CompareError where they are fewer than two.
    """
    if len(runs) < 2:
        why = "".join(f"; {one.folder}: {one.reason}" for one in left_out)
        raise CompareError(
            f"it takes two runs whose motor is known, and there {'is one' if runs else 'is none'}{why}",
            "give more runs that ended with an estimate",
            left_out,
        )
    runs, travel_rad = over_one_travel(_by_start(runs))
    bench = benches(runs)
    values, covariance = np.array([run.values for run in runs]), covariance_of(runs, bench)
    if np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise CompareError("the runs' covariance has no inverse", "leave out runs, one at a time, to see which it is")
    chance = agreement(values, covariance).chance
    odd = odd_ones(values, covariance, LEVEL)
    found = _beside_the_agreeing(values, covariance, odd or ())
    mean = in_units(values.mean(axis=0))
    scale = np.array([1.0, 1.0, 1.0 / max(abs(float(mean[2])), 1e-12)])  # of ln tau, ln K and f_c in V: relative
    relative, variances = values * scale, _variances(runs, bench) * scale**2
    used = scatter or (None if len(runs) > REPEATS else DEFAULT)
    off = _off(relative, variances, used)
    result = ComparisonResult(
        runs=tuple(
            _run(run, bench[k], (found.off[k] * scale, found.error[k] * scale, float(found.alone[k])), off[k])
            for k, run in enumerate(runs)
        ),
        left_out=tuple(left_out),
        level=LEVEL,
        measurably=_measurably(runs, values, odd, chance),
        beyond_scatter=_beyond(runs, off, used),
        scatter=_scatter(used, relative, variances),
        trends=tuple(_trends(runs, relative, variances)),
        notes=(*notes, *_of_travel(travel_rad), *_notes(runs, bench)),
    )
    return Comparison(tuple(runs), result)


def _by_start(runs: Sequence[ComparedRun]) -> list[ComparedRun]:
    """By their start; as given where one does not say when it was."""
    starts = {run.folder: run.started for run in runs if run.started is not None}
    return sorted(runs, key=lambda run: starts[run.folder]) if len(starts) == len(runs) else list(runs)


def _variances(runs: Sequence[ComparedRun], bench: Sequence[int]) -> Array:
    """(n, 3) variances of the values beside those of the largest bench: each run's noise, and what is not shared."""
    noise = np.array([np.diag(run.covariance) for run in runs]) + own_variance(runs, bench)
    largest = max(bench, key=bench.count)
    shared = shared_variance(runs, bench)
    return noise + np.array([0.0 if one == largest else 1.0 for one in bench])[:, None] * (
        np.array([shared[one] for one in bench]) + shared[largest]
    )


def _beside_the_agreeing(values: Array, covariance: Array, odd: Sequence[int]) -> Agreement:
    """How far each run is off the others, without those that are odd."""
    n, p = values.shape
    blocks = covariance.reshape(n, p, n, p)
    off, error, square = np.empty((n, p)), np.empty((n, p)), np.empty(n)
    rest = [k for k in range(n) if k not in odd]
    for extra in (None, *odd):
        here = rest if extra is None else [*rest, extra]
        found = agreement(values[here], blocks[np.ix_(here, range(p), here, range(p))].reshape(p * len(here), -1))
        for row, k in enumerate(here):
            if extra in (None, k):
                off[k], error[k], square[k] = found.off[row], found.error[row], found.square[row]
    return Agreement(math.nan, off, error, square)


def _off(relative: Array, variances: Array, scatter: Scatter | None) -> list[list[Off]]:
    """For each run, and each parameter, how far it is off the others."""
    known = [None] * 3 if scatter is None else [(0.01 * one) ** 2 for one in scatter.percent]
    return [
        [off_the_others(relative[:, p], variances[:, p], k, known[p]) for p in range(3)] for k in range(len(relative))
    ]


def _run(run: ComparedRun, bench: int, off: tuple[Array, Array, float], beyond: Sequence[Off]) -> ComparedRunResult:
    numbers, relative = run.numbers, np.sqrt(np.diag(run.covariance))
    errors = relative * np.append(numbers[:2], 1.0)
    by, error, chance = off
    normal = quantile(math.inf)
    return ComparedRunResult.of(
        run,
        folder=str(run.folder),
        started_utc=run.meta.started_utc,
        bench=bench,
        tau_s=float(numbers[0]),
        K_rad_s_V=float(numbers[1]),
        fc_V=float(numbers[2]),
        ci95={
            key: (float(value - normal * e), float(value + normal * e))
            for key, value, e in zip(MAIN, numbers, errors, strict=True)
        },
        off_percent={key: _percent(key, float(one)) for key, one in zip(MAIN, by, strict=True)},
        off_ci95_percent={
            key: (_percent(key, float(one - normal * e)), _percent(key, float(one + normal * e)))
            for key, one, e in zip(MAIN, by, error, strict=True)
        },
        chance=chance,
        beyond_ci95_percent={
            key: (_percent(key, one.by - one.half), _percent(key, one.by + one.half))
            for key, one in zip(MAIN, beyond, strict=True)
        },
        beyond_chance={key: one.chance for key, one in zip(MAIN, beyond, strict=True)},
    )


def _percent(key: str, by: float) -> float:
    """``by`` in %: a difference of logarithms, but of f_c, whose differences are shares already."""
    return 100.0 * (by if key == "fc_V" else math.expm1(by))


def _measurably(runs: Sequence[ComparedRun], values: Array, odd: Sequence[int] | None, chance: float) -> Difference:
    if chance >= LEVEL:
        words = (
            "No: their noise, and what only some of their tests exclude, explain how they differ "
            f"(chance {_chance(chance)})."
        )
        return Difference(differs=False, chance=chance, odd=() if len(runs) > 2 else None, words=words)
    names = None if odd is None else tuple(runs[k].name for k in odd)
    if len(runs) == 2:
        words = f"Yes: their noise does not explain how they differ (chance {_chance(chance)})."
    elif names:
        words = f"Yes: {_listed(names)} {_differ(names)} from the others, which agree (chance {_chance(chance)})."
    else:
        words = f"Yes (chance {_chance(chance)}), and no majority of them agrees: rig cannot say which one is odd."
    return Difference(differs=True, chance=chance, odd=names, words=f"{words}{_unless(runs, values)}")


def _unless(runs: Sequence[ComparedRun], values: Array) -> str:
    """What else could explain how they differ, if their tests were not alike; empty if nothing could."""
    if agreement(values, uncancelled(runs)).chance < LEVEL:
        return ""
    sources = {source for run in runs for source in run.lines or () if source not in SCALES}
    size = dict.fromkeys(sources, 0.0)
    for run in runs:
        for source, line in (run.lines or {}).items():
            if source in size:
                size[source] += float(np.sum(line**2 / np.diag(run.covariance)))
    largest = max(size, key=lambda source: size[source], default="another law")
    return (
        f" Unless their tests differ in kind or size: then it may come from {largest.replace('_', ' ')}, "
        "which they do not exclude."
    )


def _beyond(runs: Sequence[ComparedRun], off: Sequence[Sequence[Off]], scatter: Scatter | None) -> Difference:
    looked = off[-1:] if len(runs) == 2 else off  # of two runs each is off the other by the same
    corrected = holm([one.chance for run in looked for one in run])
    chance = min(corrected)
    by_run = [min(corrected[3 * k : 3 * k + 3]) < LEVEL for k in range(len(looked))]
    names = tuple(run.name for run, odd in zip(runs, by_run, strict=False) if odd) if len(runs) > 2 else None
    of = "its other runs" if scatter is None else "one motor"
    if chance >= LEVEL:
        words = f"No: {'the others scatter' if scatter is None else 'one motor scatters'} as much from run to run"
        words = f"{words} (chance {_chance(chance)})."
    elif names is None:
        which = [WORDS[key] for key, one in zip(MAIN, corrected, strict=True) if one < LEVEL]
        words = f"Yes: in {_listed(which)} by more than {of} does from run to run (chance {_chance(chance)})."
    elif 2 * len(names) < len(runs):
        words = f"Yes: {_listed(names)} {_differ(names)} by more than the others scatter (chance {_chance(chance)})."
    else:
        words = f"Yes (chance {_chance(chance)}), and not in one or two runs only: rig cannot say which one is odd."
        names = None
    return Difference(differs=chance < LEVEL, chance=chance, odd=names, words=words)


def _scatter(used: Scatter | None, relative: Array, variances: Array) -> ScatterResult:
    if used is not None:
        percent = dict(zip(MAIN, used.percent, strict=True))
        return ScatterResult(source=used.source, percent=percent, why=used.why)
    ones = np.ones((len(relative), 1))
    percent = {
        key: 100.0 * math.sqrt(between_runs(ones, relative[:, p], variances[:, p])) for p, key in enumerate(MAIN)
    }
    why = f"the scatter of these {len(relative)} runs beyond their noise; each run is judged by that of the others"
    return ScatterResult(source="runs", percent=percent, why=why)


def hours_of(runs: Sequence[ComparedRun]) -> list[float]:
    """When each run started, hours after the first; nan where it does not say."""
    first = min((run.started for run in runs if run.started is not None), default=None)
    return [
        math.nan if run.started is None or first is None else (run.started - first).total_seconds() / 3600.0
        for run in runs
    ]


def degrees_of(runs: Sequence[ComparedRun]) -> list[float]:
    """The temperature of each run, degrees Celsius; nan where nobody says it."""
    return [math.nan if run.temperature_C is None else run.temperature_C for run in runs]


def _trends(runs: Sequence[ComparedRun], relative: Array, variances: Array) -> list[TrendResult]:
    """Over time and over temperature, as far as the runs say them."""
    found: list[TrendResult] = []
    for over, unit, at in (("time", "%/h", hours_of(runs)), ("temperature", "%/K", degrees_of(runs))):
        known = np.flatnonzero(np.isfinite(at))
        x = np.array(at)[known]
        if known.size < FOR_A_TREND or not np.ptp(x) > 0.0:
            continue
        lines = [slope(x, relative[known, p], variances[known, p]) for p in range(3)]
        shown = [chance < LEVEL for chance in holm([line.chance for line in lines])]
        found += [
            TrendResult(
                over=over, parameter=key, unit=unit, slope=100.0 * line.slope, chance=line.chance, shows=shows,
                ci95=(100.0 * (line.slope - line.half), 100.0 * (line.slope + line.half)),
            )
            for key, line, shows in zip(MAIN, lines, shown, strict=True)
        ]  # fmt: skip
    return found


def _of_travel(travel_rad: tuple[float, float] | None) -> list[str]:
    if travel_rad is None:
        return []
    low, high = travel_rad
    return [f"friction changes over the travel: here f_c is the mean from {low:.3g} to {high:.3g} rad in each run"]


def _notes(runs: Sequence[ComparedRun], bench: Sequence[int]) -> list[str]:
    notes = [f"{run.name}: {REHEARSAL}" for run in runs if run.meta.rehearsal]
    notes += [f"{run.name}: {note}" for run in runs for note in run.notes]
    if len(set(bench)) > 1:
        notes.append(
            f"the runs are of {len(set(bench))} benches: they differ in {_listed(bench_differences(runs))}. The errors "
            "of motor supply, calibration and clock do not cancel between them"
        )
    unsaid = [run.name for run in runs if run.lines is None]
    if unsaid:
        notes.append(
            f"{_listed(unsaid)}: no budget of what else may be wrong: an older rig wrote it, or no laws were looked for"
        )
    doubtful = [run.name for run in runs if run.verdict != "ok"]
    if doubtful:
        notes.append(f"not ok: {_listed(doubtful)}; what makes an estimate doubtful can make it differ, too")
    laws = [{law.name for law in run.laws} for run in runs]
    names = {name for own in laws for name in own}
    for name in sorted(name for name in names if not all(name in own for own in laws)):
        has = [run.name for run, own in zip(runs, laws, strict=True) if name in own]
        notes.append(
            f"{name.replace('_', ' ')} shows in {_listed(has)} only: a part that changed, or tests that cannot show it"
        )
    by_drive = sorted((run for run in runs if run.largest_V > 0.0), key=lambda run: run.largest_V)
    if by_drive and by_drive[-1].largest_V > OTHER_RANGE * by_drive[0].largest_V:
        low, high = by_drive[0], by_drive[-1]
        notes.append(
            f"{low.name} was driven by up to {low.largest_V:.3g} V, and {high.name} by up to {high.largest_V:.3g} V: a "
            "motor whose speed over the drive is no straight line shows another K in each"
        )
    return notes + _supplies(runs)


def _supplies(runs: Sequence[ComparedRun]) -> list[str]:
    """What the devices measured of the motor supply, where it differs: a drive of 1 V is then not 1 V in each run."""
    seen = [
        (run.name, run.meta.firmware.supply_V)
        for run in runs
        if run.meta.firmware is not None and run.meta.firmware.supply_V is not None
    ]
    volts = [volt for _, volt in seen]
    if not volts or max(volts) - min(volts) <= 0.01 * max(volts):
        return []
    told = ", ".join(f"{name} {volt:.2f} V" for name, volt in seen)
    return [f"the devices measured different motor supplies: {told}; K and f_c differ by as much"]


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _differ(names: Sequence[str]) -> str:
    return "differs" if len(names) == 1 else "differ"


def _chance(chance: float) -> str:
    return "below 0.01 %" if chance < 1e-4 else f"{100.0 * chance:.{1 if chance < 0.1 else 0}f} %"
