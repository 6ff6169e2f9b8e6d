"""`make stalls`: random motors driven by a host that stands still at random. It goes on where it was interrupted."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.progress import track

from rig.config.campaign import Campaign
from shared.cases import spread
from shared.page import today, write
from shared.rows_file import RowsFile, commit
from shared.share import bounds
from shared.table import markdown
from stalls.hostile_host import Stalls
from stalls.rows import OF, Board, Row, row

HERE = Path(__file__).resolve().parents[2]
PAGE = HERE / "docs" / "evidence" / "stalls-table.md"
MADE_BY = (  # rows of another code start anew
    *(f"rig/{room}" for room in ("backends", "control", "design", "identification", "model", "running")),
    "tools/stalls/hostile_host.py",
    "tools/stalls/rows.py",
)
SEED, WATCHDOG_S = 3, 0.25
BOARDS: Sequence[Board] = ("host", "uno", "pico")
LARGEST_RATIO = 1.1  # of the errors' RMS over the bound


def main() -> int:
    """Run what is missing, and write the page. Exit status 1 if a figure is not met."""
    parser = argparse.ArgumentParser(prog="make stalls", description=__doc__)
    parser.add_argument("--motors", type=int, default=500, help="behind the emulated host board")
    parser.add_argument("--chips", type=int, default=0, help="more of them, behind each emulated chip")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, help="processes at a time (default: one a core)")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the table goes")
    given = parser.parse_args()
    campaign = Campaign(name="stalls", experiments=max(given.motors, given.chips, 1), seed=given.seed)
    file = RowsFile(f"stalls-{given.seed}", MADE_BY)
    rows = {(one["board"], one["number"], one["a_minute"] > 0.0): Row(**one) for one in file.read()}
    counts = {board: given.motors if board == "host" else given.chips for board in BOARDS}
    wanted = [(board, k, True) for board, count in counts.items() for k in range(count)]
    _fill(file, campaign, rows, wanted, given.jobs)
    # a motor that ends without a stall as it did with them was not ended by them
    ended = [(board, k, False) for board, k, _ in wanted if rows[board, k, True].fault]
    _fill(file, campaign, rows, ended, given.jobs)
    options = f"MOTORS={given.motors} CHIPS={given.chips} SEED={given.seed}"
    made = f"`make stalls {options}`, commit {commit(MADE_BY)}, {today()}"
    text, is_met = page(rows, counts, made)
    write(given.page, text)
    print(text)
    return 0 if is_met else 1


def _fill(
    file: RowsFile,
    campaign: Campaign,
    rows: dict[tuple[str, int, bool], Row],
    wanted: Sequence[tuple[Board, int, bool]],
    jobs: int | None,
) -> None:
    missing = [key for key in wanted if key not in rows]
    cases = [
        (campaign, k, Stalls() if stalls else Stalls(a_minute=0.0), WATCHDOG_S, board) for board, k, stalls in missing
    ]
    found = spread(row, cases, jobs=jobs)
    for n, one in track(found, "motors", total=len(cases), disable=not sys.stderr.isatty()):
        rows[missing[n]] = one
        file.add(one.as_json())


def page(rows: dict[tuple[str, int, bool], Row], counts: dict[Board, int], made: str) -> tuple[str, bool]:
    """The page as Markdown, and whether its figures are met on every board."""
    stalls = Stalls()
    lines = [
        "# A host that stands still",
        "",
        f"Made by {made}.",
        f"The host stands still {stalls.a_minute:g} times a minute, at random, for {1e3 * stalls.least_s:.0f} to "
        f"{1e3 * stalls.most_s:.0f} ms; a third of it before a drive that is",
        f"already decided. Device, motor and sensor go on. Watchdog {WATCHDOG_S:g} s. Random motors from rest with",
        "`relay.until` (1 %), in virtual time; the speed limit of each is what the room to stop bears.",
        "",
        "*ended by a stall*: ended by a fault, but whole when it was run again without stalls. *error*: of the",
        "estimate, over the Cramér-Rao bound of the rows that were recorded, RMS over the motors. *held*: 95 %",
        "intervals that hold the truth.",
        "",
    ]
    is_met = True
    for board, count in counts.items():
        if count:
            some = [rows[board, k, True] for k in range(count)]
            table, met = _table(some, {k: rows[board, k, False] for k in range(count) if (board, k, False) in rows})
            lines += [f"## Behind the emulated {board} board", "", table, ""]
            is_met = is_met and met
    return "\n".join(lines), is_met


def _table(some: Sequence[Row], without: dict[int, Row]) -> tuple[str, bool]:
    n = len(some)
    ended = [one for one in some if one.fault]
    by_stall = [one for one in ended if not without[one.number].fault]
    known = [one for one in some if one.error is not None and one.bound is not None and one.inside is not None]
    lines: list[tuple[str, str]] = [
        ("motors; stalls; ticks skipped", f"{n}; {sum(o.stalls for o in some)}; {sum(o.skipped for o in some)}"),
        ("ended whole", f"{n - len(ended)} of {n}"),
        ("ended by a stall", f"{len(by_stall)} of {n}: {100 * len(by_stall) / n:.1f} %"),
    ]
    for code, number in Counter(one.fault.partition(":")[0] for one in ended).most_common():
        numbers = ", ".join(str(one.number) for one in ended if one.fault.startswith(code))
        lines.append((f"ended by {code}", f"{number} (motors {numbers})"))
    is_met = len(by_stall) <= 0.01 * n
    if known:
        ratios = np.array([np.array(one.error) / np.array(one.bound) for one in known])
        held = np.array([one.inside for one in known])
        for k, name in enumerate(OF):
            rms = float(np.sqrt(np.mean(ratios[:, k] ** 2)))
            low, high = bounds(int(held[:, k].sum()), len(known))
            lines.append(
                (
                    f"{name}: error; held",
                    f"{rms:.2f}; {100 * held[:, k].mean():.1f} % ({100 * low:.1f} to {100 * high:.1f})",
                )
            )
        pooled = float(np.sqrt(np.mean(ratios**2)))
        lines.append(("all four: error; held", f"{pooled:.2f}; {100 * held.mean():.1f} %"))
        is_met = is_met and pooled <= LARGEST_RATIO and 0.93 <= held.mean() <= 0.97
    beyond = [one for one in some if one.beyond_rad > 0.0]
    lines.append(("shaft beyond the hard limits", f"{len(beyond)} motors"))
    check = max(some, key=lambda one: one.check_rad)
    lines.append(("farthest in the breakaway check", f"{check.check_rad:.2f} rad (motor {check.number})"))
    return markdown(("", ""), lines), is_met and not beyond


if __name__ == "__main__":
    began = time.monotonic()
    status = main()
    print(f"{time.monotonic() - began:.0f} s", file=sys.stderr)
    sys.exit(status)
