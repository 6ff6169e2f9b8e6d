"""`make stopping`: random motors from rest, until rig says that it knows them. It goes on where it was interrupted."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from rich.progress import track

from campaign_real.__main__ import Shown, named_of, shown_of
from campaign_real.kinds import KINDS
from campaign_real.rows import kinds_of
from rig.config.campaign import Campaign
from rig.identification.departures.choice import ASKED
from shared.cases import spread
from shared.rows_file import RowsFile, commit
from shared.share import at_most, bounds
from stopping.rows import OF, Asked, Row, row

HERE = Path(__file__).resolve().parents[2]
PAGE = HERE / "docs" / "evidence" / "stopping-table.md"
MADE_BY = (  # rows of another code start anew
    *(f"rig/{room}" for room in ("control", "design", "identification", "model", "running")),
    "tools/stopping/rows.py",
    "tools/stopping/in_memory.py",
    "tools/stopping/shown.py",
    *(f"tools/campaign_real/{name}.py" for name in ("departing_bench", "departing_motor", "kinds")),
)
GAINS_BY = (  # what a law could show needs no run
    *(f"rig/{room}" for room in ("identification", "model")),
    *(f"tools/campaign_real/{name}.py" for name in ("departing_motor", "kinds", "shown")),
)
WRONG = 0.05  # relative error beyond which a number called ok is wrong
SEED, PERCENT = 3, 1.0
PLAIN, KNOWN, AFTERWARDS, DEPARTING = "plain", "known", "afterwards", "departing"
TITLES = {
    PLAIN: "From rest, nothing known",
    KNOWN: "From a model that is known to 30 %",
    AFTERWARDS: "From rest, nothing known, identified afterwards",
    DEPARTING: "With one departure from the plain model each, identified afterwards",
}
TITLE = "# How soon an experiment knows its motor"
DEPARTING_TITLE = "# How soon an experiment knows a motor that departs from the plain model"
SEEN = (
    "*named*: laws that are found, alone or in a group of at most three, of those that the run's own tests can show:",
    f"having the law should lower BIC by more than the {ASKED.entry:g} that it needs to enter. A run that ends soon",
    "shows less than the two relay tests of `make campaign-real`; what these can show is counted, too. Motors with a",
    "random force are not counted there.",
)
Told = dict[str, dict[int, Row]]


def main() -> int:
    """Run what is missing, and write the page. Exit status 1 if one failed, or if an answer is worse afterwards."""
    parser = argparse.ArgumentParser(prog="make stopping", description=__doc__)
    parser.add_argument("--motors", type=int, default=500, help="plain motors from rest, nothing known")
    parser.add_argument("--known", type=int, default=100, help="plain motors that are known to 30 %%")
    parser.add_argument("--afterwards", type=int, default=0, help="plain motors that are identified afterwards, too")
    parser.add_argument("--departing", type=int, default=0, help="motors with one departure each")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--percent", type=float, default=PERCENT, help="wanted half width of the 95 %% intervals")
    parser.add_argument("--keep", action="store_true", help="keep the rows, packed, in docs/evidence/campaigns")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the table goes")
    given = parser.parse_args()
    campaign = Campaign(
        name="stopping",
        experiments=max(given.motors, given.known, given.afterwards, given.departing, 1),
        seed=given.seed,
    )
    file = RowsFile(f"stopping-{given.seed}-{given.percent:g}", MADE_BY)
    told: Told = {PLAIN: {}, KNOWN: {}, AFTERWARDS: {}, DEPARTING: {}}
    for values in file.read():
        group = values.pop("group")
        told[group][values["number"]] = Row(**values)
    began = time.time()
    plans = {
        PLAIN: (given.motors, Asked(given.percent)),
        KNOWN: (given.known, Asked(given.percent, known=True)),
        AFTERWARDS: (given.afterwards, Asked(given.percent, identified=True)),
        DEPARTING: (given.departing, Asked(given.percent, identified=True)),
    }
    wanted = [(group, k) for group, (count, _) in plans.items() for k in range(count) if k not in told[group]]
    jobs = [
        (campaign, k, kinds_of(k, False, given.seed) if group == DEPARTING else (), plans[group][1])
        for group, k in wanted
    ]
    for n, one in track(spread(row, jobs), "motors", total=len(jobs), disable=not sys.stderr.isatty()):
        group = wanted[n][0]
        told[group][one.number] = one
        file.add({**one.as_json(), "group": group})
    if given.keep:
        file.keep()
    counts = {
        "MOTORS": (given.motors, 500),
        "KNOWN": (given.known, 100),
        "AFTERWARDS": (given.afterwards, 0),
        "DEPARTING": (given.departing, 0),
    }
    options = [f" {name}={count}" for name, (count, usual) in counts.items() if count != usual]
    options += [f" SEED={given.seed}"] if given.seed != SEED else []
    options += [f" PERCENT={given.percent:g}"] if given.percent != PERCENT else []
    made = f"seed {given.seed}, commit {commit(MADE_BY)}, {time.time() - began:.0f} s"
    departing = [(False, number) for number in told[DEPARTING]]
    shown = shown_of(campaign, departing, RowsFile(f"stopping-{given.seed}-gains", GAINS_BY)) if departing else {}
    text = page(told, given.percent, "make stopping" + "".join(options), made, len(jobs), shown)
    given.page.write_text(text, encoding="utf-8")
    print(text)
    return int(any(one.is_worse for one in told[AFTERWARDS].values()))


def page(told: Told, percent: float, command: str, made: str, new: int, shown: Shown | None = None) -> str:
    """The page as Markdown; ``shown``: what each law of the departing motors could show."""
    title = TITLE if told[PLAIN] or told[KNOWN] else f"{TITLE}, identified afterwards"
    lines = [
        title if any(told[group] for group in (PLAIN, KNOWN, AFTERWARDS)) else DEPARTING_TITLE,
        "",
        f"Made by `{command}`: {made} for {new} motors.",
        "Motors of the campaign's grid (10 ms, 3 mrad of noise, 10 bits; within ±0.55 rad, 4.9 rad/s and 3 V),",
        "simulated by a program of its own behind rig's loop and guard, in virtual time, with `relay.until`:",
        f"tests until tau, K and f_c are known to {percent:g} % each (half width of the 95 % interval).",
        "",
        "*tests*: from the first sample of the search to the stop. *run*: from the run's start, with the check.",
        *(SEEN if shown else ()),
        "",
    ]
    for group, rows in told.items():
        if rows:
            some = [rows[k] for k in sorted(rows)]
            lines += [f"## {TITLES[group]}", "", *_table(some, percent, shown or {}), ""]
            if group == DEPARTING:
                lines += [*_kinds(some), ""]
    return "\n".join(lines)


def _time(time_s: float) -> str:
    return f"{time_s:.1f} s" if np.isfinite(time_s) else "never known"


def _table(rows: Sequence[Row], percent: float, shown: Shown) -> list[str]:
    known = [one for one in rows if one.known]
    ended = [one for one in rows if not one.known]
    lines = ["| | |", "|---|---|", f"| motors | {len(rows)} |", f"| stopped because known | {len(known)} |"]
    if known:
        for name in ("tests_s", "run_s"):
            # a motor that was never known counts as the slowest
            times = np.array([getattr(one, name) for one in known] + [np.inf] * len(ended), dtype=float)
            half, most = np.quantile(times, [0.5, 0.9], method="inverted_cdf")
            lines.append(f"| {name.removesuffix('_s')}, median and 90 % of all motors | {_time(half)}, {_time(most)} |")
        held = np.array([one.inside for one in known])
        errors = 100.0 * np.median(np.abs([one.error or () for one in known]), axis=0)
        largest = 100.0 * np.max(np.abs([one.error or () for one in known]), axis=0)
        of = ", ".join(name.split("_")[0].replace("fc", "f_c") for name in OF)
        low, high = bounds(int(held.sum()), held.size)
        lines += [
            f"| intervals at the stop that hold the truth: {of} | {_percents(np.mean(held, axis=0))} |",
            f"| pooled | {100 * held.mean():.2f} % (if independent, 95 %: {100 * low:.1f} to {100 * high:.1f} %) |",
            f"| errors at the stop, median | {_numbers(errors)} % |",
            f"| errors at the stop, largest | {_numbers(largest)} % |",
        ]
    judged = [one for one in rows if one.verdict is not None]
    if judged:
        ok = [one for one in judged if one.verdict == "ok"]
        wrong = [one for one in ok if max(map(abs, one.final_error or (0.0,))) > WRONG]
        bound = at_most(len(wrong), len(rows))
        lines.append(f"| identified afterwards: called ok | {len(ok)} of {len(judged)} |")
        lines.append(f"| of these more than 5 % off | {len(wrong)}; with 95 % confidence at most {100 * bound:.2f} % |")
        worse = sum(one.is_worse for one in rows)
        told = any(one.scatter is not None for one in judged)  # rows of before do not say
        lines += [f"| known at the stop, and refused or known worse afterwards | {worse} |"] if told else []
        departing = [one for one in rows if one.kinds not in ((), (PLAIN,))]  # a run that failed was not called ok
        if departing:
            share = sum(one.verdict == "ok" for one in departing) / len(departing)
            lines.append(f"| departures called ok | {100 * share:.1f} % of {len(departing)} |")
        if ok:
            lines.append(f"| u95 that hold the truth | {100 * np.mean([one.final_inside for one in ok]):.1f} % |")
        for what, gains in (("the run's tests", _own(departing)), ("two relay tests", shown)):
            named, seen = named_of(departing, gains) if gains else (0, 0)
            if seen:
                share = 100 * named / seen
                lines.append(f"| laws named, of those that {what} can show | {named} of {seen}: {share:.1f} % |")
    beyond = [one for one in rows if one.beyond_rad > 0.0]
    lines.append(f"| motors whose shaft left the soft limits | {len(beyond)}{_most(beyond)} |")
    lines.append(f"| motors whose guard braked | {sum(one.braked > 0 for one in rows)} |")
    faults = sorted({one.fault or "by its bounds" for one in ended})
    for fault in faults:
        count = sum((one.fault or "by its bounds") == fault for one in ended)
        lines.append(f"| ended otherwise: {fault} | {count} |")
    lines.append(f"| seconds of computing for a motor, median | {np.median([one.seconds for one in rows]):.1f} |")
    return lines


def _own(rows: Sequence[Row]) -> Shown:
    """For each motor what its one law should gain in its own run."""
    laws = {kind.name: kind.law for kind in KINDS}
    return {
        (False, one.number): {} if one.gain is None else {laws[one.kinds[0]]: one.gain} for one in rows if one.kinds
    }


def _most(rows: Sequence[Row]) -> str:
    return f", by at most {1e3 * max(one.beyond_rad for one in rows):.0f} mrad" if rows else ""


def _kinds(rows: Sequence[Row]) -> list[str]:
    lines = ["| departure | motors | known | ok | wrong | named | tests, median |", "|---|---|---|---|---|---|---|"]
    for kind in KINDS:
        some = [one for one in rows if one.kinds == (kind.name,)]
        if not some:
            continue
        ok = [one for one in some if one.verdict == "ok"]
        wrong = sum(max(map(abs, one.final_error or (0.0,))) > WRONG for one in ok)
        tests = [one.tests_s for one in some if one.tests_s is not None]
        named = "{} of {}".format(*named_of(some, _own(some)))
        median = f"{np.median(tests):.1f} s" if tests else "-"
        lines.append(
            f"| {kind.name} | {len(some)} | {sum(one.known for one in some)} | {len(ok)} | {wrong} | {named} "
            f"| {median} |"
        )
    return lines


def _percents(shares: Iterable[float]) -> str:
    return ", ".join(f"{100 * share:.1f} %" for share in shares)


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
