"""`make campaign-real`: thousands of motors with departures. It goes on where it was interrupted."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from rich.progress import track
from scipy.stats import binom

from campaign_real.kinds import KINDS
from campaign_real.rows import Row, kinds_of, row
from campaign_real.shown import expected_gains
from campaign_real.whole_run import row_of_run
from rig.config.campaign import Campaign
from rig.config.load import load_campaign
from rig.identification.departures.choice import ASKED
from shared.cases import spread
from shared.rows_file import RowsFile, commit
from shared.share import at_most

HERE = Path(__file__).resolve().parents[2]
PAGES = {
    False: HERE / "docs" / "evidence" / "real-motors-table.md",
    True: HERE / "docs" / "evidence" / "real-motors-runs-table.md",
}
MADE_BY = (  # rows of another code start anew
    "rig/identification",
    "rig/model",
    "firmware/motor",
    *(f"rig/run_folder/recording/{name}.py" for name in ("sample_columns", "errors", "recording", "series", "stage")),
    *(f"tools/campaign_real/{name}.py" for name in ("before_the_tests", "departing_motor", "kinds", "rows", "shown")),
)
MADE_BY_RUNS = (
    *MADE_BY,
    "rig/control",
    "rig/running/experiment/stages.py",
    "rig/running/preflight",
    "tools/campaign_real/whole_run.py",
)
RECORDS = {
    False: "identified as `rig identify` does two CSV files.",
    True: "identified as `rig run` does: with the breakaway check and the gain search before them.",
}
Found = dict[bool, dict[int, Row]]  # by whether it is a pair, and by number
Shown = dict[tuple[bool, int], dict[str, float]]  # what each law could gain, by the same
WRONG = 0.05  # relative error beyond which a number called ok is wrong


def main() -> int:
    """Run what is missing, and write the table. Exit status 1 if an experiment failed."""
    parser = argparse.ArgumentParser(prog="make campaign-real", description=__doc__)
    parser.add_argument("config", type=Path)
    parser.add_argument("--motors", type=int, help="number of motors with one departure; default: experiments")
    parser.add_argument("--pairs", type=int, help="number of motors with two; default: experiments")
    parser.add_argument("--seed", type=int, help="another seed")
    parser.add_argument("--runs", action="store_true", help="with breakaway check and gain search, as rig run records")
    parser.add_argument("--kind", choices=[kind.name for kind in KINDS], help="only motors that have this departure")
    parser.add_argument("--keep", action="store_true", help="keep the rows, packed, in docs/evidence/campaigns")
    parser.add_argument("--recheck", type=int, help="use kept rows of other code, if this many come out the same")
    parser.add_argument("--page", type=Path, help="where the table goes; by default none with --kind")
    given = parser.parse_args()
    config = load_campaign(given.config)
    if given.seed is not None:
        config = config.model_copy(update={"seed": given.seed})
    motors = config.experiments if given.motors is None else given.motors
    pairs = config.experiments if given.pairs is None else given.pairs
    name = f"campaign-real-{config.seed}"
    file = RowsFile(f"{name}-runs", MADE_BY_RUNS) if given.runs else RowsFile(name, MADE_BY)
    make = row_of_run if given.runs else row
    if given.recheck and file.of_other_code:
        differing = recheck(file, config, make, given.recheck)
        if differing:
            print("the kept rows do not hold for this code; these differ:", *differing, sep="\n", file=sys.stderr)
            return 1
    began = time.time()
    found: Found = {False: {}, True: {}}
    for pair, one in map(_row, file.read()):
        found[pair][one.number] = one
    wanted = [(k, pair) for pair, count in ((False, motors), (True, pairs)) for k in range(count)]
    if given.kind is not None:
        wanted = [(k, pair) for k, pair in wanted if given.kind in [one.name for one in kinds_of(k, pair, config.seed)]]
        found = {p: {k: one for k, one in rows.items() if given.kind in one.kinds} for p, rows in found.items()}
    jobs = [(config, k, pair) for k, pair in wanted if k not in found[pair]]
    for _, one in track(spread(make, jobs), "motors", total=len(jobs), disable=not sys.stderr.isatty()):
        pair = len(one.kinds) > 1
        file.add({**one.as_json(), "pair": pair})
        found[pair][one.number] = one
    if given.keep:
        file.keep()
    those = [(pair, number) for pair, rows in found.items() for number in rows]
    shown = shown_of(config, those, RowsFile(f"campaign-real-{config.seed}-gains", MADE_BY))
    made = commit(MADE_BY_RUNS if given.runs else MADE_BY)
    options = {"RUNS": 1 if given.runs else None, "KIND": given.kind, "MOTORS": given.motors, "PAIRS": given.pairs}
    command = f"make campaign-real SEED={config.seed}" + "".join(
        f' {name}="{value}"' if isinstance(value, str) else f" {name}={value}"
        for name, value in options.items()
        if value is not None
    )
    made_by = f"`{command}`: commit {made}, " + (
        f"{time.time() - began:.0f} s for {len(jobs)} motors" if jobs else "from rows that were kept"
    )
    if given.recheck:
        made_by += f". Rows of an earlier commit count: {given.recheck} of them, at random, came out the same"
    text = page(config, found, shown, made_by, runs=given.runs, kind=given.kind)
    place = given.page or (PAGES[given.runs] if given.kind is None else None)
    if place is not None:
        place.write_text(text, encoding="utf-8")
    print(text)
    failed = [one for rows in found.values() for one in rows.values() if one.verdict == "failed"]
    for one in failed[:5]:
        print(f"number {one.number} {one.kinds}: {one.reasons}", file=sys.stderr)
    return 1 if failed else 0


def recheck(file: RowsFile, config: Campaign, make: Callable[[Campaign, int, bool], Row], count: int) -> list[Row]:
    """Make ``count`` kept rows of other code anew, at random: those that differ. If none does, all kept rows count."""
    kept = list(map(_row, file.read_other()))
    some = np.random.default_rng(config.seed).permutation(len(kept))[:count]
    jobs = [(config, kept[k][1].number, kept[k][0]) for k in some]
    done = track(spread(make, jobs), "kept rows", total=len(jobs), disable=not sys.stderr.isatty())
    differing = [one for k, one in done if not one.is_same(kept[some[k]][1])]
    if not differing:
        file.take_over()
    return differing


def _row(told: dict[str, Any]) -> tuple[bool, Row]:
    """Whether a line of the file is of a pair, and its row."""
    rest = {name: value for name, value in told.items() if name != "pair"}
    return told["pair"], Row(**rest)


def shown_of(config: Campaign, wanted: Sequence[tuple[bool, int]], file: RowsFile) -> Shown:
    """What each law of each motor could show in two relay tests: from its file, and what is missing there."""
    shown: Shown = {(told["pair"], told["number"]): told["gains"] for told in file.read()}
    missing = [one for one in wanted if one not in shown]
    jobs = [(config, number, kinds_of(number, pair, config.seed)) for pair, number in missing]
    done = spread(expected_gains, jobs, batch=10)
    for k, gains in track(done, "laws", total=len(jobs), disable=not sys.stderr.isatty()):
        pair, number = missing[k]
        shown[pair, number] = gains
        file.add({"pair": pair, "number": number, "gains": gains})
    return shown


def page(
    config: Campaign, found: Found, shown: Shown, made_by: str, *, runs: bool = False, kind: str | None = None
) -> str:
    """The table as Markdown.

    made_by  command, commit and duration
    runs     whether the motors have all the records of a run
    kind     the departure that all of them have
    """
    lines = [
        f"# Motors that are not what the plain model says{_which(config.seed, runs, kind)}",
        "",
        f"Made by {made_by}.",
        "Two relay tests of each motor (10 ms, 3 mrad of noise, 10 bits, unknown delay), simulated by a program of",
        f"its own (tools/campaign_real), {RECORDS[runs]}",
        *([f"Only motors with a {kind}."] if kind else []),
        "",
        "*wrong*: called ok, and tau, K or f_c more than 5 % off. *inside*: share of u95 that hold the truth, of those",
        "called ok, for tau, K, f_c. *named*: laws that are found, alone or in a group of at most three, of those that",
        f"should lower BIC by more than the {ASKED.entry:g} that a law needs to enter, beside the motor's other",
        "laws (tools/campaign_real/shown.py); motors with a random force are not counted there. *u95* and *errors*:",
        "medians of those called ok, in %. *seconds*: median of one identification.",
        "",
    ]
    for pair, title in ((False, "One departure"), (True, "Two departures")):
        rows = sorted(found[pair].values(), key=lambda one: one.number)
        if rows:
            lines += [f"## {title}", "", *_table(rows, shown, pair), ""]
            lines += _held(kind, rows) if kind else [*_asked(rows, shown, pair), ""]
            if pair and not kind:
                lines += ["The pairs that have a departure, whatever the other one is:", "", *_parts(rows), ""]
    return "\n".join(lines)


def _which(seed: int, runs: bool, kind: str | None) -> str:
    return f": seed {seed}" + ", whole runs" * runs + (f", {kind}" if kind else "")


def _table(rows: list[Row], shown: Shown, pair: bool) -> list[str]:
    head = ["departure", "motors", "ok", "wrong", "inside", "named", "u95", "errors", "seconds"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    names = ["two"] if pair else list(dict.fromkeys(kind for one in rows for kind in one.kinds))
    groups = [(name, [one for one in rows if pair or name in one.kinds]) for name in names]
    if not pair:
        groups.append(("all", rows))
    return lines + ["| " + " | ".join(_cells(name, some, shown)) + " |" for name, some in groups]


def _parts(rows: Sequence[Row]) -> list[str]:
    """Of each departure, the motors that have it beside another."""
    lines = ["| departure | motors | ok | wrong | inside |", "|---|---|---|---|---|"]
    for name in sorted({kind for one in rows for kind in one.kinds}):
        some = [one for one in rows if name in one.kinds]
        cells = [name, str(len(some)), str(len(called_ok(some))), str(sum(map(is_wrong, some))), _inside(some)]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _held(kind: str, rows: Sequence[Row]) -> list[str]:
    """How often u95 holds where all motors have one departure, and whether that is less than 90 %."""
    held = [inside for one in called_ok(rows) for inside in one.inside or ()]
    if not held:
        return []
    chance = float(binom.cdf(sum(held), len(held), 0.9))
    verdict = "less than 90 %" if is_narrow(kind, rows) else "90 % is not rejected at 0.001"
    return [f"u95 holds {sum(held)} of {len(held)} true values: {verdict} (p = {chance:.2g}).", ""]


def _inside(some: Sequence[Row]) -> str:
    """Share of u95 of tau, K and f_c that hold the truth, of those called ok."""
    shares = [one.inside or () for one in called_ok(some)]
    return ", ".join(f"{100 * share:.0f} %" for share in np.mean(shares, axis=0)) if shares else "-"


def _asked(rows: list[Row], shown: Shown, pair: bool) -> list[str]:
    """What is asked of the campaign, and what came of it."""
    departing = [one for one in rows if one.kinds != ("plain",)]
    ok = called_ok(departing)
    wrong = sum(map(is_wrong, rows))
    bound = at_most(wrong, len(rows))
    allowed = (4 if pair else 2) * len(rows) / 2000.0
    held = [inside for one in called_ok(rows) for inside in one.inside or ()]
    named, seen = named_of(departing, shown)
    errors = 100.0 * np.median(np.abs([one.error or () for one in ok]), axis=0) if ok else np.full(3, np.nan)
    shares = (len(ok) / max(len(departing), 1), float(np.mean(held)) if held else math.nan, named / max(seen, 1))
    fewest = 0.5 if pair else 0.75
    narrow = [name for name in dict.fromkeys(k for one in rows for k in one.kinds) if is_narrow(name, rows)]
    asked = [
        (
            f"called ok and wrong: at most {allowed:g} of {len(rows)}",
            f"{wrong}; with 95 % confidence at most {100 * bound:.2f} %",
            wrong <= allowed,
        ),
        ("u95 holds in at least 93 %, pooled", f"{100 * shares[1]:.1f} %", shares[1] >= 0.93),
        ("no kind whose u95 holds in less than 90 % (p < 0.001)", ", ".join(narrow) or "none", not narrow),
        (f"departures called ok: at least {100 * fewest:g} %", f"{100 * shares[0]:.1f} %", shares[0] >= fewest),
        ("median errors at most 1 %", ", ".join(f"{e:.2f}" for e in errors), bool(np.all(errors <= 1.0))),
        ("named: at least 90 %", f"{named} of {seen}: {100 * shares[2]:.1f} %", shares[2] >= 0.9),
    ]
    plain = [one for one in rows if one.kinds == ("plain",)]
    if plain:
        false = sum(bool(one.found) for one in plain)
        asked.append(
            ("laws found in plain motors: at most 2 %", f"{false} of {len(plain)}", false <= 0.02 * len(plain))
        )
    lines = ["| asked | measured | |", "|---|---|---|"]
    return lines + [f"| {what} | {came} | {'yes' if well else '**no**'} |" for what, came, well in asked]


def called_ok(rows: Sequence[Row]) -> list[Row]:
    """Those with the verdict ok."""
    return [one for one in rows if one.verdict == "ok" and one.error is not None and one.inside is not None]


def is_wrong(one: Row) -> bool:
    """Whether it is called ok and more than 5 % off."""
    return one.verdict == "ok" and one.error is not None and max(map(abs, one.error)) > WRONG


class Named(Protocol):
    """A row, as far as ``named_of`` looks at it."""

    @property
    def number(self) -> int:
        """Which motor."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of its kinds."""

    @property
    def found(self) -> tuple[str, ...]:
        """Names of the laws that were found."""

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Names that are not told apart."""


def named_of(rows: Sequence[Named], shown: Shown) -> tuple[int, int]:
    """How many laws are found, alone or in a group of at most three, and of how many that can be seen."""
    named = seen = 0
    for one in rows:
        if any(name.startswith("random_force") for name in one.kinds):
            continue
        small = {name for group in one.groups if len(group) <= 3 for name in group}
        laws = [law for law, gain in shown[len(one.kinds) > 1, one.number].items() if gain > ASKED.entry]
        seen += len(laws)
        named += sum(law in one.found or law in small for law in laws)
    return named, seen


def is_narrow(kind: str, rows: Sequence[Row]) -> bool:
    """Whether 90 % is rejected for the share of a kind's u95 that hold the truth, at p < 0.001."""
    held = [inside for one in called_ok(rows) if kind in one.kinds for inside in one.inside or ()]
    return bool(held) and float(binom.cdf(sum(held), len(held), 0.9)) < 0.001


def _cells(name: str, some: list[Row], shown: Shown) -> list[str]:
    ok = called_ok(some)
    errors = 100.0 * np.median(np.abs([one.error or () for one in ok]), axis=0) if ok else np.full(3, np.nan)
    u95 = 100.0 * np.median([one.u95 or () for one in ok], axis=0) if ok else np.full(3, np.nan)
    named = "{} of {}".format(*named_of(some, shown))
    if name == "plain":
        named = f"{sum(bool(one.found) for one in some)} falsely"
    return [
        name,
        str(len(some)),
        str(len(ok)),
        str(sum(map(is_wrong, some))),
        _inside(some),
        named,
        ", ".join(f"{share:.1f}" for share in u95) if ok else "-",
        ", ".join(f"{error:.2f}" for error in errors) if ok else "-",
        f"{np.median([one.seconds for one in some]):.1f}",
    ]


if __name__ == "__main__":
    sys.exit(main())
