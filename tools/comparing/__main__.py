"""`make compare`: `rig compare` on thousands of simulated runs. It goes on where it was interrupted."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track
from scipy.stats import kstest

from comparing.rows import CYCLES, DRIFT, DRIFTED, GAINS, LAWS, RUNS, SAME, WANTED_FC, Row, judged, row
from rig.config.campaign import Campaign
from rig.output.compare.comparison import LEVEL, WORDS
from shared.cases import spread
from shared.page import render, today, write
from shared.rows_file import RowsFile, commit
from shared.share import counted

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "evidence" / "compare-table.md"
TEMPLATE = Path(__file__).with_name("page.md.j2")
MADE_BY = ("rig/identification", "rig/model", "firmware/motor", "rig/control/simulation.py", "tools/comparing/rows.py")


def main() -> int:
    """Run what is missing, and write the page."""
    parser = argparse.ArgumentParser(prog="make compare", description=__doc__)
    parser.add_argument("--same", type=int, default=1000, help="motors that stay as they are: two pairs of runs each")
    parser.add_argument("--drifted", type=int, default=200, help="motors whose f_c drifts by 2 %%: one pair each")
    parser.add_argument("--laws", type=int, default=100, help="motors whose laws are looked for, too: one pair each")
    parser.add_argument("--seed", type=int, default=17)
    parser.add_argument("--jobs", type=int, default=None, help="processes at a time; default: one a core")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the table goes")
    given = parser.parse_args()
    counts = {SAME: given.same, DRIFTED: given.drifted, LAWS: given.laws}
    campaign = Campaign(name="compare", experiments=max(*counts.values(), 1), seed=given.seed)
    file = RowsFile(f"compare-{given.seed}", MADE_BY)
    told = {(values["group"], values["number"]): Row(**values) for values in file.read()}
    jobs = [(campaign, g, k) for g, count in counts.items() for k in range(count) if (g, k) not in told]
    done = spread(row, jobs, jobs=given.jobs, batch=4)
    for _, one in track(done, "motors", total=len(jobs), disable=not sys.stderr.isatty()):
        told[one.group, one.number] = one
        file.add(asdict(one))
    rows = {g: [told[g, k] for k in range(count) if (g, k) in told] for g, count in counts.items()}
    text = page(rows, commit(MADE_BY), given.seed)
    write(given.page, text)
    print(text)
    return 0


def page(rows: dict[str, list[Row]], made_at: str, seed: int) -> str:
    """The page as Markdown."""
    there = {group: [judged(one) for one in some if not one.lost] for group, some in rows.items()}
    same, drifted, laws = (there[group] for group in (SAME, DRIFTED, LAWS))
    pairs = [chance for one in same for chance in one.chances]
    lines = [_share("pairs of runs of one motor called different: false alarms", np.array(pairs) < LEVEL)]
    if pairs:
        lines.append(
            (
                "chances of these pairs: uniform? Kolmogorov and Smirnov",
                f"p = {kstest(pairs, 'uniform').pvalue:.2f}",
                "",
            )
        )
    lines += [
        _share(f"sets of {RUNS[SAME]} runs of one motor called different", [not one.agree for one in same]),
        _share("such sets in which a run is named odd", [one.odd > 0 for one in same]),
        _share("intervals of a trend that hold 0, which is true", [held for one in same for held in one.held]),
        _share(
            f"pairs called different after f_c has drifted by {100 * (DRIFT - 1):.0f} %",
            [c < LEVEL for one in drifted for c in one.chances],
        ),
        _share("such pairs in which the interval of f_c's difference leaves 0 out", [one.fc_shows for one in drifted]),
        _share(
            "pairs of one motor, with laws looked for, called different",
            [c < LEVEL for one in laws for c in one.chances],
        ),
    ]
    spreads = []
    for group, some in there.items():
        if some and group != DRIFTED:
            off = np.array([pair for one in some for pair in one.off])
            each, error = np.std(off, axis=0), 1 / np.sqrt(2 * len(off))
            chance = "yes" if np.all(np.abs(each - 1.0) < 2.0 * error) else "no"
            spreads.append((group, *(f"{s:.3f}" for s in each), f"{error:.3f}", chance))
    return render(
        TEMPLATE,
        date=today(),
        commit=made_at,
        seed=seed,
        lines=[line for line in lines if line],
        spreads=spreads,
        names=list(WORDS.values()),
        lost={group: len(some) - len(there[group]) for group, some in rows.items()},
        motors={group: len(some) for group, some in rows.items()},
        cycles=CYCLES,
        gains=GAINS,
        wanted=100 * WANTED_FC,
        fc_half=[f"{100 * h:.2f}" for h in np.quantile([one.fc_half for one in drifted], (0.05, 0.5, 0.95))]
        if drifted
        else None,
    )


def _share(what: str, found: Sequence[bool] | np.ndarray[Any, Any]) -> tuple[str, str, str] | None:
    """How often, and between which bounds that is with 95 % (Clopper and Pearson)."""
    share, between = counted(found)
    return (what, share, between) if between else None


if __name__ == "__main__":
    sys.exit(main())
