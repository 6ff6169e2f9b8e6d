"""`make campaign-real`: thousands of motors with departures. It goes on where it was interrupted."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from rich.progress import track
from scipy.stats import beta

from campaign_real.rows import Row, row
from rig.config.campaign import Campaign
from rig.config.load import load_campaign
from shared.cases import spread

HERE = Path(__file__).resolve().parents[2]
PAGE = HERE / "docs" / "real-motors-table.md"
WRONG = 0.05  # relative error beyond which a number called ok is wrong
SEEN = 40.0  # fall of the whitened squares from which on a departure can be seen


def main() -> int:
    """Run what is missing, and write the table. Exit status 1 if an experiment failed."""
    parser = argparse.ArgumentParser(prog="make campaign-real", description=__doc__)
    parser.add_argument("config", type=Path)
    parser.add_argument("--motors", type=int, help="number of motors with one departure; default: experiments")
    parser.add_argument("--pairs", type=int, help="number of motors with two; default: experiments")
    parser.add_argument("--seed", type=int, help="another seed")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the table goes")
    given = parser.parse_args()
    config = load_campaign(given.config)
    if given.seed is not None:
        config = config.model_copy(update={"seed": given.seed})
    motors = config.experiments if given.motors is None else given.motors
    pairs = config.experiments if given.pairs is None else given.pairs
    commit = _git("rev-parse", "--short", "HEAD") + ("+" if _git("status", "--porcelain", "rig", "tools") else "")
    rows_file = HERE / "runs" / f"campaign-real-{config.seed}-{commit}" / "rows.jsonl"
    began = time.time()
    found: dict[bool, dict[int, Row]] = {False: {}, True: {}}
    rows_file.parent.mkdir(parents=True, exist_ok=True)
    if rows_file.exists():
        for line in rows_file.read_text(encoding="utf-8").splitlines():
            _keep(found, line)
    jobs = [(config, k, False) for k in range(motors) if k not in found[False]]
    jobs += [(config, k, True) for k in range(pairs) if k not in found[True]]
    with rows_file.open("a", encoding="utf-8") as file:
        results = spread(row, jobs)
        for _, one in track(results, "motors", total=len(jobs), disable=not sys.stderr.isatty()):
            file.write(json.dumps({**one.as_json(), "pair": len(one.kinds) > 1}) + "\n")
            file.flush()
            found[len(one.kinds) > 1][one.number] = one
    text = page(config, found, commit, time.time() - began, len(jobs))
    given.page.write_text(text, encoding="utf-8")
    print(text)
    failed = [one for rows in found.values() for one in rows.values() if one.verdict == "failed"]
    for one in failed[:5]:
        print(f"number {one.number} {one.kinds}: {one.reasons}", file=sys.stderr)
    return 1 if failed else 0


def _keep(found: dict[bool, dict[int, Row]], line: str) -> None:
    try:
        told = json.loads(line)
    except ValueError:
        return  # torn by an interruption
    pair = told.pop("pair")
    for key in ("kinds", "error", "inside", "u95", "found"):
        told[key] = None if told[key] is None else tuple(told[key])
    told["groups"] = tuple(map(tuple, told["groups"]))
    one = Row(**told)
    found[pair][one.number] = one


def _git(*words: str) -> str:
    return subprocess.run(["git", "-C", str(HERE), *words], capture_output=True, text=True, check=True).stdout.strip()


def page(config: Campaign, found: dict[bool, dict[int, Row]], commit: str, took_s: float, new: int) -> str:
    """The table as Markdown."""
    lines = [
        "# Motors that are not what the plain model says",
        "",
        f"Made by `make campaign-real`: seed {config.seed}, commit {commit}, {took_s:.0f} s for {new} motors.",
        "Two relay tests of each motor (10 ms, 3 mrad of noise, 10 bits, unknown delay), simulated by a program of",
        "its own (tools/campaign_real), identified as `rig identify` does two CSV files.",
        "",
        "*wrong*: called ok, and tau, K or f_c more than 5 % off. *inside*: share of u95 that hold the truth, of those",
        "called ok, for tau, K, f_c. *named*: its law is found, alone or in a group of at most three; of those whose",
        f"residual shows it (a fall of the squares of {SEEN:g} or more). Errors are medians of those called ok, in %.",
        "",
    ]
    for pair, title in ((False, "One departure"), (True, "Two departures")):
        rows = sorted(found[pair].values(), key=lambda one: one.number)
        if not rows:
            continue
        lines += [f"## {title}", "", *_table(rows, pair), ""]
    return "\n".join(lines)


def _table(rows: list[Row], pair: bool) -> list[str]:
    head = ["departure", "motors", "ok", "wrong", "inside", "named", "errors", "seconds"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    names = ["two"] if pair else list(dict.fromkeys(kind for one in rows for kind in one.kinds))
    groups = [(name, [one for one in rows if pair or name in one.kinds]) for name in names]
    if not pair:
        groups.append(("all", rows))
    for name, some in groups:
        lines.append("| " + " | ".join(_cells(name, some)) + " |")
    ok = [one for one in rows if one.verdict == "ok" and one.error is not None]
    wrong = sum(is_wrong(one) for one in ok)
    bound = float(beta.ppf(0.95, wrong + 1, max(len(rows) - wrong, 1)))
    lines += ["", f"{wrong} of {len(rows)} are called ok and wrong: with 95 % confidence at most {100 * bound:.2f} %."]
    return lines


def is_wrong(one: Row) -> bool:
    """Whether it is called ok and more than 5 % off."""
    return one.verdict == "ok" and one.error is not None and max(map(abs, one.error)) > WRONG


def is_named(one: Row) -> bool:
    """Whether each of its laws is found, alone or in a group of at most three."""
    small = {name for group in one.groups if len(group) <= 3 for name in group}
    laws = {name.rsplit(" ", 1)[0] for name in one.kinds}
    return laws <= set(one.found) | small


def _cells(name: str, some: list[Row]) -> list[str]:
    ok = [one for one in some if one.verdict == "ok" and one.error is not None and one.inside is not None]
    seen = [one for one in some if one.plain_gain > SEEN]
    inside = np.mean([one.inside or () for one in ok], axis=0) if ok else np.full(3, np.nan)
    errors = 100.0 * np.median(np.abs([one.error or () for one in ok]), axis=0) if ok else np.full(3, np.nan)
    named = f"{sum(map(is_named, seen))} of {len(seen)}" if name != "plain" else ""
    if name == "plain":
        named = f"{sum(bool(one.found) for one in some)} falsely"
    return [
        name,
        str(len(some)),
        str(len(ok)),
        str(sum(map(is_wrong, some))),
        ", ".join(f"{100 * share:.0f} %" for share in inside) if ok else "-",
        named,
        ", ".join(f"{error:.2f}" for error in errors) if ok else "-",
        f"{np.median([one.seconds for one in some]):.1f}",
    ]


if __name__ == "__main__":
    sys.exit(main())
