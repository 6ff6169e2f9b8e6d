"""`make tune`: random motors, identified and tuned; each loop on the true motor. It resumes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from campaign_real.rows import kinds_of
from rig.config.campaign import Campaign
from shared import page
from shared.cases import spread
from shared.rows_file import RowsFile
from shared.share import counted
from tune.rows import LOOPS, STEPS, Row, rows_of

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "evidence" / "tune-table.md"
MADE_BY = (  # rows of another code start anew
    *(f"rig/{room}" for room in ("control", "design/tune", "identification", "model")),
    "tools/tune/rows.py",
    *(f"tools/campaign_real/{name}.py" for name in ("departing_motor", "kinds")),
)
PLAIN, DEPARTING = "plain", "departing"
TITLES = {PLAIN: "Plain motors", DEPARTING: "Motors with one departure each from the plain model"}
Told = dict[str, dict[tuple[int, str], Row]]


def main() -> int:
    """Run what is missing, and write the page. Exit status 1 where no motor was tuned."""
    parser = argparse.ArgumentParser(prog="make tune", description=__doc__)
    parser.add_argument("--motors", type=int, default=200, help="plain motors")
    parser.add_argument("--departing", type=int, default=50, help="motors with one departure each")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=None, help="processes at a time; default: one a core")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the table goes")
    given = parser.parse_args()
    campaign = Campaign(name="tune", experiments=max(given.motors, given.departing, 1), seed=given.seed)
    file = RowsFile(f"tune-{given.seed}", MADE_BY)
    told: Told = {PLAIN: {}, DEPARTING: {}}
    for values in file.read():
        group = values.pop("group")
        told[group][values["number"], values["loop"]] = Row(**values)
    counts = {PLAIN: given.motors, DEPARTING: given.departing}
    wanted = [
        (group, number)
        for group, count in counts.items()
        for number in range(count)
        if any((number, loop) not in told[group] for loop in LOOPS)
    ]
    # an interrupted campaign has its share of each
    wanted.sort(key=lambda one: one[1] / counts[one[0]])
    jobs = [
        (campaign, number, kinds_of(number + 1, False, given.seed) if group == DEPARTING else ())
        for group, number in wanted
    ]
    done = spread(rows_of, jobs, jobs=given.jobs)
    for n, rows in track(done, "motors", total=len(jobs), disable=not sys.stderr.isatty()):
        group = wanted[n][0]
        for one in rows:
            told[group][one.number, one.loop] = one
            file.add({**one.as_json(), "group": group})
    page.write(given.page, text(told, given.seed))
    print(given.page.read_text(encoding="utf-8"))
    return 0 if any(one.outcome == "tuned" for rows in told.values() for one in rows.values()) else 1


def text(told: Told, seed: int) -> str:
    """The page."""
    groups = []
    for group, rows in told.items():
        some = [rows[key] for key in sorted(rows)]
        if some:
            missed = [one for one in some if one.outcome == "tuned" and not one.held]
            groups.append((TITLES[group], _lines(some), [_missed(one) for one in missed]))
    return page.render(
        Path(__file__).with_name("tune-table.md.j2"), groups=groups, steps=STEPS, seed=seed, date=page.today()
    )


def _lines(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """One line for each number: position, velocity."""
    each = [[one for one in rows if one.loop == loop] for loop in LOOPS]
    tuned = [[one for one in some if one.outcome == "tuned"] for some in each]
    return [
        ("motors", *(str(len(some)) for some in each)),
        ("tuned", *(str(len(some)) for some in tuned)),
        ("keep 45 degrees and 6 dB on the true motor", *(_share([bool(one.keeps) for one in some]) for some in tuned)),
        ("overshoot inside its predicted interval", *(_share([one.held for one in some]) for some in tuned)),
        ("overshoot, median and largest", *(_of(some, "overshoot_percent", " %") for some in tuned)),
        ("end of the predicted interval, median and largest", *(_of(some, "high_percent", " %") for some in tuned)),
        ("bandwidth, median and largest", *(_of(some, "bandwidth_1_s", " rad/s") for some in tuned)),
        ("bounded by the margins", *(str(sum("degrees" in one.bound_by for one in some)) for some in tuned)),
        ("phase margin of the true motor, least", *(_least(some, "phase_deg", " degrees") for some in tuned)),
        ("gain margin of the true motor, least", *(_least(some, "gain_dB", " dB") for some in tuned)),
    ]


def _share(held: Sequence[bool]) -> str:
    """How many, and the exact 95 % interval of the share."""
    share, between = counted(held)
    return f"{share} ({between})" if held else share


def _of(rows: Sequence[Row], name: str, unit: str) -> str:
    values = _values(rows, name)
    return f"{np.median(values):.1f}, {values.max():.1f}{unit}" if values.size else "–"


def _least(rows: Sequence[Row], name: str, unit: str) -> str:
    values = _values(rows, name)
    return f"{values.min():.1f}{unit}" if values.size else "–"


def _values(rows: Sequence[Row], name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([getattr(one, name) for one in rows if getattr(one, name) is not None], dtype=np.float64)


def _missed(one: Row) -> tuple[str, ...]:
    return (
        str(one.number),
        ", ".join(one.kinds) or "none",
        one.loop,
        f"{one.overshoot_percent:.2f} %",
        f"{one.low_percent:.2f} to {one.high_percent:.2f} %",
    )


if __name__ == "__main__":
    sys.exit(main())
