"""Motors outside rig's catalogue of laws, recorded as people record them: do the intervals hold, and does it predict?

Each motor has one or two of these: friction or a force over the angle with any period; a soft coupling; friction and
gain that change with a time constant of their own as it warms up; friction that grows with the load; a supply with a
resistance; a slow random load. Each is recorded twice, on two days: gain and friction differ by some 2 %. The drives
are those of real logs: a position loop on steps or on a sine, open steps both ways, random levels. Sensors are a
potentiometer, an encoder, or one with coarse steps.

It shares no code with ``rig.model``; its loop is in C, in ``outside.c``, compiled where it has changed. The measure is
not the name of a law: numbers within u95, ok beyond 5 %, motion that was not seen, records of one motor beside each
other.

    PYTHONPATH=tools python -m campaign_real.outside [--motors 100] [--seed 31] [--rows FILE] [--page]
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track

from campaign_real.departing_motor import row_of
from real_records.siblings import next_record
from rig.identification import IdentifyError, identify
from rig.identification.departures.budget import Entry
from rig.model.library_build import compiled
from rig.run_folder.recording.recording import Recording, from_columns
from shared.cases import spread
from shared.page import render, today, write
from shared.share import counted
from shared.table import markdown

Array = NDArray[np.float64]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "evidence" / "outside.md"
NUMBERS = ("tau_s", "K_rad_s_V", "fc_V")
DRIVES = ("loop on steps", "loop on a sine", "steps both ways", "random levels")
KINDS = ("friction", "force", "coupling", "warming", "load friction", "supply", "random load")
SENSORS = ("potentiometer", "encoder", "coarse")
DAYS = 0.025  # standard deviation of gain and friction between days
STEP_S = 5e-5
SOURCE = Path(__file__).with_suffix(".c")
WRONG = 0.05  # an ok answer that is farther off is wrong
NEXT = 1.05


def _loaded() -> ctypes.CDLL:
    loaded = ctypes.CDLL(str(compiled([SOURCE], SOURCE.parents[2] / "build" / "campaign_real_outside")))
    numbers = ctypes.c_void_p
    loaded.outside_record.argtypes = [numbers] * 6 + [ctypes.c_int64, numbers]
    loaded.outside_record.restype = ctypes.c_double
    return loaded


_LIBRARY = _loaded()


@dataclass(frozen=True)
class Outside:
    """What a motor has; all zero: a plain one. Voltages in V, angles in rad, times in s.

    share, share_per_rad, share_phase    friction over the angle, relative
    force_V, force_per_rad, force_phase  force over the angle
    mass, spring_per_s, damping          share of the load beyond a coupling; its frequency, rad/s; its damping ratio
    warm, warm_s                         share that friction loses, half of it that gain does, and in what time
    by_load                              friction per force over the angle
    supply                               share of the drive that the supply loses at a stalled motor, at full drive
    random_V                             of a load with half a second's memory
    """

    share: float = 0.0
    share_per_rad: float = 1.0
    share_phase: float = 0.0
    force_V: float = 0.0
    force_per_rad: float = 1.0
    force_phase: float = 0.0
    mass: float = 0.0
    spring_per_s: float = 100.0
    damping: float = 0.1
    warm: float = 0.0
    warm_s: float = 1.0
    by_load: float = 0.0
    supply: float = 0.0
    random_V: float = 0.0


@dataclass(frozen=True)
class Bench:
    """A motor and how it is recorded."""

    tau_s: float
    K_rad_s_V: float
    fc_V: float
    bias_V: float
    largest_V: float
    period_s: float
    duration_s: float
    noise_rad: float
    step_rad: float
    outside: Outside


@dataclass(frozen=True)
class Seen:
    """One record: its truth, and what rig says of it."""

    drive: str
    verdict: str
    error: tuple[float, ...]
    inside: tuple[bool, ...]
    u95: tuple[float, ...]
    ci95: tuple[float, ...]
    grades: tuple[str, ...]
    predicts: tuple[float, float]
    laws: tuple[str, ...]
    cpu_s: float
    said: str = ""
    budget: tuple[tuple[str, float, float, float], ...] = ()


@dataclass(frozen=True)
class Row:
    """One motor, recorded twice; agree: of usable numbers of both; next: errors of rig and of a linear model."""

    number: int
    kinds: tuple[str, ...]
    sensor: str
    records: tuple[Seen, ...]
    agree: tuple[bool, ...]
    following: tuple[float, float] | None


def bench_of(rng: np.random.Generator, kinds: Sequence[str], sensor: str) -> Bench:
    """A random bench with these kinds."""
    tau_s = math.exp(rng.uniform(math.log(0.04), math.log(0.4)))
    largest_V = float(rng.choice([5.0, 7.4, 12.0]))
    fc_V = largest_V * rng.uniform(0.03, 0.15)
    phase = 2.0 * math.pi * rng.random(3)
    made = Outside()
    for kind in kinds:
        if kind == "friction":
            made = replace(made, share=rng.uniform(0.1, 0.3), share_per_rad=rng.uniform(0.3, 5.0), share_phase=phase[0])
        elif kind in ("force", "load friction"):
            force_V = largest_V * rng.uniform(0.02, 0.15)
            per_rad = rng.uniform(0.3, 3.0) if kind == "force" else 1.0
            made = replace(made, force_V=force_V, force_per_rad=per_rad, force_phase=phase[1])
            if kind == "load friction":
                made = replace(made, by_load=rng.uniform(0.1, 0.3))
        elif kind == "coupling":
            made = replace(made, mass=0.5, spring_per_s=2.0 * math.pi * rng.uniform(6.0, 20.0), damping=0.1)
        elif kind == "warming":
            made = replace(made, warm=rng.uniform(0.05, 0.2), warm_s=rng.uniform(0.15, 0.6))
        elif kind == "supply":
            made = replace(made, supply=rng.uniform(0.03, 0.15))
        else:
            made = replace(made, random_V=fc_V * rng.uniform(0.05, 0.2))
    duration_s = float(rng.uniform(40.0, 120.0)) * max(tau_s, 0.08)
    noise_rad, step_rad = {"potentiometer": (0.003, 0.004), "encoder": (0.0, 0.0), "coarse": (0.0, 0.0)}[sensor]
    if sensor != "potentiometer":
        step_rad = 2.0 * math.pi / float(rng.choice([1440.0, 4096.0] if sensor == "encoder" else [100.0, 200.0]))
    return Bench(
        tau_s,
        math.exp(rng.uniform(math.log(1.0), math.log(30.0))),
        fc_V,
        fc_V * rng.uniform(-0.2, 0.2),
        largest_V,
        float(rng.choice([0.002, 0.005, 0.01, 0.02])) if tau_s > 0.1 else float(rng.choice([0.002, 0.005])),
        min(duration_s, 40.0),
        noise_rad,
        step_rad,
        replace(made, warm_s=made.warm_s * min(duration_s, 40.0)),
    )


def recorded(bench: Bench, drive: str, rng: np.random.Generator, name: str) -> tuple[Recording, tuple[float, ...]]:
    """One record, and what is true of tau, K and the friction in it.

    As ``rig`` defines f_c, it is the mean over the travel of what goes over the angle, and over time of all else.
    """
    rows = round(bench.duration_s / bench.period_s)
    number = DRIVES.index(drive)
    levels = np.ascontiguousarray(_levels(bench, drive, rng, rows), dtype=np.float64)
    force = np.zeros(rows)
    keep = math.exp(-bench.period_s / 0.5)
    for k in range(1, rows):
        force[k] = keep * force[k - 1] + math.sqrt(1.0 - keep * keep) * rng.standard_normal()
    goal_rad = 0.5 * bench.K_rad_s_V * bench.largest_V * bench.tau_s
    gain = rng.uniform(1.0, 4.0) * bench.largest_V / max(goal_rad, 1e-6) / 2.0
    out = np.empty((rows, 3))
    pushed_V = bench.outside.random_V * force
    flat_V = _LIBRARY.outside_record(
        row_of(bench.tau_s, bench.K_rad_s_V, bench.fc_V, bench.bias_V, bench.largest_V),
        row_of(*asdict(bench.outside).values()),
        row_of(bench.period_s, 0.3 * bench.period_s, STEP_S),
        row_of(float(number < 2), gain, goal_rad),
        levels.ctypes.data,
        pushed_V.ctypes.data,
        rows,
        out.ctypes.data,
    )
    y_rad = out[:, 1] + bench.noise_rad * rng.standard_normal(rows)
    if bench.step_rad > 0.0:
        y_rad = bench.step_rad * np.floor(y_rad / bench.step_rad + 0.5)
    gain_mean = 1.0 - 0.5 * bench.outside.warm * _mean_warm(bench)
    level_V = bench.fc_V * (1.0 - bench.outside.warm * _mean_warm(bench))
    truth = (bench.tau_s * gain_mean, bench.K_rad_s_V * gain_mean, flat_V + level_V * _mean_wave(bench, out[:, 1]))
    return replace(from_columns(Path(name), out[:, 0], out[:, 2], y_rad), units_stated=True), truth


def _mean_wave(bench: Bench, y_rad: Array) -> float:
    """Mean over the travel of what friction goes up and down by over the angle, relative."""
    made, ends = bench.outside, np.array([y_rad.min(), y_rad.max()])
    cosines = np.cos(made.share_per_rad * ends + made.share_phase)
    return made.share * float(cosines[0] - cosines[1]) / (made.share_per_rad * max(float(np.ptp(ends)), 1e-12))


def _mean_warm(bench: Bench) -> float:
    """Mean of 1 - exp(-t / T) over the record."""
    share = bench.outside.warm_s / bench.duration_s
    return 1.0 - share * -math.expm1(-1.0 / share)


def _levels(bench: Bench, drive: str, rng: np.random.Generator, rows: int) -> Array:
    """Of each row: the goal of a loop relative to its size, or the drive, V."""
    t_s = bench.period_s * np.arange(rows)
    if drive == "loop on a sine":
        return np.asarray(np.sin(2.0 * math.pi * t_s / (bench.tau_s * rng.uniform(10.0, 30.0))))
    hold_s = bench.tau_s * (rng.uniform(4.0, 10.0) if drive != "random levels" else rng.uniform(1.0, 4.0))
    number = (t_s / hold_s).astype(int)
    count = int(number[-1]) + 1
    if drive == "loop on steps":
        found = np.where(np.arange(count) % 2 == 0, 1.0, -1.0) * rng.uniform(0.4, 1.0, count)
    elif drive == "steps both ways":
        sizes = bench.largest_V * rng.choice([0.4, 0.6, 0.8, 1.0], count)
        found = sizes * np.array([1.0, 0.0, -1.0, 0.0])[np.arange(count) % 4]
    else:
        found = bench.largest_V * rng.uniform(-1.0, 1.0, count)
    return np.asarray(found[number], dtype=np.float64)


def row(seed: int, number: int) -> Row:
    """Motor ``number``, recorded twice and identified."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, 5)))
    first = KINDS[number % len(KINDS)]
    others = [kind for kind in KINDS if kind != first]
    kinds = (first,) if number % 2 == 0 else (first, str(rng.choice(others)))
    sensor = SENSORS[number // len(KINDS) % len(SENSORS)]
    bench = bench_of(rng, kinds, sensor)
    seen, found = [], []
    for day in range(2):
        change = 1.0 + DAYS * rng.standard_normal(2)
        today = replace(bench, K_rad_s_V=bench.K_rad_s_V * change[0], fc_V=bench.fc_V * change[1])
        drive = str(rng.choice(DRIVES))
        recording, truth = recorded(today, drive, rng, f"motor-{number}-{day}.csv")
        one, what = _identified(recording, truth, drive)
        seen.append(one)
        found.append(what)
    agree = []
    for k in range(3):
        if all(one.grades and one.grades[k] != "not known" for one in seen):
            numbers = [((1.0 + one.error[k]), one.u95[k] * (1.0 + one.error[k])) for one in seen]
            agree.append(abs(numbers[0][0] - numbers[1][0]) <= math.hypot(numbers[0][1], numbers[1][1]))
    following = None
    if all(one is not None for one in found):
        after = next_record(found[0], found[1], ("first", "second"))
        following = None if after is None else (after.rig, after.linear)
    return Row(number, kinds, sensor, tuple(seen), tuple(agree), following)


def _identified(recording: Recording, truth: tuple[float, ...], drive: str) -> tuple[Seen, Any]:
    before = time.process_time()
    try:
        found = identify([recording])
    except IdentifyError as error:
        return Seen(drive, "none", (), (), (), (), (), (1.0, 1.0), (), time.process_time() - before, str(error)), None
    took = time.process_time() - before
    answer, law = found.answer, found.motor_law
    if answer is None or law is None or not answer.grade:
        said = "" if answer is None else " | ".join(answer.reasons)
        return Seen(drive, "none", (), (), (), (), (), (1.0, 1.0), (), took, said), None
    value = np.array([answer.value(name) for name in NUMBERS], dtype=float)
    u95 = np.array([law.budget.u95[name] for name in NUMBERS])
    bounds = [answer.interval(name) for name in NUMBERS]
    scatter = [math.inf if b is None else 0.5 * (b[1] - b[0]) for b in bounds]
    true = np.array(truth)
    grades = tuple((answer.grade.get(name) or answer.grade["fc_V"]).grade for name in NUMBERS)
    told = answer.predicts
    predicts = (1.0, 1.0) if told is None else (float(told.error or 0.0), float(told.linear_error or 0.0))
    return (
        Seen(
            drive,
            answer.verdict,
            tuple((value / true - 1.0).tolist()),
            tuple(bool(x) for x in np.abs(value - true) <= u95),
            tuple((u95 / np.maximum(np.abs(value), 1e-12)).tolist()),
            tuple((np.array(scatter) / np.maximum(np.abs(value), 1e-12)).tolist()),
            grades,
            predicts,
            tuple(one.law.name for one in law.found),
            took,
            " | ".join(answer.reasons),
            tuple((e.source, *_shares(e, value)) for e in law.budget.entries if not e.absolute),
        ),
        found,
    )


def _shares(entry: Entry, value: Array) -> tuple[float, float, float]:
    size = np.maximum(np.abs(value), 1e-12).tolist()
    return entry.tau_s / size[0], entry.K_rad_s_V / size[1], entry.fc_V / size[2]


def figures(rows: Sequence[Row]) -> list[tuple[str, str, str]]:
    """What is counted, how much, and the 95 % interval of the share."""
    seen = [one for row in rows for one in row.records]
    some = [one for one in seen if one.grades]
    usable = [(one.inside[k], abs(one.error[k])) for one in some for k in range(3) if one.grades[k] != "not known"]
    pairs = [row.following for row in rows if row.following is not None]
    return [
        ("answers", *counted([bool(one.grades) for one in seen])),
        ("refused", *counted([one.verdict == "refused" for one in some])),
        ("numbers that u95 holds, of all", *counted([held for one in some for held in one.inside])),
        ("numbers that u95 holds, of those given", *counted([held for held, _ in usable])),
        *(
            (f"given: {name}", *counted([one.grades[k] != "not known" for one in some]))
            for k, name in enumerate(NUMBERS)
        ),
        (
            "given where the scatter of the fit is below 10 %",
            *counted([one.grades[k] != "not known" for one in some for k in range(3) if one.ci95[k] < 0.1]),
        ),
        ("ok", *counted([one.verdict == "ok" for one in some])),
        (
            "ok, and more than 5 % off",
            *counted([max(map(abs, one.error)) > WRONG for one in some if one.verdict == "ok"]),
        ),
        ("given numbers of both days that agree", *counted([held for row in rows for held in row.agree])),
        (
            "held-out error at most 1.05 x the linear model's",
            *counted([o.predicts[0] <= NEXT * o.predicts[1] for o in some]),
        ),
        ("the next record at most 1.05 x the linear model's", *counted([a <= NEXT * b for a, b in pairs])),
        ("within 12 s of CPU", *counted([one.cpu_s <= 12.0 for one in seen])),
    ]


def by_kind(rows: Sequence[Row]) -> list[tuple[str, int, str]]:
    """For each kind that stands first: how many numbers were given, and how many of them u95 holds."""
    found = []
    for kind in KINDS:
        seen = [one for row in rows if row.kinds[0] == kind for one in row.records if one.grades]
        held = [one.inside[k] for one in seen for k in range(3) if one.grades[k] != "not known"]
        found.append((kind, len(held), counted(held)[0]))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motors", type=int, default=100)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="keep the rows here, one JSON object a line")
    parser.add_argument("--page", action="store_true", help="write docs/evidence/outside.md")
    given = parser.parse_args(argv)
    jobs = [(given.seed, number) for number in range(given.motors)]
    rows = []
    from campaign_real import outside  # what is of __main__ is sent to a process as a copy, and a C library cannot be

    for _, one in track(spread(outside.row, jobs, jobs=given.jobs), total=len(jobs), disable=not sys.stderr.isatty()):
        rows.append(one)
        if given.rows is not None:
            with given.rows.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(one)) + "\n")
    print(markdown(("of motors outside the catalogue", "share", "95 %"), figures(rows)))
    if given.page:
        template = Path(__file__).with_name("outside.md.j2")
        told = {"motors": given.motors, "seed": given.seed, "made": today()}
        write(PAGE, render(template, rows=figures(rows), kinds=by_kind(rows), **told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
