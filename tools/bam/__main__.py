"""`make bam`: what `rig identify` says of servos with the friction that Rhoban/bam publishes, one line for each record.

RIG_SHARED_DATA names the folder with `bam`. Errors are in % of the true numbers. f_c holds without load, at the speeds
of the record: the true one is the mean of the published friction over its time in motion; where rig names a Stribeck
effect, the friction beyond that. Held out is the RMS error of 12 open-loop records of 1 s from rest, over the spread of
their positions. Then what the records with and without a load say of a volt in N m, by gravity and by inertia: mass and
arm are stated as they are, 1 % and 1 mm uncertain.

    PYTHONPATH=tools python -m bam [--only WORD] [--seed N] [--reasons]
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bam.records import KINDS, Case, Record, Truth, records_of
from bam.servo import Load
from rig.identification import identify
from rig.identification.identification import Identification
from rig.model.real_motor import FramedMotor
from rig.output.newton_metres import Load as StatedLoad
from rig.output.newton_metres import Quantity, newton_metres
from rig.run_folder.recording.recording import Recording, from_columns
from rig.run_folder.recording.series import Steps
from rig.run_folder.results import Answer
from shared.pieces import Pieces, response
from shared.table import markdown

FREE = Load()
LOADS = {"XL330": Load(0.1, 0.1), "STS3215": Load(0.3, 0.15)}
NUMBERS = ("tau_s", "K_rad_s_V", "fc_V")
MASS_SHARE, ARM_M = 0.01, 0.001  # half widths at 95 % of the stated load
HEAD = ("servo", "record", "verdict", "errors of tau, K, f_c, %", "u95, %", "held out, %", "laws", "CPU, s")
NEWTON_HEAD = ("servo", "record", "verdict", "by gravity, % off", "by inertia, % off")


def cases() -> Iterator[Case]:
    """Each servo with each published model, free and loaded, by relay and by strokes; then the slope as shipped."""
    for servo, model in (("XL330", "m1"), ("STS3215", "m1"), ("XL330", "m4"), ("XL330", "m6")):
        for load in (FREE, LOADS[servo]):
            yield from (Case(servo, model, load, record) for record in ("relay", "strokes"))
    yield from (Case("XL330", "m1", FREE, record, ramped=True) for record in ("relay", "strokes"))


class Row(NamedTuple):
    """What came of a case: verdict, errors and u95 of each number (relative), held out (relative), laws, CPU, s.

    answer  of rig; None: there is none
    a       true torque of the record's volt, N m/V
    """

    case: Case
    verdict: str
    errors: tuple[float, ...]
    u95: tuple[float, ...]
    held_out: float
    laws: tuple[str, ...]
    cpu_s: float
    answer: Answer | None
    a: float

    def cells(self) -> list[str]:
        """As the table has it."""
        errors = ", ".join(f"{100.0 * one:.2g}" for one in self.errors) or "-"
        u95 = ", ".join(f"{100.0 * one:.2g}" for one in self.u95) or "-"
        shown = f"{100.0 * self.held_out:.2g}"
        title, laws = self.case.title, ", ".join(self.laws)
        return [title, self.case.record, self.verdict, errors, u95, shown, laws, f"{self.cpu_s:.0f}"]


def recordings(case: Case, records: Sequence[Record]) -> list[Recording]:
    """As rig reads them; of a duty that is ramped, with its slope told."""
    found = [
        from_columns(Path(f"{case.record}-{k}.csv"), one.t_s, one.u_V, one.y_rad, one.t_u_s)
        for k, one in enumerate(records, 1)
    ]
    return [replace(one, slew_V_s=KINDS[case.servo].slope_V_s) for one in found] if case.ramped else found


def held_out(case: Case, motor: FramedMotor, records: Sequence[Record]) -> float:
    """RMS error over the spread of the positions, all records together; each starts at rest at 0 rad."""
    squares = spread = 0.0
    for one in records:
        drive = Steps(one.t_u_s, one.u_V)
        drive = drive.ramped(KINDS[case.servo].slope_V_s) if case.ramped else drive
        found = response(motor.motor, motor.frame, drive, one.t_s, Pieces.one(0.0, 0.0))
        squares += float(np.sum((found - one.true_rad) ** 2))
        spread += float(np.sum((one.true_rad - one.true_rad.mean()) ** 2))
    return math.sqrt(squares / spread)


def tried(case: Case, folder: Path, seed: int) -> tuple[Row, Identification]:
    """One line, and all that rig found."""
    given, unseen, friction = records_of(case, folder, seed)
    before = time.process_time()
    found = identify(recordings(case, given))
    cpu_s = time.process_time() - before
    answer, motor, truth = found.answer, found.real_motor, Truth(friction, case.load)
    volt = float(np.mean([one.volt for one in given]))  # u95 is in the record's own
    a = friction.kt / friction.R * volt
    if answer is None or motor is None:
        return Row(case, "none" if answer is None else answer.verdict, (), (), math.nan, (), cpu_s, answer, a), found
    fc_V = truth.fc_V if motor.motor.stribeck_V else truth.driven_fc_V(given)
    true = [truth.tau_s, truth.K_rad_s_V * volt, fc_V / volt]
    errors = tuple((getattr(motor.motor, name) - value) / value for name, value in zip(NUMBERS, true, strict=True))
    half = [(answer.grade or {})[name].u95 for name in NUMBERS]
    u95 = tuple((math.inf if h is None else h) / value for h, value in zip(half, true, strict=True))
    laws = tuple(f"{law.name} {law.value:.3g}" for law in answer.law or ())
    return Row(case, answer.verdict, errors, u95, held_out(case, motor, unseen), laws, cpu_s, answer, a), found


def in_newton_metres(free: Row, loaded: Row) -> list[str] | None:
    """A line of the second table, by the records without and with a load; None where one has no answer."""
    if free.answer is None or loaded.answer is None:
        return None
    load = loaded.case.load
    stated = StatedLoad(Quantity(load.mass_kg, MASS_SHARE * load.mass_kg), Quantity(load.arm_m, ARM_M))
    found = newton_metres(loaded.answer, stated, free.answer)
    off = [
        "-" if one is None else f"{100.0 * (one.value / loaded.a - 1.0):+.2g} ± {one.percent:.2g}"
        for one in (found.by_gravity, found.by_inertia)
    ]
    return [loaded.case.title, loaded.case.record, found.verdict, *off]


def newton_rows(rows: Sequence[Row]) -> list[list[str]]:
    """Of every servo that is there with and without its load by the same kind of record."""
    free = {
        (row.case.servo, row.case.model, row.case.record): row
        for row in rows
        if row.case.load == FREE and not row.case.ramped
    }
    found = []
    for row in rows:
        other = free.get((row.case.servo, row.case.model, row.case.record))
        if row.case.load != FREE and other is not None and (line := in_newton_metres(other, row)) is not None:
            found.append(line)
    return found


def summary(rows: Sequence[Row]) -> list[str]:
    """The figures that are asked for."""
    said = []
    for model, loaded in (("m1", None), ("m4", False), ("m4", True), ("m6", False), ("m6", True)):
        some = [
            one
            for one in rows
            if one.case.model == model
            and not one.case.ramped
            and (loaded is None or (one.case.load.mass_kg > 0.0) is loaded)
        ]
        if some:
            what = model.upper() + ("" if loaded is None else " loaded" if loaded else " free")
            ok = sum(one.verdict == "ok" for one in some)
            off = max((abs(e) for one in some for e in one.errors), default=math.nan)
            shown = ", ".join(f"{100.0 * one.held_out:.2g}" for one in some)
            said.append(f"{what}: {ok} of {len(some)} ok, at most {100.0 * off:.2g} % off; held out {shown} %")
    wrong = ("cogging", "linearity", "force_over_position")
    free = [one for one in rows if one.case.load.mass_kg == 0.0]
    false = sum(any(law.startswith(wrong) for law in one.laws) for one in free)
    said.append(f"cogging, linearity or force over position on a free servo: {false} of {len(free)}")
    inside = {"M1": held(row for row in rows if row.case.model == "m1"), "all": held(rows)}
    said += [f"u95 holds the truth of {what} in {sum(one)} of {len(one)}" for what, one in inside.items()]
    return said


def held(rows: Iterable[Row]) -> list[bool]:
    """Of each number that has an interval, whether that holds the truth."""
    given = (zip(row.errors, row.u95, strict=True) for row in rows if row.verdict != "refused")
    return [abs(e) <= u for row in given for e, u in row]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table. Exit status 2 without the data."""
    parser = argparse.ArgumentParser(prog="make bam", description=__doc__)
    parser.add_argument("--only", default="")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--reasons", action="store_true")
    given = parser.parse_args(argv)
    folder = Path(os.environ.get("RIG_SHARED_DATA", "")) / "bam"
    if not os.environ.get("RIG_SHARED_DATA") or not folder.is_dir():
        print("RIG_SHARED_DATA must name the folder with bam", file=sys.stderr)
        return 2
    rows: list[Row] = []
    for case in cases():
        if given.only not in f"{case.title}, {case.record}":
            continue
        row, found = tried(case, folder, given.seed)
        rows.append(row)
        print(" | ".join(row.cells()), flush=True)
        for reason in found.answer.reasons if given.reasons and found.answer is not None else ():
            print("     -", reason, flush=True)
    print("\n" + markdown(HEAD, [row.cells() for row in rows]))
    print("\n".join(summary(rows)))
    print("\n" + markdown(NEWTON_HEAD, newton_rows(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
